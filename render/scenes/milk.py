"""A glass of milk on a table, turned on a lathe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bssrdf.render.material import RenderMaterial, find_medium
from bssrdf.render.scenes.place import SKY, box, box_size, panel, sky, table
from bssrdf.render.scenes.record import Body, Scene, Viewpoint
from bssrdf.render.surface_nets import Points, TriangleMesh

RADIUS_MM = 20.0
"""At the foot; the glass widens upwards."""
FILL_MM = 58.0
_TABLE = (260.0, 260.0, 20.0)


def milk(material: RenderMaterial, **look: Any) -> Scene:
    """A glass of the material on a polished slab of marble, lit from the left.

    The glass itself is left out: milk meets air, as its coefficients have it.
    """
    foot = _TABLE[2] + 0.05
    glass = turned(np.add(_profile(), (0.0, foot)))
    size = 3 * FILL_MM * RADIUS_MM / (2 * (FILL_MM + RADIUS_MM))
    marble = Body(box((-_TABLE[0] / 2, -_TABLE[1] / 2, 0.0), _TABLE), find_medium("Marble"), box_size(_TABLE))
    lights = {"window": panel((-210.0, 10.0, 110.0), (0.0, 0.0, 45.0), (45.0, 60.0), radiance=12.0), SKY: sky(0.02)}
    camera = Viewpoint((25.0, -230.0, 120.0), (0.0, 0.0, 50.0), fov_deg=25.0)
    bodies = {"milk": Body(glass, material, size, **look), "marble": marble}
    return Scene("milk", bodies, lights, camera, {"floor": table(0.1)})


def _profile() -> np.ndarray:
    """Radius and height of the milk: a foot with a round edge, a wall that widens, a level top."""
    corner = np.linspace(-np.pi / 2, 0, 8)
    edge = 3.0
    wall = np.stack([np.linspace(RADIUS_MM, RADIUS_MM + 4, 24), np.linspace(edge, FILL_MM - 0.6, 24)], axis=1)
    turn = np.linspace(0, np.pi / 2, 6)
    return np.concatenate(
        [
            np.stack([np.linspace(0, RADIUS_MM - edge, 8, endpoint=False), np.zeros(8)], axis=1),
            np.stack([RADIUS_MM - edge + edge * np.cos(corner), edge + edge * np.sin(corner)], axis=1),
            wall[1:-1],
            np.stack([RADIUS_MM + 3.4 + 0.6 * np.cos(turn), FILL_MM - 0.6 + 0.6 * np.sin(turn)], axis=1),
            np.stack([np.linspace(RADIUS_MM + 3.4, 0, 9)[1:], np.full(8, FILL_MM)], axis=1),
        ]
    )


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
