"""The image of a lit sample in the camera's pixels: spot, view, pixel area, glare. Lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import ive

from bssrdf.rig.sim.light import RadialLight

Array = NDArray[np.float64]

_RINGS_PER_SIGMA = 8
_BLUR_REACH_SIGMA = 100.0
"""Beyond this many σ of the spot, its width changes the curve by less than 0.1 %."""
_NEAR_SPOTS = 6.0
"""Within this many spot radii a pixel's footprint is sampled finely."""
_FLOOR = 1e-30


@dataclass(frozen=True)
class View:
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

    def surface_mm(self, x_px: Array, y_px: Array) -> tuple[Array, Array]:
        """The point of the surface that a point of the image sees."""
        x, y, w = np.einsum("ij,j...->i...", self.homography(), np.stack([x_px, y_px, np.ones_like(x_px)]))
        return x / w, y / w


def blurred(light: RadialLight, spot_radius_mm: float, r_max_mm: float) -> PchipInterpolator:
    """ln of πL/Φ [1/mm²] as a function of r, for a Gaussian spot instead of a thin beam.

    The light of a ring of radius s, spread by a Gaussian of σ = spot radius/2, is
    exp(−(r² + s²)/2σ²) I₀(rs/σ²)/(2πσ²).
    """
    sigma = spot_radius_mm / 2
    reach = min(_BLUR_REACH_SIGMA * sigma, r_max_mm)
    edges = np.linspace(0.0, reach, int(_RINGS_PER_SIGMA * reach / sigma) + 1)
    ring, s = -np.diff(_beyond(light, edges)), (edges[1:] + edges[:-1]) / 2

    near = np.linspace(0.0, reach - 4 * sigma, len(edges) // 2)
    kernel = np.exp(-((near[:, None] - s) ** 2) / (2 * sigma**2)) * ive(0, near[:, None] * s / sigma**2)
    near_radiance = kernel @ ring / (2 * np.pi * sigma**2)

    far_edges = np.geomspace(reach, max(r_max_mm, 1.01 * reach), 100)
    far = np.sqrt(far_edges[1:] * far_edges[:-1])
    far_radiance = -np.diff(_beyond(light, far_edges)) / (np.pi * np.diff(far_edges**2))

    radiance = np.concatenate([near_radiance, far_radiance])
    return PchipInterpolator(np.concatenate([near, far]), np.log(np.maximum(radiance, _FLOOR)))


def _beyond(light: RadialLight, r_mm: Array) -> Array:
    """Light from farther out than each radius: its logarithm is smooth in ln r, so bins of 10 % do for 0.1 %."""
    known = light.beyond > 0
    inner = light.r_edges_mm[1] * 1e-3
    log_r = np.log(np.maximum(light.r_edges_mm[known], inner))
    curve = PchipInterpolator(log_r, np.log(light.beyond[known]), extrapolate=False)
    return np.nan_to_num(np.exp(curve(np.log(np.maximum(r_mm, inner)))), nan=0.0)


def picture(light: RadialLight, view: View, glare: float = 0.0) -> Array:
    """πL/Φ [1/mm²] averaged over each pixel's footprint, (height, width).

    `glare` is the share of the light in the frame that the lens spreads evenly over it.
    """
    height, width = view.shape
    corners = view.surface_mm(np.array([0.0, width, 0.0, width]), np.array([0.0, 0.0, height, height]))
    log_radiance = blurred(light, view.spot_radius_mm, 1.05 * np.hypot(*corners).max())

    y_px, x_px = np.mgrid[:height, :width].astype(float)
    r = np.hypot(*view.surface_mm(x_px, y_px))
    out = np.exp(log_radiance(r))
    near = r < _NEAR_SPOTS * view.spot_radius_mm + 2 * view.mm_per_px
    out[near] = _footprint_mean(log_radiance, view, x_px[near], y_px[near])
    return (1 - glare) * out + glare * out.mean()


def _footprint_mean(log_radiance: PchipInterpolator, view: View, x_px: Array, y_px: Array) -> Array:
    """Mean over a pixel's square by Gauss–Legendre quadrature, for pixel centres of shape (n,)."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    x, y = np.meshgrid(nodes / 2, nodes / 2)
    r = np.hypot(*view.surface_mm(x_px[:, None, None] + x, y_px[:, None, None] + y))
    return np.einsum("nij,i,j->n", np.exp(log_radiance(r)), weights, weights) / 4
