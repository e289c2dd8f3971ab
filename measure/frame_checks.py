"""Frames that are not what their labels say: exchanged, stored twice, not linear; darks of another temperature."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bssrdf.calib import Comparison, Exposed
from bssrdf.errors import InputError
from bssrdf.measure.bracket import Bracket
from bssrdf.measure.levels import Level
from bssrdf.session.records import Frame

_BLUNDER = float(np.log(1.2))
"""A label is right to a few percent (EXIF rounds by up to 6.7 %), a lamp too."""
_SAME_LIGHT = 0.03
_GAMMA = (0.2, 0.8)
"""Power of the exposure by which encoded values rise,"""
_MOST_PAIRS, _LEAST_PAIRS = 0.7, 3
"""where this share of the pairs of frames, and so many, have one like it."""
_DOUBLES_K = 6.5
"""Dark current of silicon doubles in 6 to 7 K around room temperature (band gap 1.12 eV)."""
_NOTICED_K = 1.0
"""Sensors state whole or half kelvins."""


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


class WarmDark(NamedTuple):
    """The frame whose darks are furthest off."""

    warmer_k: float
    """How much warmer the darks were than the frame."""
    excess_dn: float
    """What they hold too much, in the median [DN]."""
    exposure_s: float

    def __str__(self) -> str:
        way = "warmer" if self.warmer_k > 0 else "colder"
        return f"{abs(self.warmer_k):.1f} K {way}, {self.excess_dn:+.2g} DN in the darks of {self.exposure_s:g} s"


def warm_dark(brackets: Iterable[Bracket]) -> WarmDark | None:
    """The largest excess of the darks over what their frames hold of dark signal; None where none is noticed."""
    found = [
        WarmDark(warmer, _excess_dn(bracket, darks, warmer), frame.exposure_s)
        for bracket in brackets
        for frame, darks in zip(bracket.frames[-1:], bracket.darks[-1:], strict=True)
        if (warmer := _warmer_k(frame, darks)) is not None and abs(warmer) >= _NOTICED_K
    ]
    return max(found, key=lambda dark: abs(dark.excess_dn), default=None)


def _warmer_k(frame: Frame, darks: tuple[Frame, ...]) -> float | None:
    known = [dark.card.temperature_c for dark in darks if dark.card.temperature_c is not None]
    if frame.card.temperature_c is None or not known:
        return None
    return float(np.mean(known)) - frame.card.temperature_c


def _excess_dn(bracket: Bracket, darks: tuple[Frame, ...], warmer_k: float) -> float:
    """By the dark signal between the shortest dark and this one."""
    longest, shortest = (float(np.median(bracket.read(dark))) for dark in (darks[0], bracket.darks[0][0]))
    return (longest - shortest) * (1 - 2 ** (-warmer_k / _DOUBLES_K))
