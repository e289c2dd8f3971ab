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
        self.samples = np.zeros((height, width), np.float32)
        """Of each pixel."""
        self.mean = np.zeros((height, width, 3), np.float32)
        self._times = np.zeros((height, width), np.float32)
        self._squares = np.zeros((height, width, 3), np.float32)

    def add(self, drawn: Pixels, samples: int, where: Mask | None = None) -> None:
        """One pass of so many samples per pixel, of all pixels (h, w, 3) or of some (k, 3) (West 1979)."""
        rows: Any = ... if where is None else where
        self.count += 1
        self.samples[rows] += samples
        self._times[rows] += 1
        step = drawn - self.mean[rows]
        self.mean[rows] += step * (samples / self.samples[rows])[..., None]
        self._squares[rows] += samples * step * (drawn - self.mean[rows])

    def variance(self, where: Mask | None = None) -> Pixels:
        """Of the mean, (h, w, 3) or of some pixels (k, 3)."""
        rows: Any = ... if where is None else where
        degrees = np.maximum(self._times[rows] - 1, 1) * self.samples[rows]
        return np.asarray(self._squares[rows] / degrees[..., None])

    def noise(self, where: Mask) -> float:
        """Root mean square of the relative standard error of those pixels that are lit."""
        mean = self.mean[where]
        lit = np.count_nonzero(mean.max(axis=1) > 0)
        return float(np.sqrt(_relative_variance(mean, self.variance(where)).sum(dtype=np.float64) / max(lit, 1)))

    def excess(self, where: Mask, noise: float) -> Pixels:
        """Of those pixels, (h, w): the variance of their neighbourhood over that of a relative noise."""
        own = np.zeros(where.shape, np.float32)
        own[where] = _relative_variance(self.mean[where], self.variance(where))
        share = ndimage.uniform_filter(where.astype(np.float32), _AROUND)
        around = ndimage.uniform_filter(own, _AROUND) / np.maximum(share, 1 / _AROUND**2)
        return np.where(where, around / noise**2, np.float32(0))


def _relative_variance(mean: NDArray[Any], variance: NDArray[Any]) -> NDArray[Any]:
    """Of pixels (k, 3), the mean over channels; those far below the mean are held to a tenth of it; 0 of dark ones."""
    lit = mean.max(axis=1) > 0
    if not lit.any():
        return np.zeros(len(mean), mean.dtype)
    target = np.square(mean) + EPSILON * np.square(mean[lit].mean(axis=0, dtype=np.float64))
    return np.where(lit, (variance / np.maximum(target, 1e-30)).mean(axis=1), 0)
