"""Meshes turned on a lathe: a profile of radius and height, swept round the z axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bssrdf.render.surface_nets import Points, TriangleMesh

SIDES = 192


def turned(profile: Points, *, sides: int = SIDES) -> TriangleMesh:
    """The body of a profile (n, 2) of radius and height, from the axis at the bottom to the axis at the top."""
    normals = _outward(np.gradient(profile, axis=0))
    normals[[0, -1]] = [0, -1], [0, 1]  # flat on the axis
    share = _lengths(profile)
    inner = slice(1, -1)
    vertices = _with_poles(_swept(profile[inner], sides), [0, 0, profile[0, 1]], [0, 0, profile[-1, 1]])
    directions = _with_poles(_swept(normals[inner], sides), [0, 0, -1], [0, 0, 1])
    u, v = np.broadcast_arrays(np.arange(sides) / sides, share[inner, None])
    uv = np.concatenate([[[0.0, 0.0]], np.stack([u, v], axis=-1).reshape(-1, 2), [[0.0, 1.0]]])
    return TriangleMesh(vertices, directions, uv, _capped_faces(len(profile) - 2, sides))


def ring(profile: Points, *, sides: int = SIDES) -> TriangleMesh:
    """The body of a closed profile (n, 2) off the axis, its last point joined to its first, outside on its right."""
    around = np.concatenate([profile[-1:], profile, profile[:1]])
    normals = _outward(np.gradient(around, axis=0)[1:-1])
    u, v = np.broadcast_arrays(np.arange(sides) / sides, _lengths(profile)[:, None])
    rows = np.arange(len(profile))
    faces = _joined(rows * sides, np.roll(rows, -1) * sides, sides)
    flat = [_swept(each, sides).reshape(-1, 3) for each in (profile, normals)]
    return TriangleMesh(flat[0], flat[1], np.stack([u, v], axis=-1).reshape(-1, 2), faces)


def bend(centre: Sequence[float], radius: float, from_deg: float, to_deg: float, points: int = 6) -> Points:
    """A rounded corner of a profile; 0° is outwards, 90° up."""
    angle = np.radians(np.linspace(from_deg, to_deg, points))
    return np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def straight(start: Sequence[float], end: Sequence[float], points: int) -> Points:
    """Points between both ends, which are left out."""
    share = np.linspace(0, 1, points + 2)[1:-1, None]
    return np.asarray(np.asarray(start) * (1 - share) + np.asarray(end) * share)


def _outward(tangent: Points) -> Points:
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _lengths(profile: Points) -> Points:
    """Share of the profile's length up to each point."""
    length = np.concatenate([np.zeros(1), np.cumsum(np.hypot(*np.diff(profile, axis=0).T))])
    return np.asarray(length / length[-1])


def _swept(profile: Points, sides: int) -> Points:
    """(n, sides, 3) of (n, 2)."""
    angle = 2 * np.pi * np.arange(sides) / sides
    flat = profile[:, :1, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([flat, np.broadcast_to(profile[:, 1:, None], (len(profile), sides, 1))], axis=2)


def _with_poles(rings: Points, bottom: Sequence[float], top: Sequence[float]) -> Points:
    return np.concatenate([[bottom], rings.reshape(-1, 3), [top]]).astype(np.float64)


def _joined(low: np.ndarray, high: np.ndarray, sides: int) -> np.ndarray:
    """Two triangles for each side between rings that start at vertices `low` and `high`."""
    here, after = np.arange(sides), (np.arange(sides) + 1) % sides
    a, b = low[:, None] + here, low[:, None] + after
    c, d = high[:, None] + after, high[:, None] + here
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3).astype(np.uint32)


def _capped_faces(rings: int, sides: int) -> np.ndarray:
    """Fans at both poles (vertex 0 and the last) and quads between the rings, counter-clockwise from outside."""
    here, after = np.arange(sides), (np.arange(sides) + 1) % sides
    last = 1 + rings * sides
    top = last - sides
    starts = 1 + sides * np.arange(rings)
    fans = [
        np.stack([np.zeros(sides, int), 1 + after, 1 + here], axis=1),
        np.stack([top + here, top + after, np.full(sides, last)], axis=1),
    ]
    return np.concatenate([*fans, _joined(starts[:-1], starts[1:], sides)]).astype(np.uint32)
