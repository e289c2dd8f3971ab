"""The beam's 1/e² radius, from a knife edge or from the spot on a white tile, which spreads light. Lengths in mm.

A tile without absorption spreads a thin beam as diffusion has it: exponentially distributed sources, their images above
the extrapolated boundary, fluence and flux seen under the camera's angle (Kienle & Patterson 1997). One length, the
tile's mean free path, says how wide; it shows in the skirt of the image, the beam's radius in its core.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.few_parameters import least_squares
from bssrdf.calib.monotone import Monotone
from bssrdf.errors import InputError
from bssrdf.transport.exit_radiance import boundary_a

Array = NDArray[np.float64]

_ETA = 1.35
"""Sintered PTFE."""
_DEPTHS, _DEPTH_WEIGHTS = np.polynomial.laguerre.laggauss(16)
_MEAN_DEPTH = 0.6
"""Of the sources, in mean free paths: 1 would leave too little light near the beam, as Monte Carlo shows."""
_RINGS_PER_SIGMA = 6
_STEPS_PER_SIGMA = 3
_BEYOND_SIGMAS = 4
"""Rings farther out than this beyond a place give it nothing."""
_REACH = 5.0
"""Of the image that is fitted, in radii of its core."""
_I0_SAFE = 600.0
"""There the term after those of the series is 1e-12 of the sum."""
_NODES = np.polynomial.legendre.leggauss(3)
_SHAPE_REL_SD = 0.03
"""How far the form is right near the source."""
_SPREAD_REL_SD = 0.1
"""How far the spread that was taken off is right, g of the tile being unknown."""


class BeamRadius(NamedTuple):
    """1/e² radius of the beam and its standard error; the tile's mean free path [mm]."""

    radius_mm: float
    sd_mm: float
    mfp_mm: float


def radius_on_tile(
    across: Array,
    along: Array,
    value: Array,
    variance: Array,
    footprint: tuple[float, float],
    core_radius: float,
    view_angle_deg: float,
) -> BeamRadius:
    """Fit spot and spread to the pixels (n,) of a spot's image about its centre.

    `footprint` is the width of a pixel across and along, `core_radius` the 1/e² radius of the image's core.
    """
    near = np.hypot(across, along) < _REACH * core_radius
    across, along, value = across[near], along[near], value[near]
    of_one_radius = 2 * len(value) * (across**2 + along**2) / (_REACH * core_radius) ** 2
    shape_sd = _SHAPE_REL_SD * np.sqrt(np.maximum(1.0, of_one_radius))
    reach = _REACH * core_radius + max(footprint)
    r, weights = _within_pixels(across, along, footprint)

    @lru_cache(maxsize=4)
    def image(log_radius: float, log_mfp: float) -> Array:
        curve = spot_image(float(np.exp(log_radius)), float(np.exp(log_mfp)), reach, view_angle_deg)
        return np.asarray(weights @ np.exp(curve(r)))

    def residual(p: Array) -> Array:
        model = np.exp(p[2]) * image(*p[:2].tolist())
        return (value - model) / np.sqrt(variance[near] + (shape_sd * model) ** 2)

    amplitude = np.log(value.max() * core_radius**2)
    start = np.array([np.log(0.8 * core_radius), np.log(0.3 * core_radius), amplitude])
    low = np.array([np.log(0.01 * core_radius), np.log(1e-6 * core_radius), amplitude - 9])
    high = np.array([np.log(2 * core_radius), np.log(2 * core_radius), amplitude + 9])
    solved = least_squares(residual, start, low, high)
    covariance = np.linalg.pinv(solved.slopes.T @ solved.slopes)
    radius, mfp = np.exp(solved.x[:2])
    sd = np.hypot(radius * np.sqrt(covariance[0, 0]), _SPREAD_REL_SD * (core_radius - radius))
    return BeamRadius(float(radius), float(sd), float(mfp))


