"""Which pixels carry a channel. Pixel (x, y) is the centre of column x, row y."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from bssrdf.measure.hdr import Hdr, Plane
from bssrdf.session.records import Beam


@dataclass(frozen=True)
class Grid:
    """Pixels of one channel on a regular grid, as views of a merged image: shape (rows, columns).

    A colour that a mosaic has twice, such as green, is two grids.
    """

    radiance: Plane
    """[DN/s]"""
    variance: Plane
    count: NDArray[Any]
    """Samples that were merged."""
    mask: NDArray[Any]
    """0 for a good pixel."""
    first_px: tuple[int, int]
    """(x, y) of the first."""
    step_px: int
    """From one pixel to the next."""


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


def grids_of(hdr: Hdr, layout: str, name: str) -> tuple[Grid, ...]:
    """The pixels that carry the channel `name`."""
    if layout == "mono":
        return (_grid(hdr, ..., (0, 0), 1),)
    if layout == "rgb":
        return (_grid(hdr, (..., "RGB".index(name)), (0, 0), 1),)
    corners = [divmod(place, 2) for place, letter in enumerate(layout) if letter == name]
    return tuple(_grid(hdr, (slice(row, None, 2), slice(column, None, 2)), (column, row), 2) for row, column in corners)


def _grid(hdr: Hdr, where: Any, first_px: tuple[int, int], step_px: int) -> Grid:
    return Grid(hdr.radiance[where], hdr.variance[where], hdr.count[where], hdr.mask[where], first_px, step_px)
