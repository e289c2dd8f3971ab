"""A closed mesh turned about the z axis from a profile."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bssrdf.render.surface_nets import Points, TriangleMesh


def turned(profile: Points, *, sides: int = 128) -> TriangleMesh:
    """The body of a profile (n, 2) of radius and height, from the axis at the bottom to the axis at the top."""
    radius, height = profile[:, 0], profile[:, 1]
    tangent = np.gradient(profile, axis=0)
    tangent[[0, -1], 1] = 0  # flat on the axis
    outward = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    angle = 2 * np.pi * np.arange(sides) / sides
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def swept(r: Points, z: Points) -> Points:
        ring = r[:, None, None] * around
        return np.concatenate([ring, np.broadcast_to(z[:, None, None], (len(r), sides, 1))], axis=2)

    inner = slice(1, -1)
    vertices = _with_poles(swept(radius[inner], height[inner]), [0, 0, height[0]], [0, 0, height[-1]])
    normals = _with_poles(swept(*outward[inner].T), [0, 0, -1], [0, 0, 1])
    share = np.concatenate([np.zeros(1), np.cumsum(np.hypot(*np.diff(profile, axis=0).T))])
    u = np.broadcast_to(np.append(angle, 0)[:sides] / (2 * np.pi), (len(profile) - 2, sides))
    v = np.broadcast_to((share / share[-1])[inner, None], u.shape)
    uv = np.concatenate([[[0.0, 0.0]], np.stack([u, v], axis=-1).reshape(-1, 2), [[0.0, 1.0]]])
    return TriangleMesh(vertices, normals, uv, _ring_faces(len(profile) - 2, sides))


def _with_poles(rings: Points, bottom: Sequence[float], top: Sequence[float]) -> Points:
    return np.concatenate([[bottom], rings.reshape(-1, 3), [top]]).astype(np.float64)


def _ring_faces(rings: int, sides: int) -> np.ndarray:
    """Fans at both poles (vertex 0 and the last) and quads between the rings, counter-clockwise from outside."""
    here, after = np.arange(sides), (np.arange(sides) + 1) % sides
    last = 1 + rings * sides
    faces = [np.stack([np.zeros(sides, int), 1 + after, 1 + here], axis=1)]
    for ring in range(rings - 1):
        low, high = 1 + ring * sides, 1 + (ring + 1) * sides
        faces.append(np.stack([low + here, low + after, high + after], axis=1))
        faces.append(np.stack([low + here, high + after, high + here], axis=1))
    top = last - sides
    faces.append(np.stack([top + here, top + after, np.full(sides, last)], axis=1))
    return np.concatenate(faces).astype(np.uint32)
