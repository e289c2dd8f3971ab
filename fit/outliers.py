"""Radii that lie far from a curve whose other radii follow one another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.batch import Fitted
from bssrdf.fit.layout import median_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
NEIGHBOURS = 5
OUTLIER = 6.0
"""Standard deviations from the median of NEIGHBOURS radii."""
FEW_OUTLIERS = 0.2
"""Share of the radii: more are another curve."""


def has_outliers(fitted: Fitted, poor: Bools) -> Bools:
    """Of the `poor` rows those where a few radii lie far from their neighbours, which all follow one another."""
    found = np.zeros(len(fitted.jobs), bool)
    rows = np.flatnonzero(poor)
    if not rows.size:
        return found
    ease = fitted.found.ease[rows, None]
    away = np.concatenate(
        [
            _from_neighbours((mean[rows] - value[rows]) * np.sqrt(mass[rows] * ease), mass[rows] > 0)
            for mass, mean, (value, _, _) in zip(*fitted.found.weights, fitted.judged.seen.curves, strict=True)
        ],
        axis=1,
    )
    counts = ~np.isnan(away)
    few = (away > OUTLIER).sum(axis=1) < FEW_OUTLIERS * counts.sum(axis=1)
    found[rows] = (away > OUTLIER).any(axis=1) & few & (median_of(away, counts) < OUTLIER / 3)
    return found


def _from_neighbours(misses: Floats, counts: Bools) -> Floats:
    """How far each miss [sd] lies from the median of those around it, in order of radius; NaN where none is."""
    n = counts.sum(axis=1, keepdims=True)
    ordered = np.take_along_axis(misses, np.argsort(~counts, axis=1, kind="stable"), axis=1)
    at = np.abs(np.arange(-(NEIGHBOURS // 2), misses.shape[1] + NEIGHBOURS // 2))
    at = np.clip(np.where(at < n, at, 2 * (n - 1) - at), 0, None)  # reflected at either end
    around = np.lib.stride_tricks.sliding_window_view(np.take_along_axis(ordered, at, axis=1), NEIGHBOURS, axis=1)
    away = np.abs(ordered - np.sort(around, axis=2)[..., NEIGHBOURS // 2])
    return np.where((n > NEIGHBOURS) & (np.arange(misses.shape[1]) < n), away, np.nan)
