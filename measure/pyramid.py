"""A channel's pixels near the beam, and blocks of them that grow with the distance: all that a curve needs of a frame.

A curve is averaged over rings whose width grows with their radius, so far from the beam single pixels only cost memory
and time. Blocks of 2^k pixels a side are means of their good pixels; single ones that stand out are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bssrdf.measure.pixels import Grid
from bssrdf.session.records import Array

_FAR = 48
"""Blocks are taken from this many of their own sides on: a curve that falls by e^10 on the way is bent by 0.2 %."""
_REJECT_SD = 6.0
_NOISE_SD = 4.0
_MEDIAN_TO_SD = 1.4826

_fused: Any = njit(cache=True, nogil=True, error_model="numpy")


class Blocks(NamedTuple):
    """Pixels, and blocks of them; arrays of shape (n,)."""

    x_px: Array
    y_px: Array
    value: Array
    """Mean radiance [DN/s] of the good pixels that do not stand out; NaN where there is none."""
    variance: Array
    """Of that mean."""
    n: Array
    """Pixels in that mean."""
    light: Array
    """Sum of the radiance over all good pixels."""
    n_missing: Array
    """Pixels of the frame that are not good."""


class _Level(NamedTuple):
    """Sums over blocks of one size, each of shape (rows, columns)."""

    n: NDArray[np.float32]
    value: NDArray[np.float32]
    variance: NDArray[np.float32]
    light: NDArray[np.float32]
    n_good: NDArray[np.float32]


class Pyramid:
    """A grid of pixels, with blocks of 2, 4, 8 … pixels a side."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid

    @cached_property
    def light_by_count(self) -> Array:
        """Light of the good pixels by the number of samples that were merged for each."""
        grid = self.grid
        return np.asarray(_light_by_count(grid.radiance, grid.mask, grid.count, int(grid.count.max()) + 1))

    @cached_property
    def _levels(self) -> list[_Level]:
        """Blocks of 2, 4, 8 … pixels, as long as a block may lie far enough from the beam to be used."""
        grid = self.grid
        levels = [_Level(*_pair(grid.radiance, grid.variance, grid.mask))]
        while _FAR * 2 ** len(levels) < max(grid.radiance.shape):
            levels.append(_Level(*(_halved(plane) for plane in levels[-1])))
        return levels

    def around(
        self,
        centre_px: tuple[float, float],
        keep: Callable[[Array, Array, float], NDArray[np.bool_]] | None = None,
        most: float = np.inf,
    ) -> Blocks:
        """Every pixel once: single, or in a block whose distance from `centre_px` is many of its sides.

        `keep` says of block centres x, y and a side [px] which blocks may hold pixels that are needed; `most` is the
        largest side [px].
        """
        top = len(self._levels)
        rows, columns = (axis.ravel() for axis in np.indices(self._shape(top)))
        parts = []
        for k in range(top, -1, -1):
            x, y, _ = self._places(k, rows, columns)
            side = 2.0**k * self.grid.step_px
            if keep is not None:
                kept = keep(x, y, side)
                rows, columns, x, y = rows[kept], columns[kept], x[kept], y[kept]
            far = np.hypot(x - centre_px[0], y - centre_px[1]) >= _FAR * side
            whole = far & (side <= most) if k else np.full(len(x), True)
            parts.append(self._blocks(k, rows[whole], columns[whole]))
            rows, columns = self._children(k, rows[~whole], columns[~whole])
        return Blocks(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))

    def window(self, centre_px: tuple[float, float], half_px: float, k: int = 0) -> Blocks:
        """The blocks of 2^k pixels a side whose centres lie in a square of half width `half_px`."""
        k = min(k, len(self._levels))
        pitch = 2**k * self.grid.step_px
        ranges = []
        for centre, first, size in zip(centre_px, self.grid.first_px, self._shape(k)[::-1], strict=True):
            middle = (centre - first) / pitch
            low, high = (int(np.clip(round(middle + side * half_px / pitch), 0, size)) for side in (-1, 1))
            ranges.append(np.arange(low, max(high, low)))
        rows, columns = (axis.ravel() for axis in np.meshgrid(ranges[1], ranges[0], indexing="ij"))
        return self._blocks(k, rows, columns)

    def _shape(self, k: int) -> tuple[int, int]:
        height, width = self._levels[k - 1].n.shape if k else self.grid.radiance.shape[:2]
        return height, width

    def _children(self, k: int, rows: Any, columns: Any) -> tuple[Any, Any]:
        """The four blocks half as large that each block holds, those off the grid left out."""
        if k == 0:
            return rows, columns
        height, width = self._shape(k - 1)
        row = (2 * rows[:, None] + np.array([0, 0, 1, 1])).ravel()
        column = (2 * columns[:, None] + np.array([0, 1, 0, 1])).ravel()
        there = (row < height) & (column < width)
        return row[there], column[there]

    def _places(self, k: int, rows: Any, columns: Any) -> tuple[Array, Array, Array]:
        """Centres x, y [px] of blocks, and how many pixels of the grid they hold."""
        side, (height, width) = 2**k, self.grid.radiance.shape[:2]
        high, wide = (np.minimum(side, size - side * at) for at, size in ((rows, height), (columns, width)))
        x = self.grid.first_px[0] + self.grid.step_px * (side * columns + (wide - 1) / 2)
        y = self.grid.first_px[1] + self.grid.step_px * (side * rows + (high - 1) / 2)
        return x, y, (high * wide).astype(float)

    def _blocks(self, k: int, rows: Any, columns: Any) -> Blocks:
        x, y, pixels = self._places(k, rows, columns)
        if k:
            n, value, variance, light, n_good = (plane[rows, columns].astype(float) for plane in self._levels[k - 1])
        else:
            light, variance = (plane[rows, columns].astype(float) for plane in (self.grid.radiance, self.grid.variance))
            n = n_good = ((self.grid.mask[rows, columns] == 0) & np.isfinite(light)).astype(float)
            light = value = np.where(n > 0, light, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return Blocks(x, y, value / n, variance / n**2, n, light, pixels - n_good)


def _halved(plane: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sums over 2 × 2 elements; at an odd end over those that are there."""
    even = np.pad(plane, [(0, size % 2) for size in plane.shape])
    return np.asarray(even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2])


@_fused
def _light_by_count(radiance: Any, mask: Any, count: Any, n: int) -> Any:
    sums = np.zeros(n)
    for y in range(radiance.shape[0]):
        for x in range(radiance.shape[1]):
            if mask[y, x] == 0 and np.isfinite(radiance[y, x]):
                sums[count[y, x]] += radiance[y, x]
    return sums


@_fused
def _pair(radiance: Any, variance: Any, mask: Any) -> Any:
    """The sums of `_Level` over 2 × 2 pixels: those that stand out of the four are left out of the mean."""
    height, width = radiance.shape
    shape = ((height + 1) // 2, (width + 1) // 2)
    n, value, var = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    light, n_good = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    found, noise = np.empty(4), np.empty(4)
    for row in range(shape[0]):
        for column in range(shape[1]):
            good, total = 0, 0.0
            for y in range(2 * row, min(2 * row + 2, height)):
                for x in range(2 * column, min(2 * column + 2, width)):
                    if mask[y, x] == 0 and np.isfinite(radiance[y, x]):
                        found[good], noise[good] = radiance[y, x], variance[y, x]
                        total += found[good]
                        good += 1
            light[row, column], n_good[row, column] = total, good
            plain = True
            for i in range(good):
                plain &= abs(found[i] - total / good) <= _NOISE_SD * np.sqrt(noise[i])
            middle = scatter = 0.0
            if not plain:
                middle = np.median(found[:good])
                scatter = _MEDIAN_TO_SD * np.median(np.abs(found[:good] - middle))
            for i in range(good):
                sd = np.fmax(np.sqrt(noise[i]), scatter)
                if plain or abs(found[i] - middle) <= _REJECT_SD * sd:
                    n[row, column] += 1
                    value[row, column] += found[i]
                    var[row, column] += noise[i]
    return n, value, var, light, n_good
