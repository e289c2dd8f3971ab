"""What the values of a frame tell by themselves: the step between them, and where they pile up at saturation.

A sensor may saturate well below the white level that its file states.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FALLS_SHORT = 1.2
_LEAST_PIXELS = 20
_NARROW = 0.05
_LEAST_SHARE = 0.1
_FEW_ABOVE = 0.1
"""Pixels above the plateau, hot ones, to pixels on it; and pixels that should be beyond it and are elsewhere."""
_PILE = 5.0
"""Samples in the last stretch of a histogram to those in the stretch before, from which they have piled up."""
_STEPS, _LEAST_ON_STEPS = 2, 4
_STRETCH, _LEAST_ON_STRETCH = 0.004, 20
"""A pile of a digital limit is two steps wide, that of a full well some thousandths of the range."""
_STRAY = 1e-4
"""Share of the samples that may lie beyond a pile-up: hot pixels of a camera that scales its colours."""
_MOST_SAMPLES = 200_000
_CONTINUOUS = 0.5
"""Different values to samples from which data have no step that could be seen."""
_ROUNDING = 1e-6
"""Differences of float values below this share of the largest are rounding of the file."""
_OFTEN = 1e-4
"""Share of the samples at a value that is one of the camera's steps,"""
_SMALL = 10
"""and the percentile of the gaps between such values: light may leave some of them out."""


def pile_up_dn(values: NDArray[Any], step_dn: float, black_dn: float) -> float | None:
    """The lower end of the pile-up that ends a histogram of one colour's samples, None where there is none."""
    values = values[np.isfinite(values)] if values.dtype.kind == "f" else values
    if not values.size:
        return None
    top = float(values.max())
    high = values[values > black_dn + 0.5 * (top - black_dn)].astype(np.float64)
    below_stray = high.size - 1 - int(_STRAY * values.size)
    for end in (top, float(np.partition(high, below_stray)[below_stray]) if below_stray >= 0 else top):
        for width, least in ((_STEPS * step_dn, _LEAST_ON_STEPS), (_STRETCH * (end - black_dn), _LEAST_ON_STRETCH)):
            on = np.count_nonzero((high > end - width) & (high <= end))
            before = np.count_nonzero((high > end - 2 * width) & (high <= end - width))
            if width > 0 and on >= least and on > _PILE * (1 + before):
                return end - width if width > _STEPS * step_dn else end
    return None


def plateau_dn(
    shorter: NDArray[Any], longer_raw: NDArray[Any], ratio: float, black_dn: float, white_dn: float
) -> float | None:
    """The lowest DN at which pixels stopped following the light, None where none did.

    `shorter` is the signal of a shorter exposure, `longer_raw` the raw longer one, `ratio` that of their times. A
    pixel has stopped if the shorter exposure promises a fifth more than it shows; a plateau is many of them at one DN.
    """
    span = white_dn - black_dn
    shown = longer_raw - np.float32(black_dn)
    stopped = longer_raw[(shorter * np.float32(ratio) > _FALLS_SHORT * shown) & (shown > _LEAST_SHARE * span)]
    if stopped.size < _LEAST_PIXELS:
        return None
    low, high = np.percentile(stopped, (2, 98))
    above = np.count_nonzero(longer_raw > high + _NARROW * span)
    beyond = longer_raw[shorter * np.float32(ratio) > _FALLS_SHORT * np.float32(high - black_dn)]
    there = np.count_nonzero((beyond >= low) & (beyond <= high))
    on_it = 2 * there > stopped.size and beyond.size - there < _FEW_ABOVE * stopped.size
    return float(low) if high - low < _NARROW * span and on_it and above < _FEW_ABOVE * stopped.size else None


def step_dn(values: NDArray[Any]) -> float:
    """Step [DN] of a frame's values; 0 where there is none, infinite where a frame of one value does not tell.

    By the gaps between values that occur often: a few, of pixels that were interpolated, may lie between the steps, and
    the steps of data that were scaled to a container's range differ by one.
    """
    sample = values.reshape(-1)
    sample = sample[:: max(1, sample.size // _MOST_SAMPLES)]
    levels, counts = np.unique(sample[np.isfinite(sample)], return_counts=True)
    if levels.dtype.kind == "f" and levels.size > _CONTINUOUS * sample.size:
        return 0.0
    often = levels[counts > max(1.0, _OFTEN * sample.size)]
    gaps = np.diff(often if often.size > 1 else levels).astype(float)
    gaps = gaps[gaps > _ROUNDING * float(np.abs(levels).max(initial=0))] if levels.dtype.kind == "f" else gaps
    return float(np.percentile(gaps, _SMALL, method="lower")) if gaps.size else np.inf
