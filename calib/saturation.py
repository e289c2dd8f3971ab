"""Where a sensor really saturates: its plateau in the frames, which may lie well below the white level of the file."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FALLS_SHORT = 1.2
_LEAST_PIXELS = 20
_NARROW = 0.05
_LEAST_SHARE = 0.1
_FEW_ABOVE = 0.1
"""Pixels above the plateau, hot ones, to pixels on it."""


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
    return float(low) if high - low < _NARROW * span and above < _FEW_ABOVE * stopped.size else None
