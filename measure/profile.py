"""The curve over the distance from the beam, from pixels and blocks of them that lie on it. Lengths in mm.

A bin holds ∫f r dr/∫r dr over [r_lo, r_hi]. Its pixels are few and lie anywhere in it, so they are compared with a
smooth curve drawn through all bins, averaged over each pixel's own footprint; the bin's value is that curve's exact
bin average times the ratio of the sums. So neither the width of a bin nor that of a pixel bends a steep curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import Monotone

Array = NDArray[np.float64]

_GROWTH = 0.04
"""A bin is this fraction of its radius wide, or one step of the channel's grid."""
_CLEAR_SD = 5.0
"""Of a bin's noise: a curve below may cross 0 within the bin, and is added to the data and not multiplied."""
_REJECT_SD = 6.0
_LEAST_MEMBERS = 5
"""Fewer do not tell which of them stands out."""
_PASSES = 2
_SHAPE_REL_SD = 0.08
"""What the smooth curve is off by in a bin of one pixel over which it falls by a factor of e."""
_FAR_FOOTPRINTS = 30
_NODES = np.polynomial.legendre.leggauss(3)


class Points(NamedTuple):
    """Pixels of one channel on the surface around the beam, or means over blocks of them; arrays of shape (n,)."""

    across: Array
    along: Array
    value: Array
    variance: Array
    """NaN where unknown."""
    n: Array
    """Pixels that each stands for."""


@dataclass(frozen=True)
class RadialProfile:
    """Bins of a curve, arrays of shape (m,), and the smooth curve drawn through them."""

    r_lo: Array
    r_hi: Array
    value: Array
    sd: Array
    n: Array
    """Pixels."""

    @property
    def r(self) -> Array:
        """Radius that stands for a bin: the mean of r over its annulus."""
        return 2 / 3 * (self.r_hi**3 - self.r_lo**3) / (self.r_hi**2 - self.r_lo**2)

    def curve(self) -> Curve:
        return Curve(self)


class Curve:
    """Smooth monotone interpolation of a profile: through ln f where f is well above its error, linear elsewhere.

    Within the innermost bin ln f is a parabola about the centre, as an even function has it.
    """

    def __init__(self, profile: RadialProfile) -> None:
        r, value = profile.r, profile.value
        clear = value > 5 * profile.sd
        n = len(r) if clear.all() else int(np.argmin(clear))
        self._far = Monotone(r, value) if len(r) > 1 else None
        self._near = _near_the_centre(r[:n], np.log(value[:n])) if n > 1 else None
        self._first, self._last = 0.0 if self._near else r[0], profile.r_hi[-1]
        self._switch = -1.0 if n == 0 else self._last if n == len(r) else r[n - 1]
        self._constant = value[0]

    def __call__(self, r: Array) -> Array:
        r = np.clip(r, self._first, self._last)
        if self._far is None:
            return np.full_like(r, self._constant)
        if self._near is None:
            return self._far(r)
        return np.where(r <= self._switch, np.exp(self._near(np.minimum(r, self._switch))), self._far(r))


def _near_the_centre(r: Array, log_value: Array) -> Monotone:
    """Interpolation of ln f that goes on to r = 0, and there has no slope."""
    bend = (log_value[0] - log_value[1]) / (r[1] ** 2 - r[0] ** 2)
    peak = log_value[0] + bend * r[0] ** 2
    inner = r[0] * np.array([0.0, 0.5])
    return Monotone(np.append(inner, r), np.append(peak - bend * inner**2, log_value))


def bin_edges(step: float, r_max: float) -> Array:
    """Edges from 0 up to `r_max`, a grid step apart and further out a fixed fraction of the radius."""
    edges = [0.0, step]
    while (following := edges[-1] + max(step, _GROWTH * edges[-1])) <= r_max:
        edges.append(following)
    return np.array(edges)


def profile(points: Points, edges: Array, footprint: tuple[float, float], band: float | None) -> RadialProfile:
    """Robust bin averages of `points`.

    `footprint` is the width of a pixel across and along; `band` the full width of the slice along the view, None for
    the whole image. Pixels that stand out of their bin (dust, glints) are left out. The error is the larger of that
    of the merge and that of the scatter, and what the curve's shape is not known by where it is steep and pixels few.
    """
    r = np.hypot(points.across, points.along)
    points, r = Points(*(field[r < edges[-1]] for field in points)), r[r < edges[-1]]
    index = np.searchsorted(edges, r, side="right") - 1
    weight = points.n * _density_weight(r, band)
    if band is not None:
        weight *= _balance(points, index, len(edges) - 1)
    flat = np.ones(len(edges) - 1)
    keep = _not_outlying(points, np.zeros(len(r)), index, len(edges) - 1)
    out = _bins(points, edges, index, weight, np.ones(len(r)), flat, 0 * flat, keep)
    for _ in range(_PASSES):
        curve = Curve(out)
        model = _footprint_mean(curve, points, footprint)
        keep = _not_outlying(points, model, index, len(edges) - 1)
        out = _bins(points, edges, index, weight, model, _annulus_mean(curve, edges), _steepness(curve, edges), keep)
    return out


