"""A head on shoulders, made of rounded parts that run into each other: the figure of the scenes `bust` and `face`.

Lengths in units of about its height; z is up from the flat base at z = 0, and the face looks along −y.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bssrdf.render.surface_nets import Points, TriangleMesh, surface_net

Vector = tuple[float, float, float]

LOW, HIGH = np.array([-0.37, -0.30, -0.03]), np.array([0.37, 0.28, 1.03])
_BLEND = 0.035

_ELLIPSOIDS = (
    ("skull", (0.0, 0.030, 0.757), (0.190, 0.211, 0.218)),
    ("face", (0.0, -0.072, 0.605), (0.148, 0.134, 0.198)),
    ("chin", (0.0, -0.160, 0.440), (0.056, 0.042, 0.040)),
    ("shoulders", (0.0, 0.040, 0.110), (0.330, 0.140, 0.165)),
    ("chest", (0.0, -0.020, 0.100), (0.200, 0.130, 0.200)),
)
"""Centre and semi-axes."""
_CAPSULES = (
    ("bridge", (0.0, -0.188, 0.690), (0.0, -0.232, 0.592), 0.016, 0.023),
    ("tip", (0.0, -0.232, 0.580), (0.0, -0.228, 0.576), 0.028, 0.028),
    ("neck", (0.0, 0.045, 0.500), (0.0, 0.055, 0.200), 0.105, 0.115),
    ("upper lip", (-0.034, -0.196, 0.512), (0.034, -0.196, 0.512), 0.014, 0.014),
    ("lower lip", (-0.028, -0.194, 0.491), (0.028, -0.194, 0.491), 0.016, 0.016),
)
"""Both ends, and the radius at each."""
_PAIRS = (
    ("brow", (0.030, -0.192, 0.700), (0.115, -0.150, 0.700), 0.018, 0.015),
    ("cheek", (0.085, -0.140, 0.595), (0.090, -0.130, 0.575), 0.045, 0.045),
    ("nostril", (0.026, -0.215, 0.568), (0.026, -0.210, 0.566), 0.017, 0.017),
    ("jaw", (0.119, -0.021, 0.526), (0.042, -0.150, 0.450), 0.040, 0.037),
    ("ear", (0.192, 0.017, 0.678), (0.182, 0.007, 0.592), 0.029, 0.020),
)
"""Capsules on both sides."""
_SOCKET = ((0.068, -0.215, 0.652), 0.034)
_EYE = ((0.066, -0.160, 0.652), 0.033)
_LID = 0.006


def head_mesh(height_mm: float, *, cells: int = 110) -> TriangleMesh:
    """The figure as a closed mesh; `cells` of the grid go into its height.

    Texture coordinates are cylindrical, u from the back around, their seam at the back.
    """
    vertices, normals, faces = surface_net(head_distance, LOW, HIGH, 1 / cells)
    u = np.arctan2(vertices[:, 0], -vertices[:, 1]) / (2 * np.pi) + 0.5
    uv = np.stack([u, vertices[:, 2]], axis=1)
    return TriangleMesh(height_mm / np.ptp(vertices[:, 2]) * vertices, normals, uv, faces)


def head_distance(points: Points) -> NDArray[np.float64]:
    """Signed distance, about, of points (n, 3) from the figure of height 1; negative inside."""
    mirrored = points * [-1, 1, 1]
    side = np.where(points[:, :1] < 0, mirrored, points)
    body = _ellipsoid(points, _ELLIPSOIDS[0][1], _ELLIPSOIDS[0][2])
    for _, centre, axes in _ELLIPSOIDS[1:]:
        body = _join(body, _ellipsoid(points, centre, axes), _BLEND)
    for name, start, end, r_start, r_end in _CAPSULES:
        body = _join(body, _capsule(points, start, end, r_start, r_end), _LID if "lip" in name else _BLEND)
    for name, start, end, r_start, r_end in _PAIRS:
        body = _join(body, _capsule(side, start, end, r_start, r_end), 0.012 if name == "ear" else 0.020)
    body = -_join(-body, _ellipsoid(side, _SOCKET[0], (_SOCKET[1], _SOCKET[1], _SOCKET[1])), 0.02)
    body = _join(body, _ellipsoid(side, _EYE[0], (_EYE[1], _EYE[1], _EYE[1])), _LID)
    return -_join(-body, points[:, 2], 0.01)


def _ellipsoid(points: Points, centre: Vector, axes: Vector) -> NDArray[np.float64]:
    """Distance to first order."""
    offset = points - np.asarray(centre)
    inner = np.linalg.norm(offset / np.asarray(axes), axis=1)
    steepness = np.linalg.norm(offset / np.square(axes), axis=1)
    return inner * (inner - 1) / np.maximum(steepness, 1e-9)


def _capsule(points: Points, start: Vector, end: Vector, r_start: float, r_end: float) -> NDArray[np.float64]:
    axis = np.subtract(end, start)
    offset = points - np.asarray(start)
    along = np.clip(offset @ axis / (axis @ axis), 0, 1)
    return np.linalg.norm(offset - along[:, None] * axis, axis=1) - r_start - along * (r_end - r_start)


def _join(a: NDArray[np.float64], b: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """Smooth minimum: the union, its seam rounded over `width`."""
    overlap = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - overlap**2 * width / 4
