"""Which pixels carry a channel. Pixel (x, y) is the centre of column x, row y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bssrdf.measure.merge import SATURATED, Hdr
from bssrdf.session.records import Beam

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelPixels:
    """The pixels of one channel, arrays of shape (n,)."""

    x_px: Array
    y_px: Array
    value: Array
    """Radiance [DN/s]."""
    variance: Array
    count: NDArray[np.uint8]
    """Samples that were merged."""
    good: NDArray[np.bool_]
    """Not saturated everywhere, not hot."""
    saturated: NDArray[np.bool_]
    px_per_sample: float
    """Pixels of the frame for each one of this channel: 4 for red on a Bayer mosaic."""


def channel_names(layout: str, beam: Beam) -> tuple[str, ...]:
    """All channels of a camera layout, in the order of `reference.reflectance`."""
    if layout == "mono":
        return (beam.channels or ("mono",))[:1]
    letters = "RGB" if layout == "rgb" else sorted(set(layout), key="RGBCMYEW".index)
    return tuple(letters)


def mosaic_period(layout: str) -> int:
    """Pixels from one colour filter to the next of its colour along a row."""
    return 1 if layout in ("mono", "rgb") else 2


def pixels_of(hdr: Hdr, layout: str, name: str) -> ChannelPixels:
    """The pixels that carry the channel `name`."""
    height, width = hdr.radiance.shape[:2]
    if layout == "rgb":
        return _flat(hdr, np.ones((height, width), bool), "RGB".index(name))
    if layout == "mono":
        return _flat(hdr, np.ones((height, width), bool))
    carries = np.zeros((height, width), bool)
    for place, letter in enumerate(layout):
        row, column = divmod(place, 2)
        carries[row::2, column::2] = letter == name
    return _flat(hdr, carries)


def _flat(hdr: Hdr, carries: NDArray[np.bool_], index: int | None = None) -> ChannelPixels:
    where = carries if index is None else (carries, index)
    value, variance, mask = hdr.radiance[where], hdr.variance[where], hdr.mask[where]
    y_px, x_px = np.nonzero(carries)
    return ChannelPixels(
        x_px.astype(float),
        y_px.astype(float),
        value.astype(float),
        variance.astype(float),
        hdr.count[where],
        (mask == 0) & np.isfinite(value),
        (mask & SATURATED) > 0,
        carries.size / carries.sum(),
    )
