"""The beam's 1/e² radius, from a knife edge or from the spot on a white tile, which spreads light. Lengths in mm.

A tile without absorption spreads a thin beam as diffusion has it: exponentially distributed sources, their images above
the extrapolated boundary, fluence and flux seen under the camera's angle (Kienle & Patterson 1997). One length, the
tile's mean free path, says how wide; it shows in the skirt of the image, the beam's radius in its core.
"""

from __future__ import annotations

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

    def residual(p: Array) -> Array:
        curve = spot_image(float(np.exp(p[0])), float(np.exp(p[1])), reach, view_angle_deg)
        model = np.exp(p[2]) * _pixel_mean(curve, across, along, footprint)
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
    share = np.zeros_like(r_mfp)
    for depth, weight in zip(_MEAN_DEPTH * _DEPTHS, _DEPTH_WEIGHTS, strict=True):
        image = depth + 4 / 3 * a
        d_r, d_v = np.hypot(r_mfp, depth), np.hypot(r_mfp, image)
        share += weight * (3 * (d_v - d_r) + 3 * cosine * (depth / d_r + image / d_v))
    return np.asarray(share / (4 * a + 6 * cosine))


def spot_image(radius: float, mfp: float, reach: float, view_angle_deg: float) -> Monotone:
    """Light per area [1/mm²] of a Gaussian spot on the tile, as ln f over r up to `reach`.

    The light of a ring of radius s, spread by a Gaussian of σ = radius/2, is exp(−(r² + s²)/2σ²) I₀(rs/σ²)/(2πσ²).
    """
    sigma = radius / 2
    edges = np.linspace(0.0, reach + 4 * sigma, int(_RINGS_PER_SIGMA * (reach / sigma + 4)) + 1)
    ring, s = -np.diff(beyond(edges / mfp, view_angle_deg)), (edges[1:] + edges[:-1]) / 2
    r = np.linspace(0.0, reach, int(_STEPS_PER_SIGMA * reach / sigma) + 2)
    kernel = np.exp(-((r[:, None] - s) ** 2) / (2 * sigma**2)) * scaled_i0(r[:, None] * s / sigma**2)
    return Monotone(r, np.log(kernel @ ring / (2 * np.pi * sigma**2)))


def scaled_i0(x: Array) -> Array:
    """exp(−x) I₀(x), x ≥ 0: NumPy's up to where it overflows, from there three terms of the asymptotic series."""
    small, large = np.minimum(x, _I0_SAFE), np.maximum(x, _I0_SAFE)
    series = (1 + 1 / (8 * large) * (1 + 9 / (16 * large) * (1 + 25 / (24 * large)))) / np.sqrt(2 * np.pi * large)
    return np.where(x < _I0_SAFE, np.i0(small) * np.exp(-small), series)


def _pixel_mean(log_curve: Monotone, across: Array, along: Array, footprint: tuple[float, float]) -> Array:
    """The curve averaged over the rectangle of each pixel."""
    nodes, weights = _NODES
    mean = np.zeros_like(across)
    for u, weight_u in zip(nodes, weights, strict=True):
        for v, weight_v in zip(nodes, weights, strict=True):
            r = np.hypot(across + u * footprint[0] / 2, along + v * footprint[1] / 2)
            mean += weight_u * weight_v / 4 * np.exp(log_curve(r))
    return mean


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
