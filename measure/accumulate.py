"""The sums of the merge, a frame at a time: one pass over memory each. Planes (rows, samples); signals in DN.

`saturation` holds the rows of a cell of the mosaic, as long as a row of the frame. A signal x above black is shown by
a bent response; x (1 + bend (x − pivot)) is straight.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Rows = NDArray[np.float32]

_fused: Any = njit(cache=True, nogil=True, error_model="numpy")


@_fused
def add_light(
    raw: NDArray[Any],
    dark: NDArray[Any],
    saturation: Rows,
    bend: np.float32,
    pivot: np.float32,
    t: np.float32,
    signal: Rows,
    seconds: Rows,
    count: NDArray[np.uint16],
) -> None:
    """Σ(x − d), Σt and the number of samples, over those below saturation."""
    period = len(saturation)
    for row in range(raw.shape[0]):
        limit = saturation[row % period]
        for i in range(raw.shape[1]):
            light = np.float32(raw[row, i]) - np.float32(dark[row, i])
            light += bend * light * (light - pivot)
            good = np.float32(raw[row, i]) < limit[i]
            signal[row, i] += light if good else np.float32(0)
            seconds[row, i] += t if good else np.float32(0)
            count[row, i] += np.uint16(good)


@_fused
def add_weighted(
    raw: NDArray[Any],
    dark: NDArray[Any],
    saturation: Rows,
    bend: np.float32,
    pivot: np.float32,
    t: np.float32,
    darkness: np.float32,
    gain: np.float32,
    model_var: np.float32,
    expected: Rows,
    weighted: Rows,
    weight: Rows,
) -> None:
    """Σ w (x − d)/t and Σ w, w = t²/(t `expected`/gain + `darkness` + `model_var` (t `expected`)²) the inverse
    variance of (x − d)/t."""
    by_gain, by_time = 1 / gain, darkness / t
    period = len(saturation)
    for row in range(raw.shape[0]):
        limit = saturation[row % period]
        for i in range(raw.shape[1]):
            light = np.float32(raw[row, i]) - np.float32(dark[row, i])
            light += bend * light * (light - pivot)
            good = np.float32(raw[row, i]) < limit[i]
            lit = expected[row, i]
            w = 1 / (lit * (by_gain + model_var * t * lit) + by_time)
            weighted[row, i] += w * light if good else np.float32(0)
            weight[row, i] += w * t if good else np.float32(0)


@_fused
def add_variance(
    raw: NDArray[Any],
    saturation: Rows,
    t: np.float32,
    darkness: np.float32,
    gain: np.float32,
    model_var: np.float32,
    expected: Rows,
    variance: Rows,
) -> None:
    """Σ of the variance of x − d that the radiance `expected` predicts, over the samples below saturation."""
    period = len(saturation)
    for row in range(raw.shape[0]):
        limit = saturation[row % period]
        for i in range(raw.shape[1]):
            good = np.float32(raw[row, i]) < limit[i]
            lit = expected[row, i] * t
            variance[row, i] += lit / gain + model_var * lit * lit + darkness if good else np.float32(0)
