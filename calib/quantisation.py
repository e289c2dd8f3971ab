"""The step between neighbouring values of a camera's data, whatever container holds them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST_SAMPLES = 200_000
_CONTINUOUS = 0.5
"""Different values to samples from which data have no step that could be seen."""
_ROUNDING = 1e-6
"""Differences of float values below this share of the largest are rounding of the file."""


def step_dn(values: NDArray[Any]) -> float:
    """Step [DN] of a frame's values; 0 where there is none, infinite where a frame of one value does not tell."""
    sample = values.reshape(-1)
    sample = sample[:: max(1, sample.size // _MOST_SAMPLES)]
    levels = np.unique(sample)
    if np.issubdtype(levels.dtype, np.integer):
        gaps = np.diff(levels.astype(np.int64))
        return float(np.gcd.reduce(gaps)) if gaps.size else np.inf
    levels = levels[np.isfinite(levels)].astype(float)
    if levels.size > _CONTINUOUS * sample.size:
        return 0.0
    gaps = np.diff(levels)
    return float(gaps[gaps > _ROUNDING * np.abs(levels).max()].min(initial=np.inf))
