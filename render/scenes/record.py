"""What a scene is made of. Lengths in mm; z is up. Dictionaries are Mitsuba's own, without a surface or a medium."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.render.material import RenderMaterial
from bssrdf.render.surface_nets import TriangleMesh

Plugin = Mapping[str, Any]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Maps:
    """Coefficients that vary over the surface by its texture coordinates: [1/mm], shape (height, width, 3)."""

    sigma_a: NDArray[np.float32]
    sigma_sp: NDArray[np.float32]


@dataclass(frozen=True)
class Bump:
    """Heights above the surface [mm] by its texture coordinates, shape (height, width)."""

    height_mm: NDArray[np.float32]
    repeat: tuple[float, float] = (1.0, 1.0)


@dataclass(frozen=True)
class Body:
    """A translucent solid."""

    shape: Plugin | TriangleMesh
    material: RenderMaterial
    size_mm: float
    """Three times its volume over its surface: the radius of a ball, half as much again as a wide slab's thickness."""
    roughness: float = 0.0
    """Of GGX microfacets; 0 is polished."""
    bump: Bump | None = None
    maps: Maps | None = None


@dataclass(frozen=True)
class Thing:
    """An opaque or clear mesh, and its surface."""

    mesh: TriangleMesh
    surface: Plugin


@dataclass(frozen=True)
class Viewpoint:
    """Perspective, or orthographic where `width_mm` is given."""

    origin: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov_deg: float = 30.0
    """Across the width."""
    width_mm: float | None = None
    pixels: tuple[int, int] = (256, 256)

    @property
    def footprint_mm(self) -> float:
        """Width of a pixel at the target."""
        across = self.width_mm
        if across is None:
            distance = float(np.linalg.norm(np.subtract(self.target, self.origin)))
            across = 2 * distance * np.tan(np.radians(self.fov_deg) / 2)
        return float(across / self.pixels[0])


@dataclass(frozen=True)
class Scene:
    """Bodies, what else stands there, lights and camera."""

    name: str
    bodies: Mapping[str, Body]
    lights: Mapping[str, Plugin]
    camera: Viewpoint
    furniture: Mapping[str, Plugin | Thing] = field(default_factory=dict)
    """Opaque or clear things, with their surfaces."""
    narrow_light: bool = False
    """Whether the light is so narrow that volpath does not find it through a smooth boundary."""
    white_percentile: float = 99.0
    """Of the lit pixels: the one that a picture shows just below white."""
