"""Frames that are not what their labels say: exchanged, stored twice, not linear; darks of another temperature."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bssrdf.calib import Comparison, Exposed, Gain, LocalRatios
from bssrdf.errors import InputError
from bssrdf.measure.bracket import Bracket
from bssrdf.measure.levels import Level
from bssrdf.session.records import Array, Frame

_BLUNDER = float(np.log(1.2))
"""A label is right to a few percent (EXIF rounds by up to 6.7 %), a lamp too."""
_SAME_LIGHT = 0.03
_NO_LIGHT = float(np.log(30))
_FLOOR_SD = 10.0
"""Noises by which the darkest pixels lie above black where the dark is of another black,"""
_DARKEST_FRAMES = 3
"""in so many of the shortest frames alike: light would rise with the exposure."""
LEAST_PLACES, _UNEVEN_SHARE = 5, 0.02
"""So many places, and this share of them, show that frames differ from place to place,"""
_UNEVEN = float(np.log(2))
"""by this: a picture that moved by a pixel or two changes less, and is told otherwise."""
_GAMMA = (0.2, 0.8)
"""Power of the exposure by which encoded values rise,"""
_MOST_PAIRS, _LEAST_PAIRS = 0.7, 3
"""where this share of the pairs of frames, and so many, have one like it,"""
_MILD_GAMMA = 0.06
"""or all of these one that is off by this: the lamp and bend of the real bracket of the tests make it 0.04."""
_PHOTONS, _NEARLY_PHOTONS = 0.1, 0.3
"""How near to 1 the power is by which photon noise rises with light. With light that boils it is 1.15 as soon as a
fifth of the variance is not that of photons, 1.3 where it is a third; darks of other numbers make it 0.85."""
_OTHER_GAIN, _FAR_GAIN, _GAIN_SD = float(np.log(1.2)), float(np.log(1.8)), 6.0
"""A third of a stop of ISO is 1.26; numbers that were scaled are off by a factor of 4 or more."""
_DOUBLES_K = 6.5
"""Dark current of silicon doubles in 6 to 7 K around room temperature (band gap 1.12 eV)."""
_NOTICED_K = 1.0
"""Sensors state whole or half kelvins."""


def is_blunder(log_ratio: float, stated: float) -> bool:
    """Whether two frames' light, by the logarithm of its ratio, is another than `stated` by more than labels err."""
    return abs(log_ratio - float(np.log(stated))) > _BLUNDER


def check_light(
    frames: Sequence[Exposed],
    comparisons: Sequence[Comparison],
    rough: Mapping[tuple[int, int], float],
    levels: Mapping[str, Sequence[Level]],
    noise_dn: float,
) -> None:
    """InputError, naming the frames, where two neighbouring exposures differ in light by far more than labels err.

    `rough` is the logarithm of the ratio of two frames' light, for pairs with no comparison; `noise_dn` that of a pixel
    without light.
    """
    files = {(kind, level.label_s): level.files[0] for kind, each in levels.items() for level in each}
    found = {**rough, **_log_ratios(comparisons)}
    stated = {pair: float(np.log(frames[pair[1]].seconds / frames[pair[0]].seconds)) for pair in found}
    off = {pair: found[pair] - stated[pair] for pair in found if abs(found[pair] - stated[pair]) > _BLUNDER}
    power = np.array([found[pair] / stated[pair] for pair in found])
    if _is_encoded(power, blunders=bool(off)):
        raise InputError(
            f"{files[_name(frames[next(iter(found))[0]])]}: its values rise as the power {np.median(power):.2f} of the "
            "exposure instead of in proportion, as gamma-coded (sRGB) files do; develop the frames linearly"
        )
    if not off:
        return
    first, second = max(off, key=lambda pair: abs(off[pair]))
    shorter, longer = (files[_name(frames[at])] for at in (first, second))
    light, expected = float(np.exp(found[first, second])), float(np.exp(stated[first, second]))
    of_kind = levels[frames[first].kind][:_DARKEST_FRAMES]
    floors = [level.floor_dn for level in of_kind]
    if min(floors) > _FLOOR_SD * noise_dn and max(floors) < np.sqrt(of_kind[-1].label_s / of_kind[0].label_s) * min(
        floors
    ):
        raise InputError(
            f"{of_kind[0].files[0]}: lies {floors[0]:.4g} DN above its dark even where it is darkest, and so does "
            f"{of_kind[-1].files[0]}: their darks are of another black; take them with the camera set as for the frames"
        )
    if abs(found[first, second]) < _SAME_LIGHT:
        raise InputError(
            f"{longer}: shows the same light as {shorter}, not {expected:.3g} times as much: one of them was stored "
            "twice or has the other's exposure; take it again"
        )
    if abs(off[first, second]) > _NO_LIGHT:
        lit, unlit = (longer, shorter) if off[first, second] > 0 else (shorter, longer)
        raise InputError(
            f"{unlit}: shows hardly any light where {lit} promises it; take it again (was the shutter closed, or the "
            "beam off?)"
        )
    raise InputError(
        f"{longer}: shows {light:.3g} times the light of {shorter}, by their exposures it should be {expected:.3g} "
        "times; correct exposure_s in frames.csv, or take them again (was a frame exchanged, or the beam off?)"
    )


