"""What the steps hand on: a body's refined surface, the light that enters it, and how a picture is to be made."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

Method = Literal["points", "walks"]
METHODS: tuple[Method, ...] = ("points", "walks")


@dataclass(frozen=True)
class BodySurface:
    """A body's mesh, fine enough to hold light at its vertices."""

    vertices: Floats
    """(n, 3)."""
    normals: Floats
    """For shading, unit length, out of the body, (n, 3)."""
    uv: Floats
    """Texture coordinates, (n, 2)."""
    faces: Integers
    """Corners, counter-clockwise from outside, (m, 3)."""

    def triangle_areas(self) -> Floats:
        """(m,)."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)

    def areas(self) -> Floats:
        """A third of the triangles round each vertex, (n,); they add up to the surface."""
        third = np.repeat(self.triangle_areas() / 3, 3)
        return np.asarray(np.bincount(self.faces.ravel(), third, len(self.vertices)), np.float64)

    def places(self) -> tuple[Integers, Integers]:
        """The vertices that stand at places of their own, (p,), and the place of each vertex, (n,).

        Vertices at one place differ in their normals, as along the edge of a cube, or in their texture coordinates.
        """
        return self._places

    @functools.cached_property
    def _places(self) -> tuple[Integers, Integers]:
        grain = 1e-6 * max(float(np.abs(self.vertices).max(initial=0)), 1e-30)
        x, y, z = np.round(self.vertices / grain).astype(np.int64).T + (1 << 20)
        _, first, place = np.unique((x << 42) | (y << 21) | z, return_index=True, return_inverse=True)
        return first, place


@dataclass(frozen=True)
class Entered:
    """Light that enters a body at each vertex, per area."""

    table: Floats
    """Weighed by what the table returns of light from its direction, over R for light along the normal, (n, 3)."""
    fresnel: Floats
    """The flux through the boundary: weighed by Fresnel's transmittance, (n, 3)."""
    direction: Floats
    """Mean of the unit vectors along which it runs inside, weighed by flux of all channels, (n, 3).

    Its length is 1 for a beam, and for even light from all sides the mean cosine of the cone of refraction.
    """


@dataclass(frozen=True)
class LightPlan:
    """How the light under surfaces is found."""

    method: Method = "points"
    per_mean_free_path: float = 1.0
    """Edges of triangles along the shortest 1/σt′, where a pixel is not larger."""
    per_pixel: float = 0.7
    """Edges at most along a pixel of the picture."""
    light_samples: int = 5
    """Of the light that reaches each triangle."""
    opening: float = 0.6
    """Radius over distance below which many triangles count as one."""
    walks: int = 16
    """From each place and channel, where the method is walks."""
    seed: int = 0
    most: int = 4_000_000
    """Triangles of a body, for the memory they need."""
