"""A head on shoulders, made of rounded parts that run into each other: the figure of the scenes `bust` and `face`.

Lengths in units of about its height; z is up from the flat base at z = 0, and the face looks along −y.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.render.surface_nets import Points, TriangleMesh, surface_net

Vector = tuple[float, float, float]
Distances = NDArray[np.float64]

LOW, HIGH = np.array([-0.37, -0.31, -0.03]), np.array([0.37, 0.36, 1.03])


class Ellipsoid(NamedTuple):
    """A part, and the width over which it runs into the others."""

    centre: Vector
    axes: Vector
    blend: float


class Limb(NamedTuple):
    """A thick line through points, its radius changing evenly from the first to the last."""

    points: tuple[Vector, ...]
    radius: tuple[float, float]
    blend: float


_SKULL = Ellipsoid((0.0, 0.035, 0.765), (0.172, 0.208, 0.205), 0.0)
_MIDDLE = (
    Ellipsoid((0.0, -0.055, 0.625), (0.130, 0.135, 0.190), 0.07),  # face
    Ellipsoid((0.0, -0.145, 0.515), (0.050, 0.050, 0.050), 0.05),  # mouth
    Ellipsoid((0.0, -0.168, 0.452), (0.036, 0.030, 0.030), 0.035),  # chin
    Ellipsoid((0.0, 0.045, 0.090), (0.310, 0.125, 0.150), 0.05),  # shoulders
    Ellipsoid((0.0, 0.000, 0.090), (0.230, 0.140, 0.200), 0.08),  # chest
    Limb(((0.0, 0.050, 0.540), (0.0, 0.060, 0.200)), (0.088, 0.105), 0.05),  # neck
    Limb(((0.0, -0.176, 0.690), (0.0, -0.203, 0.630), (0.0, -0.223, 0.594)), (0.013, 0.018), 0.030),  # nose
    Limb(((0.0, -0.226, 0.589), (0.0, -0.190, 0.578)), (0.019, 0.016), 0.014),
)
_SIDES = (
    Limb(((0.112, -0.005, 0.560), (0.085, -0.085, 0.490), (0.028, -0.160, 0.452)), (0.038, 0.028), 0.06),  # jaw
    Limb(((0.080, -0.130, 0.615), (0.118, -0.075, 0.640)), (0.034, 0.028), 0.06),  # cheek
    Limb(((0.018, -0.176, 0.702), (0.062, -0.172, 0.712), (0.108, -0.135, 0.700)), (0.017, 0.014), 0.035),  # brow
    Limb(((0.023, -0.204, 0.582), (0.026, -0.180, 0.584)), (0.013, 0.013), 0.014),  # wing of the nose
    Limb(((0.105, 0.060, 0.590), (0.075, 0.000, 0.400), (0.030, -0.050, 0.270)), (0.030, 0.022), 0.06),  # neck
    Limb(((0.050, 0.080, 0.370), (0.150, 0.075, 0.270), (0.260, 0.055, 0.180)), (0.060, 0.075), 0.09),  # shoulder
    Limb(((0.025, -0.075, 0.262), (0.110, -0.070, 0.268), (0.200, -0.010, 0.275)), (0.012, 0.010), 0.06),  # collarbone
)
_SOCKET = Ellipsoid((0.064, -0.205, 0.664), (0.044, 0.040, 0.026), 0.04)
_EYE = Ellipsoid((0.060, -0.138, 0.664), (0.032, 0.032, 0.032), 0.004)
_FINE = (
    Limb(
        ((0.030, -0.160, 0.658), (0.046, -0.173, 0.673), (0.066, -0.172, 0.677), (0.092, -0.150, 0.662)),
        (0.006, 0.007),
        0.008,
    ),
    Limb(((0.032, -0.160, 0.656), (0.058, -0.169, 0.648), (0.090, -0.150, 0.659)), (0.005, 0.005), 0.008),  # lids
    Limb(((0.046, -0.172, 0.513), (0.018, -0.198, 0.524), (0.0, -0.200, 0.520)), (0.005, 0.010), 0.010),  # lips
    Limb(((0.043, -0.172, 0.510), (0.018, -0.194, 0.499), (0.0, -0.197, 0.498)), (0.006, 0.012), 0.010),
)
_EAR = (
    Ellipsoid((0.142, 0.045, 0.640), (0.034, 0.026, 0.050), 0.020),
    Ellipsoid((0.176, 0.042, 0.652), (0.011, 0.042, 0.060), 0.016),
    Limb(
        (
            (0.160, 0.004, 0.640), (0.173, 0.008, 0.682), (0.189, 0.032, 0.710), (0.200, 0.068, 0.699),
            (0.196, 0.080, 0.662), (0.178, 0.059, 0.613), (0.156, 0.026, 0.586),
        ),
        (0.008, 0.012),
        0.010,
    ),
)  # fmt: skip
_SOFT = 0.008
"""Where both sides meet, so that no crease is left in the middle."""
_FAR = 0.1
"""From a part, where the grid of the mesh is not refined for it."""
_HAIR_THICK = 0.024
_HAIRLINE = (np.array([0.0, 0.66, 0.751]), 0.560)
"""A plane: hair lies where direction · place is above the number."""
_BUN = Ellipsoid((0.0, 0.255, 0.790), (0.078, 0.066, 0.072), 0.02)
_STRANDS, _STRAND_DEEP = 34, 0.0022


def head_mesh(height_mm: float, *, cells: int = 130) -> TriangleMesh:
    """The figure as a closed mesh; `cells` of the grid go into its height.

    Texture coordinates are cylindrical, u from the back around, their seam at the back.
    """
    vertices, normals, faces = surface_net(head_distance, LOW, HIGH, 1 / cells)
    u = np.arctan2(vertices[:, 0], -vertices[:, 1]) / (2 * np.pi) + 0.5
    uv = np.stack([u, vertices[:, 2]], axis=1)
    return TriangleMesh(height_mm / np.ptp(vertices[:, 2]) * vertices, normals, uv, faces)


def head_distance(points: Points) -> Distances:
    """Signed distance, about, of points (n, 3) from the figure of height 1; negative inside."""
    side = np.column_stack([np.hypot(points[:, 0], _SOFT), points[:, 1:]])
    body = _ellipsoid(points, _SKULL)
    for part in _MIDDLE:
        _grow(body, points, part)
    for part in _SIDES:
        _grow(body, side, part)
    body = -_join(-body, _ellipsoid(side, _SOCKET), _SOCKET.blend)
    for part in (_EYE, *_FINE, *_EAR):
        _grow(body, side, part)
    body = _join(body, _hair(points), 0.012)
    return -_join(-body, points[:, 2], 0.01)


def _grow(body: Distances, points: Points, part: Ellipsoid | Limb) -> None:
    """Join the part to the body; far from it nothing changes, and nothing is computed."""
    ends = np.array(part.points if isinstance(part, Limb) else [part.centre])
    reach = (max(part.radius) if isinstance(part, Limb) else max(part.axes)) + part.blend + _FAR
    near = np.arange(len(points))
    for axis in (2, 1, 0):
        along = points[near, axis]
        near = near[(along > ends[:, axis].min() - reach) & (along < ends[:, axis].max() + reach)]
    found = _limb(points[near], part) if isinstance(part, Limb) else _ellipsoid(points[near], part)
    body[near] = _join(body[near], found, part.blend)


def _hair(points: Points) -> Distances:
    """A cap over the skull, combed into a bun."""
    direction, least = _HAIRLINE
    x, z = (points - _SKULL.centre)[:, [0, 2]].T
    strands = _STRAND_DEEP * np.sin(_STRANDS * np.arctan2(x, z)) * np.minimum(np.hypot(x, z) / 0.1, 1)
    cap = _ellipsoid(points, _SKULL) - _HAIR_THICK + strands
    cap = -_join(-cap, points @ direction - least, 0.02)
    return _join(cap, _ellipsoid(points, _BUN) + strands, _BUN.blend)


def _ellipsoid(points: Points, part: Ellipsoid) -> Distances:
    """Distance to first order."""
    offset = points - np.asarray(part.centre)
    inner = _length(offset / np.asarray(part.axes))
    steepness = _length(offset / np.square(part.axes))
    return np.asarray(inner * (inner - 1) / np.maximum(steepness, 1e-9))


def _limb(points: Points, limb: Limb) -> Distances:
    joints = np.linspace(*limb.radius, len(limb.points))
    found = np.full(len(points), np.inf)
    for start, end, r_start, r_end in zip(limb.points, limb.points[1:], joints, joints[1:], strict=False):
        axis = np.subtract(end, start)
        offset = points - np.asarray(start)
        along = np.clip(offset @ axis / (axis @ axis), 0, 1)
        gap = _length(offset - along[:, None] * axis) - r_start - along * (r_end - r_start)
        found = np.minimum(found, gap)
    return found


def _length(vectors: Points) -> Distances:
    """Of each row; many times as fast as numpy's norm along an axis of three."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)))


def _join(a: Distances, b: Distances, width: float) -> Distances:
    """Smooth minimum: the union, its seam rounded over `width`."""
    overlap = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - overlap**2 * width / 4
