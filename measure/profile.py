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
Members = NDArray[np.int64]
"""How many points each bin has; the points of a bin stand together, bin after bin."""

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
        near = r <= self._switch
        value = np.empty_like(r)
        value[near], value[~near] = np.exp(self._near(r[near])), self._far(r[~near])
        return value


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
    points, r, members = _by_bins(points, edges)
    weight = points.n * _density_weight(r, band)
    if band is not None:
        weight *= _balance(points, members)
    flat = np.ones(len(edges) - 1)
    keep = _not_outlying(points, np.zeros(len(r)), members)
    out = _bins(points, edges, members, weight, np.ones(len(r)), flat, 0 * flat, keep)
    for _ in range(_PASSES):
        curve = Curve(out)
        model = _footprint_mean(curve, points, r, footprint)
        keep = _not_outlying(points, model, members)
        out = _bins(points, edges, members, weight, model, _annulus_mean(curve, edges), _steepness(curve, edges), keep)
    return out


def _by_bins(points: Points, edges: Array) -> tuple[Points, Array, Members]:
    """The points within the last edge, those of a bin together, their radii, and how many each bin has."""
    r = np.hypot(points.across, points.along)
    index = np.searchsorted(edges, r, side="right") - 1
    members = np.bincount(index, minlength=len(edges))[: len(edges) - 1]
    order = np.argsort(index.astype(np.int16), kind="stable")[: members.sum()]  # a radix sort, for 16 bits
    return Points(*(field[order] for field in points)), r[order], members


def _sums(x: Array, members: Members) -> Array:
    """The sum over each bin's values, which stand together."""
    sums, there = np.zeros(len(members)), members > 0
    if there.any():
        sums[there] = np.add.reduceat(x, (np.cumsum(members) - members)[there])
    return sums


def _medians(values: Array, members: Members) -> Array:
    """The median of each bin's values; 0 of an empty one's."""
    medians, last, single = np.zeros(len(members)), np.cumsum(members), values.astype(np.float32)
    for at in np.flatnonzero(members):
        own, middle = single[last[at] - members[at] : last[at]].copy(), members[at] // 2
        own.partition(middle)
        medians[at] = own[middle] if members[at] % 2 else (own[middle] + own[:middle].max()) / 2
    return medians


def _density_weight(r: Array, band: float | None) -> Array:
    """One over the share of the circle of radius r that lies in the band: makes the mean one in r dr."""
    if band is None:
        return np.ones_like(r)
    return 1 / (2 / np.pi * np.arcsin(np.minimum(1, band / 2 / np.maximum(r, 1e-12))))


def _balance(points: Points, members: Members) -> Array:
    """Weights that put the mean of each bin's pixels on the slice: light runs outwards, so that a camera at an angle
    sees more on its own side, and of a mosaic's colour more rows may lie on one."""
    ahead, behind = (_sums(points.n * np.maximum(sign * points.along, 0), members) for sign in (1, -1))
    both = (ahead > 0) & (behind > 0)
    ratio = np.repeat(np.sqrt(np.divide(behind, ahead, out=np.ones(len(members)), where=both)), members)
    return np.where(points.along > 0, ratio, 1 / ratio)


def _bins(
    points: Points,
    edges: Array,
    members: Members,
    weight: Array,
    model: Array,
    bin_model: Array,
    steepness: Array,
    keep: NDArray[np.bool_],
) -> RadialProfile:
    if not keep.all():
        members = _sums(keep.astype(float), members).astype(int)
        points, weight, model = Points(*(field[keep] for field in points)), weight[keep], model[keep]
    n, weights = _sums(points.n, members), _sums(weight, members)
    with np.errstate(divide="ignore", invalid="ignore"):
        noise, modelled = np.sqrt(_sums(weight**2 * points.variance, members)), _sums(weight * model, members)
        ratio = _sums(weight * points.value, members) / modelled
        offset = _sums(weight * (points.value - model), members) / weights
        clear = bin_model > _CLEAR_SD * noise / weights
        value = np.where(clear, ratio * bin_model, bin_model + offset)
        share = np.where(clear, bin_model / modelled, 1 / weights)
        merge_sd = noise * np.abs(share)
        scale, shift = np.repeat(np.where(clear, ratio, 1.0), members), np.repeat(np.where(clear, 0.0, offset), members)
        scatter = np.sqrt(_sums((weight * (points.value - scale * model - shift)) ** 2, members))
        scatter_sd = scatter * np.sqrt(members / np.maximum(members - 1, 1)) * np.abs(share)
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


def _footprint_mean(curve: Curve, points: Points, r: Array, footprint: tuple[float, float]) -> Array:
    """The curve averaged over each pixel's rectangle, by Gauss–Legendre quadrature; far out, its value there."""
    nodes, weights = _NODES
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


def _not_outlying(points: Points, model: Array, members: Members) -> NDArray[np.bool_]:
    """Points within a few robust standard deviations of the smooth curve, judged bin by bin."""
    residual = points.value - model
    residual -= np.repeat(_medians(residual, members), members)
    distance = np.abs(residual)
    scatter = np.repeat(1.4826 * _medians(distance, members), members)
    sd = np.fmax(np.sqrt(points.variance), scatter)
    few = np.repeat(members < _LEAST_MEMBERS, members)
    return np.asarray(few | (distance <= _REJECT_SD * np.maximum(sd, 1e-3 * np.abs(model))))
