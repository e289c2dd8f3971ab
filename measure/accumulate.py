"""The sums of the merge, a frame at a time, by tiles of rows that stay in the cache. Planes (rows, samples); DN.

`saturation` holds the rows of a cell of the mosaic, as long as a row of the frame. A signal x above black is shown by
a bent response; x (1 + bend (x − pivot)) is straight.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.float32]

_TILE = 65536
"""Samples of a tile: its few temporary planes stay in the second cache."""


class Readout(NamedTuple):
    """How the shown signal becomes the straight one, and where it ends."""

    saturation: Rows
    """(period, samples), in raw DN."""
    bend: np.float32
    pivot: np.float32


class SampleNoise(NamedTuple):
    """What tells the variance of a sample: t·radiance/gain + darkness + model_var (t·radiance)² [DN²]."""

    t: np.float32
    darkness: np.float32
    gain: np.float32
    model_var: np.float32

    def variance(self, radiance: Rows) -> Rows:
        """Of a signal x − d, over t."""
        return radiance * (1 / self.gain + self.model_var * self.t * radiance) + self.darkness / self.t


def add_light(
    raw: NDArray[Any],
    dark: NDArray[Any],
    response: Readout,
    t: np.float32,
    signal: Rows,
    seconds: Rows,
    count: NDArray[np.uint16],
) -> None:
    """Σ(x − d), Σt and the number of samples, over those below saturation."""
    for at, good in _tiles(raw, response.saturation):
        signal[at] += _kept(_light(raw[at], dark[at], response), good)
        seconds[at] += t if good is None else t * good
        count[at] += np.uint16(1) if good is None else good


def add_weighted(
    raw: NDArray[Any],
    dark: NDArray[Any],
    response: Readout,
    noise: SampleNoise,
    expected: Rows,
    weighted: Rows,
    weight: Rows,
) -> None:
    """Σ w (x − d)/t and Σ w, w the inverse variance of (x − d)/t where the radiance is `expected`."""
    for at, good in _tiles(raw, response.saturation):
        with np.errstate(divide="ignore", invalid="ignore"):
            w = _kept(np.reciprocal(noise.variance(expected[at])), good)
            weighted[at] += _kept(w * _light(raw[at], dark[at], response), good)
        weight[at] += w * noise.t


def add_variance(raw: NDArray[Any], response: Readout, noise: SampleNoise, expected: Rows, variance: Rows) -> None:
    """Σ of the variance of x − d that the radiance `expected` predicts, over the samples below saturation."""
    for at, good in _tiles(raw, response.saturation):
        variance[at] += _kept(noise.t * noise.variance(expected[at]), good)


def _tiles(raw: NDArray[Any], saturation: Rows) -> Iterator[tuple[slice, NDArray[np.bool_] | None]]:
    """Tiles of whole cells, and which of their samples are below saturation; None where all are."""
    period, least = len(saturation), saturation.min()
    step = period * max(1, _TILE // max(1, period * raw.shape[1]))
    for top in range(0, len(raw), step):
        at = slice(top, top + step)
        tile = raw[at]
        if tile.max() < least:
            yield at, None
            continue
        good = np.empty(tile.shape, bool)
        for row, limit in enumerate(saturation):
            np.less(tile[row::period], limit, out=good[row::period])
        yield at, good


def _light(raw: NDArray[Any], dark: NDArray[Any], response: Readout) -> Rows:
    light = np.subtract(raw, dark, dtype=np.float32)
    if response.bend:
        light += response.bend * light * (light - response.pivot)
    return light


def _kept(values: Rows, good: NDArray[np.bool_] | None) -> Rows:
    """The values, 0 for samples that are saturated or no number."""
    if good is not None:
        values[~good] = 0
    return values
