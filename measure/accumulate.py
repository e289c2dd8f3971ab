"""The sums of the merge, a frame at a time: one pass over memory each. Flat arrays of one length; signals in DN."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Flat = NDArray[np.float32]

_fused: Any = njit(cache=True, nogil=True, error_model="numpy")


@_fused
def add_light(
    raw: NDArray[Any],
    dark: NDArray[Any],
    saturation: np.float32,
    t: np.float32,
    signal: Flat,
    seconds: Flat,
    count: NDArray[np.uint8],
) -> None:
    """Σ(x − d), Σt and the number of samples, over those below saturation."""
    for i in range(raw.size):
        light = np.float32(raw[i]) - np.float32(dark[i])
        good = np.float32(raw[i]) < saturation
        signal[i] += light if good else np.float32(0)
        seconds[i] += t if good else np.float32(0)
        count[i] += np.uint8(good)


@_fused
def add_weighted(
    raw: NDArray[Any],
    dark: NDArray[Any],
    saturation: np.float32,
    t: np.float32,
    darkness: np.float32,
    gain: np.float32,
    expected: Flat,
    weighted: Flat,
    weight: Flat,
) -> None:
    """Σ w (x − d)/t and Σ w, w = t²/(t `expected`/gain + `darkness`) the inverse variance of (x − d)/t."""
    by_gain, by_time = 1 / gain, darkness / t
    for i in range(raw.size):
        light = np.float32(raw[i]) - np.float32(dark[i])
        good = np.float32(raw[i]) < saturation
        w = 1 / (expected[i] * by_gain + by_time)
        weighted[i] += w * light if good else np.float32(0)
        weight[i] += w * t if good else np.float32(0)


@_fused
def add_variance(
    raw: NDArray[Any],
    saturation: np.float32,
    t: np.float32,
    darkness: np.float32,
    gain: np.float32,
    expected: Flat,
    variance: Flat,
) -> None:
    """Σ of the variance of x − d that the radiance `expected` predicts, over the samples below saturation."""
    for i in range(raw.size):
        good = np.float32(raw[i]) < saturation
        variance[i] += expected[i] * t / gain + darkness if good else np.float32(0)
