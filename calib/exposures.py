"""What two exposures of one scene tell about each other. Signals in DN above the dark frame, flat arrays (n,)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.sensor import Sensor

Array = NDArray[np.float64]

_LEAST_SD = 20.0
"""In units of the noise of a difference: nearer to black an offset decides the ratio."""
_MOST_SHARE = 0.9
_ROUGHLY = 4.0
"""So many times clear of noise some DN of black change a ratio by less than a blunder does."""
_AROUND, _APART = 5, 2
"""Pixels of a colour over which light is compared from place to place, and from place to place."""
_DITHERED = 3.0
"""A mean signal of so many noises and steps is not lost by rounding,"""
_BLACK_LOST = 10
"""nor one of that many times as much by a camera that cuts off at black."""
_BINS = 8
"""Levels of brightness by which a bend and an offset are told from each other and from the ratio."""
_PER_BIN, _LEAST_PIXELS = 100, 8
_MODEL_REL_SD = 1e-5


class Comparison(NamedTuple):
    """Pixels of one colour and like brightness in two frames, numbered by the caller."""

    first: int
    second: int
    """The longer one."""
    colour: int
    first_beside: bool
    second_beside: bool
    """Whether the pixels lie beside saturated ones in that frame."""
    shorter: float
    longer: float
    """Mean signals [DN]."""
    log_var: float
    """Of the logarithm of their ratio, by the scatter of the pixels."""


class InCommon(NamedTuple):
    """Two comparisons with pixels of one frame in common, the longer one of the first: by number."""

    first: int
    second: int
    correlation: float
    """Of the errors that their logarithms have."""


def shared_noise(first: Comparison, n_first: int, second: Comparison, n_second: int, light: float) -> float:
    """Correlation of the logarithms of two comparisons by the photons of `light` [DN], the sum over common pixels.

    These are in the ratio of one above, of the other below: the first errs to one side where the second errs to the
    other.
    """

    def counted(a: Comparison, n: int) -> float:
        return 1 / (n * a.shorter) + 1 / (n * a.longer)

    common = light / (n_first * first.longer * n_second * second.shorter)
    return -common / float(np.sqrt(counted(first, n_first) * counted(second, n_second)))


def signal_weight(ratio: float, sensor: Sensor) -> float:
    """Weight of the longer exposure in the sum by which pixels are chosen, see `comparable`."""
    noise_var = 2 * sensor.read_var_dn()
    shot_var = least_signal(sensor) / sensor.gain_e_per_dn
    return ratio * (shot_var + noise_var) / (ratio * shot_var + noise_var)


def least_signal(sensor: Sensor) -> float:
    """DN above which a signal is clear of noise."""
    return _LEAST_SD * float(np.sqrt(2 * sensor.read_var_dn()))


def comparable(
    shorter: NDArray[np.float32], longer: NDArray[np.float32], ratio: float, sensor: Sensor, span_dn: float
) -> NDArray[np.bool_]:
    """Pixels by which two exposures can be compared: clear of noise in the one, of saturation in the other.

    They are chosen by the sum of the two. Given the sum, the split of Poisson counts tells nothing but the ratio of
    the times, so the choice does not bias it; a choice by either value would. At the dark end read noise, equal in
    both, comes in, and the sum that has this property gives the longer exposure another weight.
    """
    weight = signal_weight(ratio, sensor)
    bright = shorter + np.float32(weight) * longer > least_signal(sensor) * (1 + weight * ratio)
    return bright & (shorter + longer < _MOST_SHARE * span_dn * (1 + 1 / ratio))


def rough_log_ratio(
    shorter: NDArray[np.float32], longer: NDArray[np.float32], good: NDArray[np.bool_], sensor: Sensor
) -> float | None:
    """ln of the ratio of two frames' light over the `good` pixels that are bright in both together.

    Good to some percent, whatever the labels say and however few pixels there are; None where noise hides it.
    """
    chosen = good & (shorter + longer > _ROUGHLY * least_signal(sensor))
    light = float(shorter[chosen].sum(dtype=float)), float(longer[chosen].sum(dtype=float))
    noise = float(np.sqrt(2 * sensor.read_var_dn() * np.count_nonzero(chosen)))
    return float(np.log(light[1] / light[0])) if min(light) > _LEAST_SD * noise > 0 else None


class LocalRatios(NamedTuple):
    """ln of the ratio of two frames' light by place, (n,), and the places (row, column) [px], (n, 2)."""

    log: Array
    place_px: NDArray[np.int_]


def local_log_ratios(
    shorter: NDArray[np.float32], longer: NDArray[np.float32], good: NDArray[np.bool_], ratio: float, sensor: Sensor
) -> LocalRatios:
    """The same from place to place, wherever by the `ratio` of the times one frame promises the other clear light.

    By medians of 5 × 5 pixels of one colour, so that hot and blinking pixels say nothing; a frame without light counts
    as its noise.
    """
    planes = [(plane[::2, 1::2] if plane.ndim == 2 else plane[::2, ::2, 1]) for plane in (shorter, longer, good)]
    a, b = (cv2.medianBlur(np.nan_to_num(np.ascontiguousarray(plane)), _AROUND) for plane in planes[:2])
    whole: Any = planes[2].astype(np.uint8)
    usable = np.asarray(cv2.erode(whole, np.ones((_AROUND, _AROUND), np.uint8))) > 0
    thin = (slice(None, None, _APART), slice(None, None, _APART))
    a, b, usable = a[thin], b[thin], usable[thin]
    noise_dn = np.float32(np.sqrt(2 * sensor.read_var_dn()))
    least = _DITHERED * (noise_dn + np.float32(sensor.step_dn)) * (_BLACK_LOST if sensor.black_clipped else 1)
    rows, columns = np.nonzero(usable & (np.maximum(a, b / np.float32(ratio)) > least))
    a, b = np.maximum(a[rows, columns], noise_dn), np.maximum(b[rows, columns], noise_dn)
    return LocalRatios(np.log(b / a).astype(float), 2 * _APART * np.stack([rows, columns], axis=1))


def compared(
    shorter: Array, longer: Array, ratio: float, sensor: Sensor
) -> Iterator[tuple[NDArray[np.int_], float, float, float]]:
    """By levels of brightness: the places of the pixels, their mean signals, the variance of the ratio's logarithm.

    The variance is that of photons and read noise, times what the pixels scatter more or less than by these. The plain
    sum of their squares would be that of the few brightest, which the ratio itself follows. Student's t of so few
    pixels is wider than a Gaussian. Nothing where there are too few pixels.
    """
    if len(shorter) < _LEAST_PIXELS:
        return
    n = min(_BINS, 1 + len(shorter) // _PER_BIN)
    for members in np.array_split(np.argsort(shorter + signal_weight(ratio, sensor) * longer), n):
        a, b = shorter[members], longer[members]
        if not (a.sum() > 0 and b.sum() > 0):
            continue
        told = b.sum() / a.sum()
        noise = told * (a + b) / sensor.gain_e_per_dn + 2 * (1 + told**2) * sensor.read_var_dn()
        scatter = float(np.sum((b - told * a) ** 2 / noise)) / (len(a) - 3) * float(noise.sum())
        log_var = (scatter + sensor.step_dn**2) / float(b.sum()) ** 2 + _MODEL_REL_SD**2
        yield members, float(a.mean()), float(b.mean()), log_var
