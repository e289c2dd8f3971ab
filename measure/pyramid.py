"""A channel's pixels near the beam, and blocks of them that grow with the distance: all that a curve needs of a frame.

A curve is averaged over rings whose width grows with their radius, so far from the beam single pixels only cost memory
and time. Blocks of 2^k pixels a side are means of their good pixels; single ones that stand out are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.measure.hdr import Pixels
from bssrdf.measure.pixels import Grid
from bssrdf.session.records import Array

_FAR = 48
"""Blocks are taken from this many of their own sides on: a curve that falls by e^10 on the way is bent by 0.2 %."""
FIRST_KEPT = 3
"""Blocks of 8 pixels and more are kept: those of 2 and 4 are needed near the beam alone, and are made there."""
_REJECT_SD = 6.0
_NOISE_SD = 4.0
_MEDIAN_TO_SD = 1.4826
_SURE = np.float32(1e-4)
"""Share of the limit by which float32 decides whether a pixel stands out; float64 decides the rest."""
_TILE = 2**18
"""Pixels whose blocks are made at once."""


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


class BlockSums(NamedTuple):
    """Sums over blocks, of equal shapes; of all those of one size, (rows, columns)."""

    n: NDArray[np.float32]
    value: NDArray[np.float32]
    variance: NDArray[np.float32]
    light: NDArray[np.float32]
    n_good: NDArray[np.float32]


def n_levels(shape: tuple[int, int]) -> int:
    """Sizes of blocks, 2, 4, 8 … pixels, that lie far enough from some beam in a grid of this shape to be used."""
    n = 1
    while _FAR * 2**n < max(shape):
        n += 1
    return n


def kept_levels(grid: Grid) -> tuple[BlockSums, ...]:
    """The blocks of 2^FIRST_KEPT pixels a side and more; none where the grid is too small for them."""
    top = n_levels(grid.shape)
    if top < FIRST_KEPT:
        return ()
    strips = [BlockSums(*map(_thrice_halved, level)) for level in _pairs_by_strips(grid)]
    levels = [BlockSums(*(np.concatenate(fields) for fields in zip(*strips, strict=True)))]
    while FIRST_KEPT + len(levels) <= top:
        levels.append(BlockSums(*map(_halved, levels[-1])))
    return tuple(levels)


def _pairs_by_strips(grid: Grid) -> Iterator[BlockSums]:
    """The blocks of 2 pixels, in strips of whole blocks of 2^FIRST_KEPT."""
    height, width = grid.shape
    step = 2**FIRST_KEPT * max(1, _TILE // (2**FIRST_KEPT * width))
    for top in range(0, height, step):
        strip = grid.strip(top, min(top + step, height))
        good = strip.good
        corners = [(slice(row, None, 2), slice(column, None, 2)) for row in (0, 1) for column in (0, 1)]
        shape = tuple(-(-size // 2) for size in good.shape)
        yield _pairs(*(_stacked(plane, corners, shape) for plane in (strip.radiance, strip.variance, good)))


def _stacked(plane: NDArray[Any], corners: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """The pixels of a strip by their corner in a block, (4, rows, columns); 0 at an odd end."""
    out = np.zeros((4, *shape), plane.dtype)
    for corner, where in zip(out, corners, strict=True):
        part = plane[where]
        corner[: part.shape[0], : part.shape[1]] = part
    return out


def _thrice_halved(plane: NDArray[np.float32]) -> NDArray[np.float32]:
    for _ in range(FIRST_KEPT - 1):
        plane = _halved(plane)
    return plane


class Pyramid:
    """A grid of pixels, with blocks of 2, 4, 8 … pixels a side."""

    def __init__(self, grid: Grid, kept: tuple[BlockSums, ...] | None = None) -> None:
        self.grid = grid
        self._kept = kept_levels(grid) if kept is None else kept
        self._top = n_levels(grid.shape)
        self._all: tuple[tuple[float, float], Blocks] | None = None

    def all_around(self, centre_px: tuple[float, float]) -> Blocks:
        """Every pixel once: single, or in a block whose distance from `centre_px` is many of its sides."""
        if self._all is None or self._all[0] != centre_px:
            self._all = centre_px, self.around(centre_px)
        return self._all[1]

    def around(
        self,
        centre_px: tuple[float, float],
        keep: Callable[[Array, Array, float], NDArray[np.bool_]] | None = None,
        most: float = np.inf,
    ) -> Blocks:
        """The same, each time anew, of those that are needed.

        `keep` says of block centres x, y and a side [px] which blocks may hold pixels that are needed; `most` is the
        largest side [px].
        """
        rows, columns = (axis.ravel() for axis in np.indices(self._shape(self._top)))
        parts = []
        for k in range(self._top, -1, -1):
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
        k = min(k, self._top)
        pitch = 2**k * self.grid.step_px
        ranges = []
        for centre, first, size in zip(centre_px, self.grid.first_px, self._shape(k)[::-1], strict=True):
            middle = (centre - first) / pitch
            low, high = (int(np.clip(round(middle + side * half_px / pitch), 0, size)) for side in (-1, 1))
            ranges.append(np.arange(low, max(high, low)))
        rows, columns = (axis.ravel() for axis in np.meshgrid(ranges[1], ranges[0], indexing="ij"))
        return self._blocks(k, rows, columns)

    def _shape(self, k: int) -> tuple[int, int]:
        height, width = (-(-size // 2**k) for size in self.grid.shape)
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
        side, (height, width) = 2**k, self.grid.shape
        high, wide = (np.minimum(side, size - side * at) for at, size in ((rows, height), (columns, width)))
        x = self.grid.first_px[0] + self.grid.step_px * (side * columns + (wide - 1) / 2)
        y = self.grid.first_px[1] + self.grid.step_px * (side * rows + (high - 1) / 2)
        return x, y, (high * wide).astype(float)

    def _blocks(self, k: int, rows: Any, columns: Any) -> Blocks:
        x, y, pixels = self._places(k, rows, columns)
        if k:
            n, value, variance, light, n_good = (sums.astype(float) for sums in self._sums(k, rows, columns))
        else:
            found = self.grid.at(rows, columns)
            light, variance = found.radiance.astype(float), found.variance.astype(float)
            n = n_good = found.good.astype(float)
            light = value = np.where(n > 0, light, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return Blocks(x, y, value / n, variance / n**2, n, light, pixels - n_good)

    def _sums(self, k: int, rows: Any, columns: Any) -> BlockSums:
        """Sums over blocks of 2^k pixels, k > 0; those off the grid are 0."""
        if k >= FIRST_KEPT:
            return BlockSums(*(plane[rows, columns] for plane in self._kept[k - FIRST_KEPT]))
        height, width = self._shape(k - 1)
        row, column = 2 * rows + _CORNER_ROWS[:, None], 2 * columns + _CORNER_COLUMNS[:, None]
        there = (row < height) & (column < width)
        row, column = np.minimum(row, height - 1), np.minimum(column, width - 1)
        if k == 1:
            pixels: Pixels = self.grid.at(row, column)
            return _pairs(pixels.radiance, pixels.variance, pixels.good & there)
        below = self._sums(k - 1, row.ravel(), column.ravel())
        return BlockSums(*(_sum_of_four(*np.where(there, sums.reshape(row.shape), np.float32(0))) for sums in below))


_CORNER_ROWS, _CORNER_COLUMNS = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])


def _halved(plane: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sums over 2 × 2 elements; at an odd end over those that are there."""
    even = np.pad(plane, [(0, size % 2) for size in plane.shape])
    return _sum_of_four(even[::2, ::2], even[::2, 1::2], even[1::2, ::2], even[1::2, 1::2])


