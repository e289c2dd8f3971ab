"""Where things stand: 4×4 matrices from their own coordinates to the scene's, and the small parts scenes share."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bssrdf.render.scenes.record import Plugin, Vector

Matrix = NDArray[np.float64]
SKY = "sky"
_WIDE_MM = 5000.0


def moved(offset: Vector, scale: Vector | float = 1.0) -> Matrix:
    """Scaled, then moved."""
    matrix = np.diag([*np.broadcast_to(scale, 3), 1.0])
    matrix[:3, 3] = offset
    return matrix


def looking(origin: Vector, target: Vector, up: Vector = (0.0, 0.0, 1.0), scale: Vector = (1.0, 1.0, 1.0)) -> Matrix:
    """Scaled, then its z axis turned from origin to target, as cameras, spots and panels look."""
    ahead = np.subtract(target, origin) / math.dist(origin, target)
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([left, np.cross(ahead, left), ahead], axis=1) * scale
    matrix[:3, 3] = origin
    return matrix


def rgb(*values: float) -> Plugin:
    """A colour; one value for all channels, or three."""
    return {"type": "rgb", "value": [float(value) for value in np.broadcast_to(values, 3)]}


def paint(*reflectance: float) -> Plugin:
    """A matt surface; one value for all channels, or three."""
    return {"type": "diffuse", "reflectance": rgb(*reflectance)}


POLISHED = {"type": "plastic", "int_ior": 1.5, "diffuse_reflectance": rgb(0.035, 0.03, 0.025)}
"""Dark, for tables."""


def sky(radiance: float) -> Plugin:
    """Light from everywhere: paths meet it anyway, so that lamps are looked at more often."""
    return {"type": "constant", "radiance": rgb(radiance), "sampling_weight": 0.15}


def panel(
    origin: Vector, target: Vector, half_mm: tuple[float, float], radiance: float, colour: Vector = (1.0, 1.0, 1.0)
) -> Plugin:
    """A rectangle that shines towards the target."""
    up = (0.0, 0.0, 1.0) if abs(target[2] - origin[2]) < math.dist(origin, target) else (0.0, 1.0, 0.0)
    return {
        "type": "rectangle",
        "to_world": looking(origin, target, up, (*half_mm, 1.0)),
        "emitter": {"type": "area", "radiance": rgb(*np.multiply(radiance, colour))},
    }


def beam(origin: Vector, target: Vector, radius_mm: float, flux: float) -> Plugin:
    """A narrow beam: `flux` [W] falls evenly on a circle of that radius across the beam.

    Made by a point lamp 80 radii before the target on its line to `origin`: from afar the cosines of so small angles
    would be lost in single precision.
    """
    distance = 80 * radius_mm
    lamp = np.add(target, np.subtract(origin, target) * distance / math.dist(origin, target))
    angle = math.degrees(math.atan(radius_mm / distance))
    up = (0.0, 1.0, 0.0) if origin[:2] == target[:2] else (0.0, 0.0, 1.0)
    return {
        "type": "spot",
        "to_world": looking((lamp[0], lamp[1], lamp[2]), target, up),
        "intensity": rgb(flux / math.pi * (distance / radius_mm) ** 2),
        "cutoff_angle": angle,
        "beam_width": angle * (1 - 1e-5),
    }


def box(low: Vector, sides: Vector) -> Plugin:
    """A box from its lowest corner; its texture coordinates run over each side."""
    x, y, z = (side / 2 for side in sides)
    return {"type": "cube", "to_world": moved((low[0] + x, low[1] + y, low[2] + z), (x, y, z))}


def box_size(sides: Vector) -> float:
    """3 V/A."""
    x, y, z = sides
    return 3 * x * y * z / (2 * (x * y + y * z + z * x))


def table(surface: Plugin) -> Plugin:
    """A wide floor at z = 0."""
    return {"type": "rectangle", "to_world": moved((0.0, 0.0, 0.0), (_WIDE_MM, _WIDE_MM, 1.0)), "bsdf": surface}


def wall(middle: Vector, surface: Plugin) -> Plugin:
    """A wide upright wall that faces the scene's origin."""
    towards = looking(middle, (0.0, 0.0, middle[2]), scale=(_WIDE_MM, _WIDE_MM, 1.0))
    return {"type": "rectangle", "to_world": towards, "bsdf": surface}
