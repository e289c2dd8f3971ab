"""A picture as the sum of passes of their own seeds, whose scatter is its noise, and where it needs more of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from bssrdf.render.picture import EPSILON, Pixels

_AROUND = 5
"""Pixels a side over which noise is averaged before it is believed: two passes alone tell little of one pixel."""

Mask = NDArray[np.bool_]


class Passes:
    """Mean and variance of what was drawn so far; some pixels may have been drawn more often than others."""

    def __init__(self, height: int, width: int) -> None:
        self.count = 0
        self.samples = np.zeros((height, width))
        """Of each pixel."""
        self.mean = np.zeros((height, width, 3))
        self._times = np.zeros((height, width))
        self._squares = np.zeros((height, width, 3))

    def add(self, drawn: Pixels, samples: int, where: Mask | None = None) -> None:
        """One pass of so many samples per pixel, of all pixels (h, w, 3) or of some (k, 3) (West 1979)."""
        rows = np.ones(self.samples.shape, bool) if where is None else where
        self.count += 1
        self.samples[rows] += samples
        self._times[rows] += 1
        step = drawn.reshape(-1, 3) - self.mean[rows]
        self.mean[rows] += step * (samples / self.samples[rows])[:, None]
        self._squares[rows] += samples * step * (drawn.reshape(-1, 3) - self.mean[rows])

    def variance(self) -> NDArray[np.float64]:
        """Of the mean, (h, w, 3)."""
        return self._squares / (np.maximum(self._times - 1, 1) * self.samples)[..., None]

    def noise(self, where: Mask) -> float:
        """Root mean square of the relative standard error of those pixels."""
        return relative_noise(self.mean, self.variance(), where)

    def excess(self, where: Mask, noise: float) -> NDArray[np.float64]:
        """Of those pixels, (h, w): the variance of their neighbourhood over that of a relative noise."""
        own = relative_variance(self.mean, self.variance(), where)
        share = ndimage.uniform_filter(where.astype(np.float64), _AROUND)
        around = ndimage.uniform_filter(own, _AROUND) / np.maximum(share, 1 / _AROUND**2)
        return np.where(where, around / noise**2, 0)


def relative_variance(mean: NDArray[Any], variance: NDArray[Any], where: Mask) -> NDArray[np.float64]:
    """Of pixels (h, w), the mean over channels; those far below the mean are held to a tenth of it; 0 elsewhere."""
    lit = where & (mean.max(axis=2) > 0)
    found = np.zeros(lit.shape)
    if lit.any():
        target = np.square(mean[lit]) + EPSILON * np.square(mean[lit].mean(axis=0))
        found[lit] = (variance[lit] / np.maximum(target, 1e-30)).mean(axis=1)
    return found


def relative_noise(mean: NDArray[Any], variance: NDArray[Any], where: Mask) -> float:
    """Root mean square of the relative standard error of lit pixels, those far below the mean held to a tenth of it."""
    lit = np.count_nonzero(where & (mean.max(axis=2) > 0))
    return float(np.sqrt(relative_variance(mean, variance, where).sum() / max(lit, 1)))