def _density_weight(r: Array, band: float | None) -> Array:
    """One over the share of the circle of radius r that lies in the band: makes the mean one in r dr."""
    if band is None:
        return np.ones_like(r)
    return 1 / (2 / np.pi * np.arcsin(np.minimum(1, band / 2 / np.maximum(r, 1e-12))))


def _balance(points: Points, index: NDArray[np.int64], n_bins: int) -> Array:
    """Weights that put the mean of each bin's pixels on the slice: light runs outwards, so that a camera at an angle
    sees more on its own side, and of a mosaic's colour more rows may lie on one."""
    ahead, behind = (np.bincount(index, points.n * np.maximum(sign * points.along, 0), n_bins) for sign in (1, -1))
    both = (ahead > 0) & (behind > 0)
    ratio = np.sqrt(np.divide(behind, ahead, out=np.ones(n_bins), where=both))[index]
    return np.where(points.along > 0, ratio, 1 / ratio)


def _bins(
    points: Points,
    edges: Array,
    index: NDArray[np.int64],
    weight: Array,
    model: Array,
    bin_model: Array,
    steepness: Array,
    keep: NDArray[np.bool_],
) -> RadialProfile:
    n_bins = len(edges) - 1

    def total(x: Array) -> Array:
        return np.bincount(index[keep], x[keep], n_bins).astype(float)

    members, n = np.bincount(index[keep], minlength=n_bins), total(points.n)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights, noise = total(weight), np.sqrt(total(weight**2 * points.variance))
        ratio, offset = (
            total(weight * points.value) / total(weight * model),
            total(weight * (points.value - model)) / weights,
        )
        clear = bin_model > _CLEAR_SD * noise / weights
        value = np.where(clear, ratio * bin_model, bin_model + offset)
        share = np.where(clear, bin_model / total(weight * model), 1 / weights)
        merge_sd = noise * np.abs(share)
        residual = points.value - np.where(clear[index], ratio[index] * model, model + offset[index])
        scatter_sd = np.sqrt(total((weight * residual) ** 2) * members / np.maximum(members - 1, 1)) * np.abs(share)
        shape_sd = _SHAPE_REL_SD * np.abs(value) * (steepness / n) ** 2
    scatter_sd[members < 3] = np.nan
    used = n > 0
    return RadialProfile(
        edges[:-1][used],
        edges[1:][used],
        value[used],
        np.hypot(np.fmax(merge_sd, scatter_sd), shape_sd)[used],
        n[used],
    )


def _footprint_mean(curve: Curve, points: Points, footprint: tuple[float, float]) -> Array:
    """The curve averaged over each pixel's rectangle, by Gauss–Legendre quadrature; far out, its value there."""
    nodes, weights = _NODES
    r = np.hypot(points.across, points.along)
    out = curve(r)
    near = r < _FAR_FOOTPRINTS * max(footprint)
    across, along = points.across[near], points.along[near]
    out[near] = 0
    for u, weight_u in zip(nodes, weights, strict=True):
        for v, weight_v in zip(nodes, weights, strict=True):
            corner = np.hypot(across + u * footprint[0] / 2, along + v * footprint[1] / 2)
            out[near] += weight_u * weight_v / 4 * curve(corner)
    return out


def _annulus_mean(curve: Curve, edges: Array) -> Array:
    """∫f r dr/∫r dr over each bin."""
    nodes, weights = _NODES
    lo, hi = edges[:-1, None], edges[1:, None]
    r = (hi + lo) / 2 + (hi - lo) / 2 * nodes
    return (curve(r) * r * weights).sum(1) / (r * weights).sum(1)


def _steepness(curve: Curve, edges: Array) -> Array:
    """|ln| of the curve's ratio over a bin or the next, whichever is larger; 0 where the curve is not above 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        drop = np.nan_to_num(np.abs(np.diff(np.log(np.maximum(curve(edges), 0)))), posinf=0.0)
    return np.maximum(drop, np.append(drop[1:], 0.0))


def _not_outlying(points: Points, model: Array, index: NDArray[np.int64], n_bins: int) -> NDArray[np.bool_]:
    """Points within a few robust standard deviations of the smooth curve, judged bin by bin."""
    members = np.bincount(index, minlength=n_bins)
    residual = points.value - model
    residual = residual - _medians(residual, index, members)[index]
    scatter = 1.4826 * _medians(np.abs(residual), index, members)[index]
    sd = np.fmax(np.sqrt(points.variance), scatter)
    few = members[index] < _LEAST_MEMBERS
    return np.asarray(few | (np.abs(residual) <= _REJECT_SD * np.maximum(sd, 1e-3 * np.abs(model))))


def _medians(values: Array, index: NDArray[np.int64], members: NDArray[np.int64]) -> Array:
    """The median of each bin's values; 0 of an empty one's."""
    rising = np.argsort(values)
    ordered = values[rising][np.argsort(index[rising].astype(np.int16), kind="stable")]  # a radix sort, for 16 bits
    ordered = np.append(ordered, 0.0)
    first = np.cumsum(members) - members
    low, high = (np.minimum(first + k, len(values)) for k in ((members - 1) // 2, members // 2))
    return np.where(members > 0, (ordered[low] + ordered[high]) / 2, 0.0)
