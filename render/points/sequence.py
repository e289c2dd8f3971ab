"""One sequence that fills space evenly, for all points of a body together."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

AXES = 6
_RATIO = 1.1127756842787055
"""x⁷ = x + 1: its powers are the steps of an additive sequence that fills six dimensions evenly (Roberts 2018)."""
_STEPS = [int((1 / _RATIO ** (k + 1)) % 1 * 2**32) for k in range(AXES)]


def uniform(number: Any, axis: int, seed: int) -> Any:
    """The number's term along an axis, from 0 to 1, from a start that the seed decides."""
    start = int(np.random.default_rng(seed * AXES + axis).integers(1 << 32))
    return mi.Float((number * mi.UInt32(_STEPS[axis]) + dr.opaque(mi.UInt32, start)) >> 8) * 2.0**-24
