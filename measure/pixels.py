"""Which pixels carry a channel. Pixel (x, y) is the centre of column x, row y."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.measure.hdr import Bits, Counts, Pixels, Plane, Planes
from bssrdf.session.records import Beam

_LEAST_SIDE = 16
"""Pixels: eight of a colour on a mosaic."""
_RANGE = 1e-14, 1e15
"""Of a picture's largest number: single precision then holds the variances of bright and of dark pixels."""


def check_picture(file: str, picture: NDArray[Any]) -> None:
    """InputError for a picture too small to be one, or of numbers so large or small that their squares are lost."""
    height, width = picture.shape[:2]
    if min(height, width) < _LEAST_SIDE:
        raise InputError(f"{file}: is {width} x {height} pixels, too small for a spot and its surroundings")
    if picture.dtype.kind != "f":
        return
    largest = float(np.max(np.abs(picture), where=np.isfinite(picture), initial=0.0))
    if largest and not _RANGE[0] < largest < _RANGE[1]:
        raise InputError(
            f"{file}: its largest number is {largest:.2g}; scale all frames by one factor, to between "
            f"{_RANGE[0]:g} and {_RANGE[1]:g}"
        )


@dataclass(frozen=True)
class Grid:
    """Pixels of one channel on a regular grid of a merged image, of shape (rows, columns).

    A colour that a mosaic has twice, such as green, is two grids.
    """

    image: Planes
    channel: int | None
    """Of an RGB image."""
    first_px: tuple[int, int]
    """(x, y) of the first."""
    step_px: int
    """From one pixel to the next."""

    @property
    def place(self) -> int:
        """Which one of the image's grids this is."""
        return self.first_px[1] * self.step_px + self.first_px[0] if self.channel is None else self.channel

    @property
    def shape(self) -> tuple[int, int]:
        rows, columns = (
            -(-(size - first) // self.step_px)
            for size, first in zip(self.image.shape[:2], self.first_px[::-1], strict=True)
        )
        return rows, columns

    @property
    def radiance(self) -> Plane:
        """[DN/s]"""
        return self._of(self.image.radiance)

    @property
    def variance(self) -> Plane:
        return self._of(self.image.variance)

    @property
    def count(self) -> Counts:
        """Samples that were merged."""
        return self._of(self.image.count)

    @property
    def mask(self) -> Bits:
        """0 for a good pixel."""
        return self._of(self.image.mask)

    def strip(self, low: int, high: int) -> Pixels:
        """Rows of the grid."""
        return self._window((low, high), (0, self.shape[1]))

    def at(self, rows: Any, columns: Any) -> Pixels:
        """The pixels at these places in the grid, arrays of one shape."""
        if not rows.size:
            return self.strip(0, 1).at((rows, columns))
        (top, bottom), (left, right) = ((int(each.min()), int(each.max()) + 1) for each in (rows, columns))
        place = (rows - top) * (right - left) + columns - left
        return Pixels(*(plane.ravel().take(place) for plane in self._window((top, bottom), (left, right))))

    def _window(self, *ends: tuple[int, int]) -> Pixels:
        """Rows and columns of the grid, each from and up to one."""
        parts = (
            slice(first + self.step_px * low, first + self.step_px * (high - 1) + 1)
            for first, (low, high) in zip(self.first_px[::-1], ends, strict=True)
        )
        return self.image.window(*parts).at(self._every)

    @property
    def _every(self) -> tuple[Any, ...]:
        """The grid's pixels among those from its first on."""
        every = slice(None, None, self.step_px)
        return (every, every) if self.channel is None else (every, every, self.channel)

    def _of(self, plane: NDArray[Any]) -> NDArray[Any]:
        column, row = self.first_px
        return plane[row:, column:][self._every]


def channel_names(layout: str, beam: Beam) -> tuple[str, ...]:
    """All channels of a camera layout, in the order of `reference.reflectance`."""
    if layout == "mono":
        return (beam.channels or ("mono",))[:1]
    letters = "RGB" if layout == "rgb" else sorted(set(layout), key="RGBCMYEW".index)
    return tuple(letters)


def mosaic_period(layout: str) -> int:
    """Pixels from one colour filter to the next of its colour along a row."""
    return 1 if layout in ("mono", "rgb") else 2


def places(shape: tuple[int, ...], period: int) -> list[tuple[slice | int, ...]]:
    """Where the samples of each place of a mosaic's cell, or of each channel, stand in a frame of `shape`."""
    if len(shape) == 3:
        return [(slice(None), slice(None), channel) for channel in range(shape[2])]
    steps = [slice(first, None, period) for first in range(period)]
    return [(rows, columns) for rows in steps for columns in steps]


def grids_of(image: Planes, layout: str, name: str) -> tuple[Grid, ...]:
    """The pixels that carry the channel `name`."""
    if layout in ("mono", "rgb"):
        return (Grid(image, "RGB".index(name) if layout == "rgb" else None, (0, 0), 1),)
    corners = [divmod(place, 2) for place, letter in enumerate(layout) if letter == name]
    return tuple(Grid(image, None, (column, row), 2) for row, column in corners)
