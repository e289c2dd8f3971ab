"""A closed triangle mesh of an implicit surface: naive surface nets (Gibson 1998), smoothed onto the surface."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Distance = Callable[[Points], NDArray[np.float64]]
"""Signed distance, negative inside, of points (n, 3)."""

_BLOCK = 4
_CORNERS = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)])
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1]


class TriangleMesh(NamedTuple):
    """Vertices (n, 3), unit normals (n, 3) out of the body, texture coordinates (n, 2), and faces (m, 3)."""

    vertices: Points
    normals: Points
    uv: Points
    faces: NDArray[np.uint32]

    def size(self) -> float:
        """Three times its volume over its surface: the radius of a ball."""
        return body_size(self.vertices, self.faces)


def body_size(vertices: Points, faces: NDArray[np.integer]) -> float:
    """Three times the volume of a closed surface over its area."""
    a, b, c = np.moveaxis((vertices - vertices.mean(axis=0))[faces], 1, 0)
    across = np.cross(b - a, c - a)
    return float(abs(np.einsum("ij,ij->", a, across)) / np.linalg.norm(across, axis=1).sum())


def surface_net(
    distance: Distance, low: Points, high: Points, spacing: float
) -> tuple[Points, Points, NDArray[np.uint32]]:
    """Vertices, outward normals and faces of distance = 0 in the box, which must hold all of the body.

    One vertex a cell that the surface cuts, at the mean of its edges' crossings, then moved onto the surface.
    """
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [low[axis] + spacing * np.arange(shape[axis]) for axis in range(3)]
    values = _sampled(distance, axes, spacing)
    cells, vertices = _cell_vertices(values)
    vertices = low + spacing * vertices
    for _ in range(3):
        gradient = _gradient(distance, vertices, 0.1 * spacing)
        step = distance(vertices)[:, None] * gradient / np.maximum(np.sum(gradient**2, axis=1), 1e-12)[:, None]
        vertices -= np.clip(step, -spacing / 2, spacing / 2)
    gradient = _gradient(distance, vertices, 0.1 * spacing)
    return vertices, gradient / np.linalg.norm(gradient, axis=1, keepdims=True), _faces(values, cells)


def _sampled(distance: Distance, axes: list[NDArray[np.float64]], spacing: float) -> NDArray[np.float64]:
    """The distance on the grid; where the surface is a block of the grid or more away, that of a point nearby."""
    coarse = np.stack(np.meshgrid(*(axis[_BLOCK // 2 :: _BLOCK] for axis in axes), indexing="ij"), axis=-1)
    rough = distance(coarse.reshape(-1, 3)).reshape(coarse.shape[:3])
    nearest = np.ix_(*(np.minimum(np.arange(len(axes[i])) // _BLOCK, rough.shape[i] - 1) for i in range(3)))
    values = rough[nearest]
    near = np.abs(values) < 2 * _BLOCK * spacing
    values[near] = distance(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)[near])
    return values


def _cell_vertices(values: NDArray[np.float64]) -> tuple[NDArray[np.int64], Points]:
    """Number of each cell's vertex (−1 without one), and the vertices in units of the grid."""
    nx, ny, nz = (n - 1 for n in values.shape)
    corner = np.stack([values[i : nx + i, j : ny + j, k : nz + k] for i, j, k in _CORNERS], axis=-1)
    cut = (corner.min(axis=-1) < 0) & (corner.max(axis=-1) >= 0)
    index = np.full(cut.shape, -1)
    index[cut] = np.arange(cut.sum())
    corner = corner[cut]
    total, count = np.zeros((len(corner), 3)), np.zeros(len(corner))
    for a, b in _EDGES:
        crosses = (corner[:, a] < 0) != (corner[:, b] < 0)
        share = corner[crosses, a] / (corner[crosses, a] - corner[crosses, b])
        total[crosses] += _CORNERS[a] + share[:, None] * (_CORNERS[b] - _CORNERS[a])
        count[crosses] += 1
    return index, np.argwhere(cut) + total / count[:, None]


def _faces(values: NDArray[np.float64], cells: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Two triangles around each edge of the grid that the surface crosses, counter-clockwise from outside."""
    triangles = []
    for axis in range(3):
        inside = np.moveaxis(values, (axis, (axis + 1) % 3, (axis + 2) % 3), (0, 1, 2)) < 0
        around = np.moveaxis(cells, (axis, (axis + 1) % 3, (axis + 2) % 3), (0, 1, 2))
        leaves = (inside[:-1] & ~inside[1:])[:, 1:-1, 1:-1]
        enters = (~inside[:-1] & inside[1:])[:, 1:-1, 1:-1]
        quad = np.stack([around[:, :-1, :-1], around[:, 1:, :-1], around[:, 1:, 1:], around[:, :-1, 1:]], axis=-1)
        for quads in (quad[leaves], quad[enters][:, ::-1]):
            triangles += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    return np.concatenate(triangles).astype(np.uint32)


def _gradient(distance: Distance, points: Points, step: float) -> Points:
    offsets = step * np.eye(3)
    return np.stack([(distance(points + o) - distance(points - o)) / (2 * step) for o in offsets], axis=1)