def _sum_of_four(*corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Over the corners of blocks, always in one order."""
    return np.asarray(corners[0] + corners[2] + corners[1] + corners[3])


def _pairs(radiance: NDArray[np.float32], variance: NDArray[np.float32], good: NDArray[np.bool_]) -> BlockSums:
    """Sums over blocks of the pixels (4, …) at their corners: those that stand out of the four are left out of the
    mean."""
    found, noise = np.where(good, radiance, np.float32(0)), np.where(good, variance, np.float32(0))
    light, n_good = found.sum(axis=0, dtype=float), good.sum(axis=0, dtype=np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.square(found - (light / n_good).astype(np.float32)) <= (1 - _SURE) * _NOISE_SD**2 * noise
    sums = BlockSums(n_good.copy(), _in_order(found), _in_order(noise), light.astype(np.float32), n_good)
    doubtful = ~np.all(apart | ~good, axis=0)
    if doubtful.any():
        kept = good[:, doubtful] & ~_outlying(found[:, doubtful], noise[:, doubtful], good[:, doubtful])
        sums.n[doubtful] = kept.sum(axis=0)
        for plane, values in ((sums.value, found), (sums.variance, noise)):
            plane[doubtful] = _in_order(np.where(kept, values[:, doubtful], np.float32(0)))
    return sums


def _in_order(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(corners[0] + corners[1] + corners[2] + corners[3])


def _outlying(found: Any, noise: Any, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which pixels (4, m) of blocks stand out of the others; none where all lie within their noise of the mean."""
    found, noise = found.astype(float), noise.astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = found.sum(axis=0) / good.sum(axis=0)
        plain = np.all((np.abs(found - mean) <= _NOISE_SD * np.sqrt(noise)) | ~good, axis=0)
        middle = _median(found, good)
        scatter = _MEDIAN_TO_SD * _median(np.abs(found - middle), good)
        return np.asarray(~plain & ~(np.abs(found - middle) <= _REJECT_SD * np.fmax(np.sqrt(noise), scatter)))


def _median(values: Array, good: NDArray[np.bool_]) -> Array:
    """Of the good ones of four, (4, m); infinity where there is none."""
    rising = np.sort(np.where(good, values, np.inf), axis=0)
    n, block = good.sum(axis=0), np.arange(good.shape[1])
    return np.asarray((rising[np.maximum(n - 1, 0) // 2, block] + rising[n // 2, block]) / 2)
