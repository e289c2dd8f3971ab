"""Many exposures to one radiance image on the camera's own mosaic. Radiance in DN/s above the dark frame.

The estimate is the Poisson maximum-likelihood sum Σ(x − d)/Σt over the unsaturated samples, then one pass that
weights each sample by the variance which that estimate predicts (shot, read and dark noise). A weight taken from a
sample's own value would be biased: at 41 electrons by −3.5 %. Where the camera clips at black, read noise is unknown
and the first estimate stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import BEND_PIVOT, Sensor
from bssrdf.errors import InputError
from bssrdf.measure.accumulate import Readout, SampleNoise, add_light, add_variance, add_weighted

Plane = NDArray[np.float32]
Bits = NDArray[np.uint8]
Counts = NDArray[np.uint16]

SATURATED, HOT, NO_DATA = 1, 2, 4
"""Bits of a mask: saturated in every exposure, hot, no usable sample."""

_TILE = 65536
"""Samples of the tiles of whole rows in which a plane is smoothed."""
_REACH = 2
"""Pixels of its colour around one that tell how bright it is where it holds few electrons."""
_READERS = 2
_MEDIAN_PIXELS = 10_000
_FEW_ELECTRONS = 100.0
"""Below this many electrons in all exposures the variance is predicted from the pixel's neighbourhood."""
_LEAST_RESPONSE = 0.05
"""A pixel that sees less than this share of its colour's mean cannot be corrected."""


class DarkPaired(NamedTuple):
    """One frame and its master dark [DN], of shape (h, w) or (h, w, 3)."""

    raw: NDArray[Any]
    dark: NDArray[Any]
    n_darks: int


@dataclass(frozen=True)
class Shot:
    """A frame to be merged: the time it stands for, and how to get its pixels."""

    name: str
    exposure_s: float
    load: Callable[[], DarkPaired]


class Pixels(NamedTuple):
    """Some pixels of a merged image: equal shapes."""

    radiance: Plane
    variance: Plane
    mask: Bits

    def at(self, where: Any) -> Pixels:
        """Those that an index picks."""
        return Pixels(self.radiance[where], self.variance[where], self.mask[where])

    @property
    def good(self) -> NDArray[np.bool_]:
        """Those that hold a number that can be used."""
        return np.asarray((self.mask == 0) & np.isfinite(self.radiance))


class Planes(Protocol):
    """A merged image, in memory as `Hdr`, or in a file."""

    @property
    def radiance(self) -> Plane: ...
    @property
    def variance(self) -> Plane: ...
    @property
    def count(self) -> Counts: ...
    @property
    def mask(self) -> Bits: ...
    @property
    def shape(self) -> tuple[int, ...]: ...
    def window(self, rows: slice, columns: slice) -> Pixels: ...


@dataclass(frozen=True)
class Hdr:
    """A merged image: `radiance` and its `variance` in DN/s, `count` of samples used, `mask` bits; equal shapes."""

    radiance: Plane
    variance: Plane
    count: Counts
    mask: Bits

    @property
    def shape(self) -> tuple[int, ...]:
        """(h, w), or (h, w, 3)."""
        return self.radiance.shape

    def window(self, rows: slice, columns: slice) -> Pixels:
        """The pixels of some rows and columns."""
        return Pixels(self.radiance, self.variance, self.mask).at((rows, columns))

    def n_missing(self) -> int:
        """Pixels that hold no data, those that saturate left out."""
        return int(np.count_nonzero((self.mask & (SATURATED | NO_DATA)) == NO_DATA))


class Progress(Protocol):
    """Told how far a long work is: a word for the work, the steps done and the steps in all."""

    def __call__(self, what: str, done: int, total: int, /) -> None: ...


