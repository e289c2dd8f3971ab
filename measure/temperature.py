"""Darks taken at another temperature than their frames, where the files tell: what that does to the dark signal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from bssrdf.measure.bracket import Bracket
from bssrdf.session.records import Frame

_DOUBLES_K = 6.5
"""Dark current of silicon doubles in 6 to 7 K around room temperature (band gap 1.12 eV)."""
_NOTICED_K = 1.0
"""Sensors state whole or half kelvins."""


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
