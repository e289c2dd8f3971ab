"""A body's surface as triangles fine enough to hold light: any shape of Mitsuba's, its edges halved until short enough.

The triangles lie in those that the shape has, so that a mesh keeps its form.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from bssrdf.render.mesh_file import face_normals
from bssrdf.render.points.record import BodySurface, Floats, Integers

OPEN_SHAPES = ("Rectangle", "Disk", "Cylinder")

Target = Callable[[Floats, Floats], Floats]
"""The longest edge allowed at places (n, 3) where the surface has normals (n, 3)."""
_MOST_PARTS = 100
"""Of a mesh that may be bodies of their own: each costs seconds; hair and leaves are one."""
_ROUND = 96
"""Edges round a ball, a disk or a cylinder: a chord stays within 5·10⁻⁴ of the radius."""


def surface_of(shape: Any) -> BodySurface:
    """The triangles of a shape, their normals out of it if it is closed."""
    template = _TEMPLATES.get(shape.class_name())
    surface = _of_mesh(shape) if template is None else _placed(template(), shape)
    a, b, c = (surface.vertices[surface.faces[:, k]] - surface.vertices[0] for k in range(3))
    if is_closed(surface) and np.einsum("ij,ij->", a, np.cross(b, c)) < 0:
        surface = replace(surface, faces=surface.faces[:, ::-1].copy())
    agree = np.einsum("ij,ij->", face_normals(surface.vertices, surface.faces), surface.normals) >= 0
    return surface if agree else replace(surface, normals=-surface.normals)


def _of_mesh(shape: Any) -> BodySurface:
    faces = np.array(shape.faces_buffer(), np.int64).reshape(-1, 3)
    vertices = np.array(shape.vertex_positions_buffer(), np.float64).reshape(-1, 3)
    uv = np.array(shape.vertex_texcoords_buffer(), np.float64).reshape(-1, 2)
    uv = uv if len(uv) == len(vertices) else np.zeros((len(vertices), 2))
    normals = np.array(shape.vertex_normals_buffer(), np.float64).reshape(-1, 3)
    if len(normals) == len(vertices) and not shape.has_face_normals():
        return BodySurface(vertices, normals, uv, faces)
    corners = faces.ravel()  # flat faces share no corner
    faces = np.arange(len(corners)).reshape(-1, 3)
    return BodySurface(vertices[corners], face_normals(vertices[corners], faces), uv[corners], faces)


def _placed(surface: BodySurface, shape: Any) -> BodySurface:
    """From the shape's own coordinates to the scene's."""
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, np.float64).reshape(4, 4)
    vertices = surface.vertices @ matrix[:3, :3].T + matrix[:3, 3]
    normals = surface.normals @ np.linalg.inv(matrix[:3, :3])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    flipped = shape.has_flipped_normals() if hasattr(shape, "has_flipped_normals") else False
    faces = surface.faces[:, ::-1].copy() if (np.linalg.det(matrix[:3, :3]) < 0) != flipped else surface.faces
    return BodySurface(vertices, -normals if flipped else normals, surface.uv, faces)


def openings(shapes: list[Any]) -> list[str]:
    """One line for each shape that is open."""
    return [
        f'shape "{shape.id()}" is open ({how}): its translucency is that of a half space under it'
        for shape in shapes
        if (how := _opening(shape))
    ]


def _opening(shape: Any) -> str:
    if not shape.is_mesh():
        kind = shape.class_name()
        return kind.lower() if kind in OPEN_SHAPES else ""
    free = _free_edges(_of_mesh(shape))
    return f"{free} edges of one face only" if free else ""


def is_closed(surface: BodySurface) -> bool:
    """Does every edge have a face on either side?"""
    return _free_edges(surface) == 0


def _free_edges(surface: BodySurface) -> int:
    """Edges that an odd number of faces share."""
    _, place = surface.places()
    corners = place[surface.faces]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    edges = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    _, counts = np.unique(edges[:, 0] * (place.max() + 1) + edges[:, 1], return_counts=True)
    return int(np.count_nonzero(counts % 2))


def parts_of(surface: BodySurface) -> list[BodySurface]:
    """The closed parts of a surface whose boxes lie apart, each a body: inside no light goes between them.

    Parts whose boxes overlap may run through each other, or one may be a cavity in the other: they stay together.
    """
    first, place = surface.places()
    faces = place[surface.faces]
    links = coo_array(
        (np.ones(faces.size, bool), (faces.ravel(), np.roll(faces, 1, axis=1).ravel())), (len(first),) * 2
    )
    count, part = connected_components(links, directed=False)
    if not 1 < count <= _MOST_PARTS or not is_closed(surface):
        return [surface]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, part, surface.vertices[first])
    np.maximum.at(high, part, surface.vertices[first])
    overlap = np.all((low[:, None] <= high) & (low <= high[:, None]), axis=2)
    bodies, of_part = connected_components(overlap, directed=False)
    of_face = of_part[part[faces[:, 0]]]
    return [_only(surface, of_face == body) for body in range(bodies)] if bodies > 1 else [surface]


def _only(surface: BodySurface, chosen: NDArray[np.bool_]) -> BodySurface:
    """These faces of it, and their vertices."""
    used, faces = np.unique(surface.faces[chosen], return_inverse=True)
    return BodySurface(surface.vertices[used], surface.normals[used], surface.uv[used], faces.reshape(-1, 3))


def _net(u: Floats, v: Floats, at: Callable[[Floats, Floats], tuple[Floats, Floats]]) -> BodySurface:
    """A net of quadrilaterals over texture coordinates, without those that have no area."""
    grid_u, grid_v = (grid.ravel() for grid in np.meshgrid(u, v, indexing="ij"))
    vertices, normals = at(grid_u, grid_v)
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(len(u) - 1), np.arange(len(v) - 1), indexing="ij"))
    a, b = i * len(v) + j, (i + 1) * len(v) + j
    faces = np.concatenate([np.stack([a, b, b + 1], axis=1), np.stack([a, b + 1, a + 1], axis=1)])
    net = BodySurface(vertices, normals, np.stack([grid_u, grid_v], axis=1), faces)
    return BodySurface(net.vertices, net.normals, net.uv, faces[net.triangle_areas() > 1e-12])


def _circle(u: Floats) -> tuple[Floats, Floats]:
    return np.cos(2 * math.pi * u), np.sin(2 * math.pi * u)


def _sphere() -> BodySurface:
    def at(u: Floats, v: Floats) -> tuple[Floats, Floats]:
        (x, y), sine = _circle(u), np.sin(math.pi * v)
        place = np.stack([sine * x, sine * y, np.cos(math.pi * v)], axis=1)
        return place, place

    return _net(np.linspace(0, 1, _ROUND + 1), np.linspace(0, 1, _ROUND // 2 + 1), at)


def _rectangle() -> BodySurface:
    def at(u: Floats, v: Floats) -> tuple[Floats, Floats]:
        return np.stack([2 * u - 1, 2 * v - 1, 0 * u], axis=1), np.tile([0.0, 0.0, 1.0], (len(u), 1))

    return _net(np.linspace(0, 1, 2), np.linspace(0, 1, 2), at)


def _disk() -> BodySurface:
    def at(u: Floats, v: Floats) -> tuple[Floats, Floats]:
        x, y = _circle(v)
        return np.stack([u * x, u * y, 0 * u], axis=1), np.tile([0.0, 0.0, 1.0], (len(u), 1))

    return _net(np.linspace(0, 1, _ROUND // 6 + 1), np.linspace(0, 1, _ROUND + 1), at)


def _cylinder() -> BodySurface:
    def at(u: Floats, v: Floats) -> tuple[Floats, Floats]:
        x, y = _circle(u)
        return np.stack([x, y, v], axis=1), np.stack([x, y, 0 * u], axis=1)

    return _net(np.linspace(0, 1, _ROUND + 1), np.linspace(0, 1, 2), at)


_TEMPLATES = {"Sphere": _sphere, "Rectangle": _rectangle, "Disk": _disk, "Cylinder": _cylinder}


def refine(surface: BodySurface, target: Target, most: int, name: str) -> BodySurface:
    """Edges halved until none is longer than `target` allows, or, as a warning says, there is room for no more."""
    done, rest = np.empty((0, 3), np.int64), surface.faces
    while len(rest):
        pairs, of_edge = _edges(rest, len(surface.vertices))
        split = _too_long(surface, pairs, target)
        if split.any() and (faces := len(done) + len(rest)) + 2 * np.count_nonzero(split) > most:
            warnings.warn(_too_coarse(surface, faces, pairs, target, name), stacklevel=2)
            break
        middle = _numbered(split, len(surface.vertices))[of_edge]
        whole = (middle < 0).all(axis=1)  # what touches no long edge now never will
        surface = _with_middles(surface, pairs[split])
        done, rest = np.concatenate([done, rest[whole]]), _cut(rest[~whole], middle[~whole])
    return replace(surface, faces=np.concatenate([done, rest]))


def _too_coarse(surface: BodySurface, faces: int, pairs: Integers, target: Target, name: str) -> str:
    longer = float((_lengths(surface, pairs) / target(*_middles(surface, pairs))).max())
    return (
        f"{name}: {faces:,} triangles are all there is room for; edges are up to {longer:.2g} times as "
        "long as pixels and medium ask for, and finer detail is lost; give fewer pixels, or a smaller mesh"
    )


def _lengths(surface: BodySurface, pairs: Integers) -> Floats:
    return np.asarray(np.linalg.norm(np.diff(surface.vertices[pairs], axis=1)[:, 0], axis=1))


def _middles(surface: BodySurface, pairs: Integers) -> tuple[Floats, Floats]:
    """Of edges, with the normals there."""
    normals = surface.normals[pairs].sum(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return surface.vertices[pairs].mean(axis=1), normals


def _edges(faces: Integers, n: int) -> tuple[Integers, Integers]:
    """Each edge's two vertices, and the edges (m, 3) of each face, that from its first to its second corner first."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1)
    code, of_edge = np.unique((ends[..., 0] * n + ends[..., 1]).ravel(), return_inverse=True)
    return np.stack([code // n, code % n], axis=1), of_edge.reshape(-1, 3)


def _too_long(surface: BodySurface, pairs: Integers, target: Target) -> np.ndarray:
    """Which edges; those that lie at one place are split together, so that no gap opens."""
    long = _lengths(surface, pairs) > target(*_middles(surface, pairs))
    first, place = surface.places()
    if len(first) == len(place):
        return np.asarray(long)
    at = np.sort(place[pairs], axis=1)
    _, same = np.unique(at[:, 0] * (place.max() + 1) + at[:, 1], return_inverse=True)
    return (np.bincount(same.ravel(), long) > 0)[same.ravel()]


def _numbered(split: np.ndarray, first: int) -> Integers:
    """The new vertex on each edge, −1 where it is not split."""
    return np.where(split, first + np.cumsum(split) - 1, -1)


def _with_middles(surface: BodySurface, pairs: Integers) -> BodySurface:
    """The surface and, of no face yet, vertices halfway between pairs of it."""
    places, normals = _middles(surface, pairs)
    vertices = np.concatenate([surface.vertices, places])
    uv = np.concatenate([surface.uv, surface.uv[pairs].mean(axis=1)])
    return BodySurface(vertices, np.concatenate([surface.normals, normals]), uv, surface.faces)


def _cut(faces: Integers, middle: Integers) -> Integers:
    """Each face in one to four, by the middles of the edges from its first, second and third corner."""
    count = (middle >= 0).sum(axis=1)
    parts = [faces[count == 0]]
    (a, b, c), (x, y, z) = faces[count == 3].T, middle[count == 3].T
    parts += [np.stack(part, axis=1) for part in ((a, x, z), (x, b, y), (z, y, c), (x, y, z))]
    for turn in range(3):
        corners, on = np.roll(faces, -turn, axis=1), np.roll(middle, -turn, axis=1)
        one, two = (count == 1) & (on[:, 0] >= 0), (count == 2) & (on[:, 2] < 0)
        (a, b, c), x = corners[one].T, on[one, 0]
        parts += [np.stack(part, axis=1) for part in ((a, x, c), (x, b, c))]
        (a, b, c), x, y = corners[two].T, on[two, 0], on[two, 1]
        parts += [np.stack(part, axis=1) for part in ((x, b, y), (a, x, y), (a, y, c))]
    return np.concatenate(parts)