def merge(
    shots: Sequence[Shot],
    sensor: Sensor,
    *,
    hot: NDArray[np.bool_] | None = None,
    period: int = 1,
    model_rel_sd: float = 0.0,
    progress: Progress | None = None,
    what: str = "merge",
) -> Hdr:
    """Merge frames into radiance [DN/s] with variance, sample count and mask.

    `model_rel_sd` is an error of each sample, relative to its light, beyond noise. The order of `shots` does not
    matter to a bit. `period` is 2 on a colour filter mosaic, where the next pixel of the same colour is two away.
    Frames are read by two threads, twice each; memory is a few planes.
    """
    ordered = sorted(shots, key=lambda shot: (shot.exposure_s, shot.name))
    steps = 2 * len(ordered)

    def samples(first_step: int) -> Iterator[tuple[Shot, DarkPaired]]:
        for i, pair in enumerate(read_ahead(ordered)):
            yield pair
            if progress:
                progress(what, first_step + i + 1, steps)

    signal, seconds, count, missing = _poisson_sum(samples(0), sensor)
    saturated = count == 0 if missing is None else (count == 0) & ~missing
    if not count.any():
        raise InputError(
            f"{ordered[0].name}: every pixel is saturated (at or above {sensor.saturation_dn:g} DN) "
            "in every exposure; add shorter exposures"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        signal /= seconds
    again = samples(len(ordered))
    if sensor.black_clipped:
        radiance, variance = signal, _poisson_variance(again, sensor, model_rel_sd, signal, seconds)
    else:
        expected = _expected_radiance(signal, seconds, sensor, period)
        del signal, seconds
        radiance, variance = _reweighted_sum(again, sensor, model_rel_sd, expected)
    mask = saturated * np.uint8(SATURATED) + (count == 0) * np.uint8(NO_DATA)
    if hot is not None:
        mask[hot] |= HOT
    return Hdr(radiance, variance, count, mask)


def read_ahead(shots: Sequence[Shot]) -> Iterator[tuple[Shot, DarkPaired]]:
    """Load frames by two threads, at most two ahead, and hand them out in order; InputError where sizes differ."""
    with ThreadPoolExecutor(_READERS) as readers:
        waiting: list[Future[DarkPaired]] = [readers.submit(shot.load) for shot in shots[:_READERS]]
        shape = None
        for i, shot in enumerate(shots):
            sample = waiting.pop(0).result()
            shape = shape or sample.raw.shape
            if not sample.raw.shape == sample.dark.shape == shape:
                raise InputError(
                    f"{shot.name}: is {sample.raw.shape[::-1]} pixels, its dark {sample.dark.shape[::-1]}, the first "
                    f"frame {shape[::-1]}; take it again or leave it out"
                )
            if i + _READERS < len(shots):
                waiting.append(readers.submit(shots[i + _READERS].load))
            yield shot, sample


def _poisson_sum(
    samples: Iterator[tuple[Shot, DarkPaired]], sensor: Sensor
) -> tuple[Plane, Plane, Counts, NDArray[np.bool_] | None]:
    """Σ(x − d), Σt and the number of unsaturated samples, by pixel, and where a sample held no number, if any did."""
    signal = seconds = count = missing = None
    for shot, (raw, dark, _) in samples:
        if signal is None or seconds is None or count is None:
            signal, seconds = np.zeros(raw.shape, np.float32), np.zeros(raw.shape, np.float32)
            count = np.zeros(raw.shape, np.uint16)
        planes = _rows(signal), _rows(seconds), _rows(count)
        add_light(_rows(raw), _rows(dark), _response(sensor, raw), np.float32(shot.exposure_s), *planes)
        if raw.dtype.kind == "f" and (unknown := np.isnan(raw)).any():
            missing = unknown if missing is None else missing | unknown
    if signal is None or seconds is None or count is None:
        raise InputError("no frame to merge; list some in frames.csv")
    return signal, seconds, count, missing


def _rows(plane: NDArray[Any]) -> NDArray[Any]:
    """Rows of samples, channels side by side."""
    return plane.reshape(len(plane), -1)


def _response(sensor: Sensor, raw: NDArray[Any]) -> Readout:
    pivot = np.float32(BEND_PIVOT * sensor.span_dn()) if sensor.bend else np.float32(0)
    return Readout(sensor.saturation_rows(raw.shape), np.float32(sensor.bend_per_dn()), pivot)


def _noise(shot: Shot, sample: DarkPaired, sensor: Sensor, model_rel_sd: float) -> SampleNoise:
    values = (shot.exposure_s, _darkness_variance(sample, sensor), sensor.gain_e_per_dn, model_rel_sd**2)
    return SampleNoise(*(np.float32(value) for value in values))


def _reweighted_sum(
    samples: Iterator[tuple[Shot, DarkPaired]], sensor: Sensor, model_rel_sd: float, expected: Plane
) -> tuple[Plane, Plane]:
    """Inverse-variance mean of (x − d)/t and its variance, where the variance is that of `expected` [DN/s]."""
    weighted, weight = np.zeros_like(expected), np.zeros_like(expected)
    planes = _rows(expected), _rows(weighted), _rows(weight)
    for shot, sample in samples:
        noise = _noise(shot, sample, sensor, model_rel_sd)
        add_weighted(_rows(sample.raw), _rows(sample.dark), _response(sensor, sample.raw), noise, *planes)
    with np.errstate(divide="ignore", invalid="ignore"):
        weighted /= weight
        np.divide(1, weight, out=weight)
    weight[~np.isfinite(weighted)] = np.nan
    return weighted, weight


def _poisson_variance(
    samples: Iterator[tuple[Shot, DarkPaired]], sensor: Sensor, model_rel_sd: float, radiance: Plane, seconds: Plane
) -> Plane:
    """Variance of the Poisson sum of `seconds` Σt, each sample's being that of `radiance` [DN/s]."""
    variance = np.zeros_like(radiance)
    expected = np.maximum(np.nan_to_num(radiance), 0)
    for shot, sample in samples:
        noise = _noise(shot, sample, sensor, model_rel_sd)
        add_variance(_rows(sample.raw), _response(sensor, sample.raw), noise, _rows(expected), _rows(variance))
    with np.errstate(divide="ignore", invalid="ignore"):
        variance /= seconds**2
    return variance


def _darkness_variance(sample: DarkPaired, sensor: Sensor) -> np.float32:
    """Variance [DN²] of x − d without light: read noise and the shot noise of the dark signal, of both frames.

    The dark signal is the frame's median. Weights that followed the noise of d pixel by pixel would favour low darks:
    in darkness the radiance would come out too high.
    """
    thin = max(1, round(np.sqrt(sample.dark.shape[0] * sample.dark.shape[1] / _MEDIAN_PIXELS)))
    dark_signal = max(float(np.median(sample.dark[::thin, ::thin])) - sensor.black_dn, 0.0)
    return np.float32((dark_signal / sensor.gain_e_per_dn + sensor.read_var_dn()) * (1 + 1 / sample.n_darks))


def _expected_radiance(radiance: Plane, seconds: Plane, sensor: Sensor, period: int) -> Plane:
    """Radiance ≥ 0 that predicts the shot noise: the estimate itself, in the dark that of its neighbourhood.

    Written over `seconds`, which is not needed any more.
    """
    for row in range(period):
        for column in range(period):
            phase = (slice(row, None, period), slice(column, None, period))
            _smooth_where_dark(radiance[phase], seconds[phase], np.float32(sensor.gain_e_per_dn))
    return seconds


def _smooth_where_dark(radiance: Plane, seconds: Plane, gain: np.float32) -> None:
    """Replace `seconds` by the expected radiance, for pixels of one colour, by tiles of rows."""
    step = max(1, _TILE // max(1, radiance[0].size))
    for top in range(0, len(radiance), step):
        rows = slice(top, min(top + step, len(radiance)))
        lit = radiance[rows]
        few = lit * seconds[rows] * gain < _FEW_ELECTRONS
        if few.any():
            above, below = max(rows.start - _REACH, 0), min(rows.stop + _REACH, len(radiance))
            size = (2 * _REACH + 1, 2 * _REACH + 1)
            around = cv2.blur(np.nan_to_num(radiance[above:below]), size, borderType=cv2.BORDER_REPLICATE)
            lit = np.where(few, around[rows.start - above : rows.stop - above], lit)
        seconds[rows] = np.maximum(lit, 0)


def flattened(hdr: Hdr, field: Hdr, period: int) -> Hdr:
    """`hdr` divided by `field`, which is scaled to a mean of 1 in each colour; its noise is added."""
    response = np.full_like(field.radiance, np.nan)
    for row in range(period):
        for column in range(period):
            phase = (slice(row, None, period), slice(column, None, period))
            part = field.radiance[phase]
            mean = np.nanmean(np.where(field.mask[phase] == 0, part, np.nan), axis=(0, 1), keepdims=True)
            response[phase] = part / mean
    usable = (field.mask == 0) & (response > _LEAST_RESPONSE)
    response = np.where(usable, response, np.float32(1))
    relative_var = np.where(usable, field.variance / np.square(field.radiance), np.float32(0))
    radiance = hdr.radiance / response
    return Hdr(
        radiance,
        hdr.variance / response**2 + relative_var * radiance**2,
        hdr.count,
        hdr.mask | np.where(usable, np.uint8(0), np.uint8(NO_DATA)),
    )
