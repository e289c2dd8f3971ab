"""The image of a lit sample in the camera's pixels: spot, view, pixel area, glare. Lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bssrdf.rig.sim.blurred import Radiance
from bssrdf.rig.sim.light import SeenLight

Array = NDArray[np.float64]

_NEAR_SPOTS = 6.0
"""Within this many spot radii a pixel's footprint is sampled finely."""


@dataclass(frozen=True)
class PictureGeometry:
    """Where the camera's pixels lie on the surface, and the beam among them."""

    shape: tuple[int, int]
    """(height, width) in pixels."""
    mm_per_px: float
    """In the surface, across the view."""
    view_angle_deg: float = 45.0
    view_axis: str = "y"
    centre_px: tuple[float, float] | None = None
    """(x, y) where the beam lands; the middle of the frame if None."""
    spot_radius_mm: float = 0.2
    """1/e² radius of the irradiance."""
    spot_aspect: float = 1.0
    """Length of the spot along the view over its width, 1 or more."""
    spread_aspect: float = 1.0
    """How much farther light spreads across the view than along it, as in a fibrous sample."""
    perspective: float = 0.0
    """Relative change of scale per frame height, by which the far edge of the surface looks smaller."""

    def homography(self) -> Array:
        """3×3, pixel (x, y, 1) to mm in the surface, the beam at the origin."""
        height, width = self.shape
        x_0, y_0 = self.centre_px or ((width - 1) / 2, (height - 1) / 2)
        stretch = 1 / np.cos(np.radians(self.view_angle_deg))
        scale_x, scale_y = (1.0, stretch) if self.view_axis == "y" else (stretch, 1.0)
        plane = self.mm_per_px * np.array([[scale_x, 0, -scale_x * x_0], [0, scale_y, -scale_y * y_0], [0, 0, 0]])
        plane[2] = (0.0, -self.perspective / height, 1 + self.perspective * y_0 / height)
        return plane

    def spots(self) -> list[tuple[float, float]]:
        """Round spots that make the long one, by Gauss–Hermite: how far along the view each lies, and its share."""
        apart = self.spot_radius_mm / 2 * np.sqrt(3 * (self.spot_aspect**2 - 1))
        return [(-apart, 1 / 6), (0.0, 2 / 3), (apart, 1 / 6)] if apart else [(0.0, 1.0)]

    def surface_mm(self, x_px: Array, y_px: Array) -> tuple[Array, Array]:
        """The point of the surface that a point of the image sees."""
        x, y, w = np.einsum("ij,j...->i...", self.homography(), np.stack([x_px, y_px, np.ones_like(x_px)]))
        return x / w, y / w


def picture(light: SeenLight, view: PictureGeometry, glare: float = 0.0) -> Array:
    """πL/Φ [1/mm²] averaged over each pixel's footprint, (height, width); the camera stands towards +y of the surface
    (+x where it views along x).

    `glare` is the share of the light in the frame that the lens spreads evenly over it.
    """
    height, width = view.shape
    corners = view.surface_mm(np.array([0.0, width, 0.0, width]), np.array([0.0, 0.0, height, height]))
    radiance = Radiance(light, view.spot_radius_mm, 1.05 * float(np.hypot(*corners).max()))

    y_px, x_px = np.mgrid[:height, :width].astype(float)
    points = view.surface_mm(x_px, y_px)
    out = _seen(radiance, view, *points)
    near = np.hypot(*points) < _NEAR_SPOTS * view.spot_aspect * view.spot_radius_mm + 2 * view.mm_per_px
    if light.line_beyond is not None:  # the line is as narrow as the spot all along
        across = points[0] if view.view_axis == "y" else points[1]
        near |= np.abs(across) < 3 * view.spot_radius_mm + 2 * view.mm_per_px
    out[near] = _footprint_mean(radiance, view, x_px[near], y_px[near])
    return (1 - glare) * out + glare * out.mean()


def _seen(radiance: Radiance, view: PictureGeometry, x_mm: Array, y_mm: Array) -> Array:
    across, along = (x_mm, y_mm) if view.view_axis == "y" else (y_mm, x_mm)
    stretch = np.sqrt(view.spread_aspect)
    return sum((share * radiance(across / stretch, along * stretch - at) for at, share in view.spots()), np.zeros(1))


def _footprint_mean(radiance: Radiance, view: PictureGeometry, x_px: Array, y_px: Array) -> Array:
    """Mean over a pixel's square by Gauss–Legendre quadrature, for pixel centres of shape (n,)."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    x, y = np.meshgrid(nodes / 2, nodes / 2)
    points = view.surface_mm(x_px[:, None, None] + x, y_px[:, None, None] + y)
    return np.einsum("nij,i,j->n", _seen(radiance, view, *points), weights, weights) / 4
