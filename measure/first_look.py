"""The camera as its table, its darks and its longest exposures show it at first sight: levels, step, read noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import Sensor, clipped_variance, pile_up_dn, read_noise_dn, step_dn, thinned
from bssrdf.errors import InputError
from bssrdf.measure.bracket import Bracket
from bssrdf.measure.pixels import check_picture, mosaic_period, places
from bssrdf.session.flags import Flag
from bssrdf.session.records import Camera

MARGIN = 0.01
"""Samples this close to saturation, as a share of the range, are taken as clipped: the response bends there."""
GAIN_GUESS = 1.0
"""Electrons a step, until the frames tell."""
_CLIPPED_SHARE = 0.3
"""Share of a dark's pixels at its lowest value above which the camera clips at black,"""
_ABOVE_SHARE = 0.05
"""where that value is 0, or this share lies above: a whole dark at one value has noise below a step."""
_NEARLY_ALL = 0.99
_SHOWN = 0.6
"""Noise in steps that makes a dark show three values or more in over 1 % of its pixels each."""
_LOWER = 0.005
"""A pile-up this share of the range below the stated white is another limit than that."""


def first_guess(brackets: Sequence[Bracket], camera: Camera) -> tuple[Sensor, list[str]]:
    """The sensor, its read noise by a gain that is a guess yet, and the flags that its levels raise."""
    shortest = max((bracket.darks[0] for bracket in brackets), key=len)[:2]
    darks = [brackets[0].read(dark) for dark in shortest]
    longest = [bracket.read(bracket.frames[-1]) for bracket in brackets]
    for bracket, picture in zip(brackets, longest, strict=True):
        check_picture(bracket.frames[-1].file, picture)
    step = _step([*darks, *longest])
    if _levels(darks[0]) == 1 and np.median(darks[0]) > 0:
        _check_noise(brackets, step)
    black = camera.black if camera.black is not None else float(np.median(thinned(darks[0])))
    saturations, flags = _saturations(longest, camera, step, black)
    gain = camera.gain_e_per_dn or GAIN_GUESS / (step or 1.0)
    noise_dn = read_noise_dn(darks[0], darks[1] if len(darks) > 1 else None)
    read_noise_e = camera.read_noise_e if camera.read_noise_e is not None else noise_dn * gain
    sensor = Sensor(
        black,
        min(saturations),
        gain,
        read_noise_e,
        _clips_at_black(darks[0]),
        _levels(darks[0]),
        step,
        saturations if len(set(saturations)) > 1 else (),
    )
    return sensor, flags


def _step(frames: Sequence[NDArray[np.generic]]) -> float:
    """The smallest step of several frames: one alone may show every second value only."""
    step = min(step_dn(frame) for frame in frames)
    return step if np.isfinite(step) else 1.0


def _check_noise(brackets: Sequence[Bracket], step: float) -> None:
    """InputError where a dark shows one value, and its frame, in its darker half, noise that the dark should show."""
    bracket = max(brackets, key=lambda bracket: len(bracket.darks[0]))
    frame, dark = bracket.frames[0], bracket.darks[0][0]
    data = bracket.read(frame).astype(float)
    apart = 2 if data.ndim == 2 else 1
    dark_half = data[:, apart:] <= np.median(data)
    noise_dn = float(np.sqrt(clipped_variance((data[:, apart:] - data[:, :-apart])[dark_half]) / 2))
    if noise_dn > _SHOWN * step:
        raise InputError(
            f"{dark.file}: shows one value in nearly all pixels, where {frame.file} has a noise of {noise_dn:.2g} DN: "
            "it is not a picture by this camera; take darks with the beam blocked"
        )


def _clips_at_black(dark: NDArray[np.generic]) -> bool:
    lowest = dark.min()
    return bool(np.mean(dark == lowest) > _CLIPPED_SHARE and (lowest == 0 or np.mean(dark > lowest) > _ABOVE_SHARE))


def _levels(dark: NDArray[np.generic]) -> int:
    """How many values nearly all pixels of a dark show: 1, 2, or 3 for more."""
    counts = np.sort(np.unique(dark, return_counts=True)[1])[::-1]
    return min(3, int(np.searchsorted(np.cumsum(counts), _NEARLY_ALL * dark.size)) + 1)


def _saturations(
    longest: Sequence[NDArray[np.generic]], camera: Camera, step: float, black: float
) -> tuple[tuple[float, ...], list[str]]:
    """Saturation [DN] by place in a cell or channel: where samples pile up, else by the stated white."""
    at_places = places(longest[0].shape, mosaic_period(camera.layout or "mono"))
    piles = [
        min((pile for frame in longest if (pile := pile_up_dn(frame[at], step, black)) is not None), default=np.inf)
        for at in at_places
    ]
    stated = float(camera.white) if camera.white is not None else np.inf
    tops = [max(float(frame[at].max()) for frame in longest) for at in at_places]
    whites = [min(pile, stated) for pile in piles]
    flags: list[str] = []
    if not np.isfinite(piles).any():
        flags.append(Flag.WHITE_UNSEEN)
    if any(pile < stated - _LOWER * (stated - black) for pile in piles if np.isfinite(stated)):
        flags.append(Flag.WHITE_BELOW_STATED)
    return tuple(
        white - MARGIN * (white - black) if np.isfinite(white) else top + max(step, np.spacing(np.float32(top)))
        for white, top in zip(whites, tops, strict=True)
    ), flags