def _is_encoded(power: Array, *, blunders: bool) -> bool:
    """Whether light rises as one power of the exposure, of each pair of frames, that is not 1."""
    if len(power) < _LEAST_PAIRS:
        return False
    encoded = (power > _GAMMA[0]) & (power < _GAMMA[1])
    curved = abs(float(np.median(power)) - 1)
    alike = float(np.percentile(np.abs(power - np.median(power)), 100 * _MOST_PAIRS)) < curved / 3
    return bool((blunders and encoded.mean() > _MOST_PAIRS) or (alike and curved > _MILD_GAMMA))


def uneven_light(shorter: Level, longer: Level, local: LocalRatios, whole: float) -> list[str]:
    """A line where in part of two frames their light is in another ratio than `whole`, as a logarithm."""
    uneven = np.abs(local.log - whole) > _UNEVEN
    if np.count_nonzero(uneven) < max(LEAST_PLACES, _UNEVEN_SHARE * len(uneven)):
        return []
    y, x = np.median(local.place_px[uneven], axis=0)
    row = longer.rows[round(y)]
    times = float(np.exp(np.median(local.log[uneven]) - whole))
    return [
        f"{longer.files[0]}: shows around pixel ({x:.0f}, {row}) {times:.2g} times the light of {shorter.files[0]}, "
        "over that in the whole; take both again (a file that was cut, a shutter half open, a picture that moved?)"
    ]


def check_gains(gains: Mapping[str, Gain | None], files: Mapping[str, str]) -> None:
    """InputError where photon noise says that the kinds of frames were taken at different gains.

    Light that boils makes noise too, but of a higher power of the signal; and so does a filter that smooths pictures.
    """
    told = {kind: gain for kind, gain in gains.items() if gain and abs(gain.power - 1) < _NEARLY_PHOTONS}
    if len(told) < 2:
        return
    (kind, one), (other, two) = sorted(told.items(), key=lambda item: item[1].e_per_dn)
    apart, sd = float(np.log(two.e_per_dn / one.e_per_dn)), float(np.hypot(one.rel_sd, two.rel_sd))
    by_photons = max(abs(each.power - 1) for each in (one, two)) < _PHOTONS
    if apart > max(_OTHER_GAIN if by_photons else _FAR_GAIN, _GAIN_SD * sd):
        raise InputError(
            f"{files[kind]}: a DN of the {kind} is {one.e_per_dn:.3g} electrons by its noise, one of the {other} "
            f"{two.e_per_dn:.3g}: they were taken at different gains (ISO), or their numbers were scaled; take both "
            "anew with one setting"
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
