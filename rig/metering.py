"""Exposures that a sample needs, from a few shots: skim milk and ketchup differ by decades."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bssrdf.errors import InputError
from bssrdf.rig.frame_check import SeenFrame

_NOISES = 3.0
"""The longest frame shows the border of the picture this many noises above its darks …"""
_RIM = 0.1
"""… where the border is this share of the frame on each side."""


def metered(shot: Callable[[float], SeenFrame], offered_s: Sequence[float]) -> tuple[float, ...]:
    """The camera's times from the longest without a saturated place to one that shows the border, descending.

    The bracket has the time below the longest unsaturated one as well, if there is one.
    """
    if not offered_s:
        raise InputError("plan.toml: auto = true needs a camera that tells its exposure times; give list_s")
    times = sorted(offered_s)
    low, high = 0, len(times) - 1
    while low < high:  # the largest index that is not saturated
        middle = (low + high + 1) // 2
        if shot(times[middle]).clipped.any():
            high = middle - 1
        else:
            low = middle
    last = low
    while last < len(times) - 1 and not _border_shows(shot(times[last])):
        last += 1
    return tuple(reversed(times[max(low - 1, 0) : last + 1]))


def _border_shows(seen: SeenFrame) -> bool:
    height, width = seen.light.shape
    rim = np.ones((height, width), bool)
    rim[int(_RIM * height) : -int(_RIM * height) or None, int(_RIM * width) : -int(_RIM * width) or None] = False
    return bool(np.median(seen.light[rim]) > _NOISES * seen.noise)
