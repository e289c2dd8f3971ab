"""Frames that cannot be what their labels say: exchanged, stored twice, of another exposure, or not linear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bssrdf.calib.exposures import Comparison
from bssrdf.calib.frame_model import Exposed
from bssrdf.errors import InputError
from bssrdf.measure.levels import Level

_BLUNDER = float(np.log(1.2))
"""A label is right to a few percent (EXIF rounds by up to 6.7 %), a lamp too."""
_SAME_LIGHT = 0.03
_GAMMA = (0.2, 0.8)
"""Power of the exposure by which encoded values rise,"""
_MOST_PAIRS, _LEAST_PAIRS = 0.7, 3
"""where this share of the pairs of frames, and so many, have one like it."""


def check_light(
    frames: Sequence[Exposed],
    comparisons: Sequence[Comparison],
    rough: Mapping[tuple[int, int], float],
    levels: Mapping[str, Sequence[Level]],
) -> None:
    """InputError, naming the frames, where two neighbouring exposures differ in light by far more than labels err.

    `rough` is the logarithm of the ratio of two frames' light, for pairs with no comparison.
    """
    files = {(kind, level.label_s): level.files[0] for kind, each in levels.items() for level in each}
    found = {**rough, **_log_ratios(comparisons)}
    stated = {pair: float(np.log(frames[pair[1]].seconds / frames[pair[0]].seconds)) for pair in found}
    off = {pair: found[pair] - stated[pair] for pair in found if abs(found[pair] - stated[pair]) > _BLUNDER}
    if not off:
        return
    power = np.array([found[pair] / stated[pair] for pair in found])
    middle = float(np.median(power))
    encoded = (power > _GAMMA[0]) & (power < _GAMMA[1])
    if len(power) >= _LEAST_PAIRS and encoded.mean() > _MOST_PAIRS:
        raise InputError(
            f"{files[_name(frames[next(iter(off))[0]])]}: its values rise as the power {middle:.2f} of the exposure "
            "instead of in proportion, as gamma-coded (sRGB) files do; develop the frames linearly"
        )
    first, second = max(off, key=lambda pair: abs(off[pair]))
    shorter, longer = (files[_name(frames[at])] for at in (first, second))
    light, expected = float(np.exp(found[first, second])), float(np.exp(stated[first, second]))
    if abs(found[first, second]) < _SAME_LIGHT:
        raise InputError(
            f"{longer}: shows the same light as {shorter}, not {expected:.3g} times as much: one of them was stored "
            "twice or has the other's exposure; take it again"
        )
    raise InputError(
        f"{longer}: shows {light:.3g} times the light of {shorter}, by their exposures it should be {expected:.3g} "
        "times; correct exposure_s in frames.csv, or take them again (was a frame exchanged, or the beam off?)"
    )


def _name(frame: Exposed) -> tuple[str, float]:
    return frame.kind, frame.label_s


def _log_ratios(comparisons: Sequence[Comparison]) -> dict[tuple[int, int], float]:
    """By pair of frames: ln of the ratio of their light, by the brightest pixels of each colour."""
    brightest: dict[tuple[int, int, int], Comparison] = {}
    for each in comparisons:
        key = each.first, each.second, each.colour
        if key not in brightest or each.longer > brightest[key].longer:
            brightest[key] = each
    pairs: dict[tuple[int, int], list[float]] = {}
    for each in brightest.values():
        pairs.setdefault((each.first, each.second), []).append(float(np.log(each.longer / each.shorter)))
    return {pair: float(np.median(values)) for pair, values in pairs.items()}
