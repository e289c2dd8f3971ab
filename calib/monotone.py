"""Monotone cubic interpolation (Fritsch & Carlson 1980, slopes after Fritsch & Butland 1984)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_EVEN = 1e-9
"""Relative difference of widths that are one: a place so near to a point may be counted to the cell before it."""


class Monotone:
    """A smooth curve through points x ascending, y of shape (n,), n ≥ 2: nowhere does it swing beyond them.

    It goes on beyond its ends as its outermost cubics do.
    """

    def __init__(self, x: Array, y: Array) -> None:
        width, slope = np.diff(x), np.diff(y) / np.diff(x)
        at_points = _slopes(width, slope)
        first, last = at_points[:-1], at_points[1:]
        self._x = x
        self._pitch = float(width[0]) if np.ptp(width) < _EVEN * width[0] else None
        self._powers = np.stack(
            [y[:-1], first, (3 * slope - 2 * first - last) / width, (first + last - 2 * slope) / width**2]
        )

    def __call__(self, x: Array) -> Array:
        cell = self._cell(x)
        t = x - self._x.take(cell)
        a, b, c, value = (power.take(cell) for power in self._powers)
        for power in (c, b, a):
            value *= t
            value += power
        return np.asarray(value)

    def _cell(self, x: Array) -> NDArray[np.intp]:
        if self._pitch is None:
            cell = np.searchsorted(self._x, x, side="right") - 1
        else:
            cell = ((x - self._x[0]) / self._pitch).astype(np.intp)
        return np.clip(cell, 0, len(self._x) - 2, out=cell)


def _slopes(width: Array, slope: Array) -> Array:
    """Weighted harmonic means of the slopes on both sides of a point, 0 where these turn."""
    if len(slope) == 1:
        return np.repeat(slope, 2)
    w_1, w_2 = 2 * width[1:] + width[:-1], width[1:] + 2 * width[:-1]
    turns = slope[1:] * slope[:-1] <= 0
    with np.errstate(divide="ignore", invalid="ignore"):
        inner = np.where(turns, 0.0, (w_1 + w_2) / (w_1 / slope[:-1] + w_2 / slope[1:]))
    ends = (_end_slope(*width[:2], *slope[:2]), _end_slope(*width[:-3:-1], *slope[:-3:-1]))
    return np.concatenate([[ends[0]], inner, [ends[1]]])


def _end_slope(width: float, next_width: float, slope: float, next_slope: float) -> float:
    """That of the parabola through the last three points, as far as it keeps the curve monotone."""
    d = ((2 * width + next_width) * slope - width * next_slope) / (width + next_width)
    if d * slope <= 0:
        return 0.0
    return 3 * slope if slope * next_slope <= 0 and abs(d) > 3 * abs(slope) else d
