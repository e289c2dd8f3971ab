"""Light that leaves a sample, seen with a beam of a Gaussian spot instead of a thin one. Lengths in mm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import ive, ndtr

from bssrdf.rig.sim.light import SeenLight

Array = NDArray[np.float64]

_RINGS_PER_SIGMA = 8
_REACH_SIGMA = 100.0
"""Beyond this many σ of the spot, its width changes the curve by less than 0.1 %."""
_LINE_POINTS = 4000
_FLOOR = 1e-30
_FAINT_RATIO = 1e-9
"""Of a harmonic: less would overflow its interpolation."""


class Radiance:
    """πL/Φ [1/mm²] at points of the surface, the beam at the origin and the camera towards +y.

    The spot has a 1/e² radius of `spot_radius_mm`; nothing is known beyond `r_max_mm`. A ring of radius s whose light
    goes as cos nφ, spread by a Gaussian of σ = spot radius/2, is cos nφ exp(−(r² + s²)/2σ²) Iₙ(rs/σ²)/(2πσ²).
    """

    def __init__(self, light: SeenLight, spot_radius_mm: float, r_max_mm: float) -> None:
        sigma = spot_radius_mm / 2
        reach = min(_REACH_SIGMA * sigma, r_max_mm)
        edges = np.linspace(0.0, reach, int(_RINGS_PER_SIGMA * reach / sigma) + 1)
        near = np.linspace(0.0, reach - 4 * sigma, len(edges) // 2)
        far_edges = np.geomspace(reach, max(r_max_mm, 1.01 * reach), 100)
        far = np.sqrt(far_edges[1:] * far_edges[:-1])
        rings, s = _rings(light, edges), (edges[1:] + edges[:-1]) / 2
        gaussian = np.exp(-((near[:, None] - s) ** 2) / (2 * sigma**2)) / (2 * np.pi * sigma**2)
        rows = []
        for n, (ring, beyond) in enumerate(zip(rings, _rings(light, far_edges), strict=True)):
            at_near = (gaussian * ive(n, near[:, None] * s / sigma**2)) @ ring
            rows.append(np.concatenate([at_near, beyond / (np.pi * np.diff(far_edges**2))]))
        r, mean = np.concatenate([near, far]), np.maximum(rows[0], _FLOOR)
        self._log_mean = PchipInterpolator(r, np.log(mean))
        self._ratios = None
        if rows[1:]:
            ratios = np.stack([row / mean for row in rows[1:]], axis=1)
            self._ratios = PchipInterpolator(r, np.where(np.abs(ratios) > _FAINT_RATIO, ratios, 0.0))
        self._sigma = sigma
        self._along: tuple[Array, Array] | None = None
        if light.line_beyond is not None:
            t = np.linspace(-6 * sigma, r_max_mm, _LINE_POINTS)
            self._along = t, _spread_line(light.r_edges_mm, light.line_beyond, sigma, t)

    def __call__(self, x: Array, y: Array) -> Array:
        r = np.hypot(x, y)
        out = np.exp(self._log_mean(r))
        if self._ratios is not None:
            cosine = y / np.maximum(r, 1e-12)
            out *= np.maximum(1 + _cosine_series(np.moveaxis(self._ratios(r), -1, 0), cosine), 0)
        if self._along is not None:
            across = np.exp(-(x**2) / (2 * self._sigma**2)) / (np.sqrt(2 * np.pi) * self._sigma)
            out += across * np.interp(y, *self._along)
        return out


def _rings(light: SeenLight, edges: Array) -> list[Array]:
    """Light between the edges: its mean over azimuths, and each harmonic's share."""
    beyond = _at(light.r_edges_mm, light.beyond, edges)
    mean = -np.diff(beyond)
    if light.harmonics is None:
        return [mean]
    middle = np.sqrt(np.maximum(light.r_edges_mm[1:] * light.r_edges_mm[:-1], light.r_edges_mm[1:] ** 2 / 4))
    s = (edges[1:] + edges[:-1]) / 2
    return [mean, *(mean * np.interp(np.log(s), np.log(middle), row) for row in light.harmonics)]


def _at(r_edges_mm: Array, beyond: Array, r_mm: Array) -> Array:
    """Light from farther out than each radius: its logarithm is smooth in ln r, so bins of 10 % do for 0.1 %."""
    known = beyond > 0
    if not known.any():
        return np.zeros_like(r_mm)
    inner = r_edges_mm[1] * 1e-3
    curve = PchipInterpolator(np.log(np.maximum(r_edges_mm[known], inner)), np.log(beyond[known]), extrapolate=False)
    return np.nan_to_num(np.exp(curve(np.log(np.maximum(r_mm, inner)))), nan=0.0)


def _spread_line(r_edges_mm: Array, beyond: Array, sigma: float, t: Array) -> Array:
    """Light per mm along a line from the origin, spread by a Gaussian along it."""
    fine = np.concatenate([[0.0], np.geomspace(1e-3 * sigma, max(t[-1], sigma), 600)])
    mass = -np.diff(_at(r_edges_mm, beyond, fine))
    reached = ndtr((t[:, None] - fine) / sigma)
    return (reached[:, :-1] - reached[:, 1:]) @ (mass / np.diff(fine))


def _cosine_series(amplitudes: Array, cosine: Array) -> Array:
    """Σ amplitudes[k] cos((k + 1) φ) by Chebyshev's recurrence."""
    before, current, total = np.ones_like(cosine), cosine, np.zeros_like(cosine)
    for amplitude in amplitudes:
        total += amplitude * current
        before, current = current, 2 * cosine * current - before
    return total