def beyond(r_mfp: Array, view_angle_deg: float) -> Array:
    """Share of a thin beam's light that leaves a tile farther from the beam than each radius [mean free paths]."""
    a = boundary_a(_ETA)
    cosine = np.sqrt(1 - (np.sin(np.radians(view_angle_deg)) / _ETA) ** 2)
    depth = _MEAN_DEPTH * _DEPTHS[:, None]
    image = depth + 4 / 3 * a
    d_r, d_v = np.hypot(r_mfp, depth), np.hypot(r_mfp, image)
    share = _DEPTH_WEIGHTS @ (3 * (d_v - d_r) + 3 * cosine * (depth / d_r + image / d_v))
    return np.asarray(share / (4 * a + 6 * cosine))


def spot_image(radius: float, mfp: float, reach: float, view_angle_deg: float) -> Monotone:
    """Light per area [1/mm²] of a Gaussian spot on the tile, as ln f over r up to `reach`."""
    sigma = radius / 2
    spread = _spread_rings(int(_STEPS_PER_SIGMA * reach / sigma) + 2)
    n_steps, n_rings = spread.shape
    edges = np.arange(n_rings + 1, dtype=np.float64) * sigma / _RINGS_PER_SIGMA
    ring = -np.diff(beyond(edges / mfp, view_angle_deg))
    r = np.arange(n_steps, dtype=np.float64) * sigma / _STEPS_PER_SIGMA
    return Monotone(r, np.log(spread @ ring / (2 * np.pi * sigma**2)))


@lru_cache(maxsize=8)
def _spread_rings(n_steps: int) -> Array:
    """What the light of rings gives to as many places from the centre on, by their radii ς and ρ in units of σ.

    The light of a ring, spread by a Gaussian, is exp(−(ρ² + ς²)/2) I₀(ρς)/(2πσ²).
    """
    rho = np.arange(n_steps)[:, None] / _STEPS_PER_SIGMA
    ring = (np.arange(int(_RINGS_PER_SIGMA * (rho[-1, 0] + _BEYOND_SIGMAS))) + 0.5) / _RINGS_PER_SIGMA
    return np.asarray(np.exp(-((rho - ring) ** 2) / 2) * scaled_i0(rho * ring))


def scaled_i0(x: Array) -> Array:
    """exp(−x) I₀(x), x ≥ 0: NumPy's up to where it overflows, from there three terms of the asymptotic series."""
    small, large = np.minimum(x, _I0_SAFE), np.maximum(x, _I0_SAFE)
    series = (1 + 1 / (8 * large) * (1 + 9 / (16 * large) * (1 + 25 / (24 * large)))) / np.sqrt(2 * np.pi * large)
    return np.where(x < _I0_SAFE, np.i0(small) * np.exp(-small), series)


def _within_pixels(across: Array, along: Array, footprint: tuple[float, float]) -> tuple[Array, Array]:
    """Radii (k, n) of places in the rectangle of each pixel (n,), and weights (k,) by which they make its mean."""
    nodes, weights = _NODES
    places = [np.hypot(across + u * footprint[0] / 2, along + v * footprint[1] / 2) for u in nodes for v in nodes]
    return np.array(places), np.outer(weights, weights).ravel() / 4


def knife_edge_radius(position: Array, light: Array) -> float:
    """1/e² radius from the light that passes an edge moved across the spot, arrays of shape (n,), n ≥ 5.

    A Gaussian spot of radius w passes (1 + erf(√2 (x − x₀)/w))/2.
    """
    from scipy.special import erf

    if len(position) < 5:
        raise InputError(f"{len(position)} positions of the edge do not tell the spot's radius; give at least five")
    low, high = light.min(), light.max()
    middle = float(np.interp((low + high) / 2, np.sort(light), position[np.argsort(light)]))
    rising = 1.0 if light[np.argmax(position)] > light[np.argmin(position)] else -1.0

    def residual(p: Array) -> Array:
        centre, log_radius, bottom, top = p
        return (
            bottom + (top - bottom) * (1 + erf(rising * 2**0.5 * (position - centre) / np.exp(log_radius))) / 2 - light
        )

    start = np.array([middle, np.log(np.ptp(position) / 8), low, high])
    return float(np.exp(least_squares(residual, start, np.full(4, -np.inf), np.full(4, np.inf)).x[1]))
