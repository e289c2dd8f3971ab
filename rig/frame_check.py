"""Is a frame what it should be: readable, of its exposure, lit or dark, and in step with the frames before."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from bssrdf.calib import pile_up_dn, step_dn
from bssrdf.errors import InputError
from bssrdf.rig.steps import Step
from bssrdf.session import RawFrame, read_frame_file

Array = NDArray[np.float64]

LABEL_TOLERANCE = 0.07
"""Exposure labels are rounded by up to 6.7 %."""
_LABEL_STEP_S = 1e-4
"""PTP counts exposures in whole units of this: a camera may call 1/8000 s 0.0001 s."""
_IN_STEP = 0.15
"""Light may differ from the previous frame's, scaled by the exposure, by this: twice a rounded label."""
_SIGMAS = 8.0
_SATURATED = 0.98
"""Share of the white level from which a pixel no longer counts."""
_ALL = 0.9
_GLOW = 10.0
"""Noises between the darkest places and most of the picture from which light falls on all of it; one alone spans 5."""
_RANGE = 50.0
"""A camera's range holds more noises than this."""
_ROUNDING_SD = 0.3
"""Of a number that was rounded, in steps."""


class SeenFrame(NamedTuple):
    """What is kept of a frame to compare the next ones with."""

    exposure_s: float
    """As the file says; as it was asked for where the file says nothing."""
    light: Array
    """Light above the black level [DN], in cells of the mosaic's period, (h/2, w/2)."""
    clipped: NDArray[np.bool_]
    noise: float
    """Standard deviation of a cell without light [DN]."""
    peak: float
    """Brightest pixel over the white level; 0 where that is not known."""
    step: float = 1.0
    """Between neighbouring values [DN]; 0 where there is none."""
    exposure_rel_sd: float | None = None
    """As the file says; None: not stated."""

    @property
    def spot(self) -> float:
        """The brightest place [DN], hot pixels left out."""
        smooth = median_filter(self.light, 3, mode="nearest")
        return float(smooth.max() - np.median(self.light))

    @property
    def is_lit(self) -> bool:
        return self.spot > _SIGMAS * self.noise


def look(file: Path, white: float | None = None) -> tuple[RawFrame, SeenFrame]:
    """Read a frame and boil it down; InputError where it cannot be read."""
    frame = read_frame_file(file)
    step = step_dn(frame.data)
    cells = _cells(frame.data)
    light = cells.mean((1, 3, 4))
    differences = np.diff(light, axis=1)
    spread = 1.4826 * float(np.median(abs(differences - np.median(differences)))) / np.sqrt(2)
    noise = max(spread, _ROUNDING_SD * step)
    black = _lightless(frame.data, noise) if frame.black is None else float(np.mean(frame.black))
    stated = frame.white or white or _largest(frame.data.dtype)
    levels = _saturation(cells, stated, black, step, above=black + _RANGE * noise)
    seen = SeenFrame(
        exposure_s=frame.exposure_s or 0.0,
        light=light - black,
        clipped=np.asarray((cells >= _SATURATED * levels[:, None]).any((1, 3, 4))),
        noise=noise,
        peak=float(cells.max() / levels.min()),
        step=step,
        exposure_rel_sd=frame.exposure_rel_sd,
    )
    return frame, seen


def _cells(data: NDArray[Any]) -> NDArray[Any]:
    """The picture as (h/2, 2, w/2, 2, colours): places of the mosaic's period apart."""
    height, width = (size // 2 * 2 for size in data.shape[:2])
    return data[:height, :width].reshape(height // 2, 2, width // 2, 2, -1)


def _lightless(data: NDArray[Any], noise: float) -> float:
    """The level of most of the picture, unless that is lit too: then of its darkest places."""
    low, middle = np.percentile(data, (1, 50))
    return float(middle if middle - low < _GLOW * noise else low)


def _largest(kind: np.dtype[Any]) -> float:
    return float(np.iinfo(kind).max) if kind.kind == "u" else np.inf


def _saturation(cells: NDArray[Any], stated: float, black: float, step: float, *, above: float) -> Array:
    """Saturation [DN] by place and colour, (2, 2, colours): where samples pile up, if that is below what is stated.

    A camera of 12 bits may write files of 16. Noise ends in a pile as well, but not `above` it.
    """
    levels = np.full((2, 2, cells.shape[4]), stated)
    for row, column, colour in np.ndindex(levels.shape):
        pile = pile_up_dn(cells[:, row, :, column, colour].ravel(), step, black)
        if pile is not None and above < pile < stated:
            levels[row, column, colour] = pile
    return levels


def fault_of(step: Step, frame: RawFrame, seen: SeenFrame, before: SeenFrame | None) -> str:
    """What is wrong with a frame, in a few words; empty where nothing is. `before`: a longer frame of the subject."""
    said = frame.exposure_s
    if said is not None and not _is_labelled(said, step.exposure_s):
        return f"its file says {said:g} s, not {step.exposure_s:g} s"
    if not step.lit:
        return "it is not dark: the beam gets through" if seen.is_lit else ""
    if seen.clipped.mean() > _ALL:
        return "it is all saturated"
    if before is None:
        return "" if seen.is_lit else "it is all dark: shutter, beam or lens cap"
    return _out_of_step(seen, before)


def _is_labelled(said_s: float, label_s: float) -> bool:
    return abs(said_s / label_s - 1) <= LABEL_TOLERANCE or abs(said_s - label_s) < _LABEL_STEP_S


def _out_of_step(seen: SeenFrame, before: SeenFrame) -> str:
    """Compare with a frame of the same subject where neither is saturated."""
    ratio = seen.exposure_s / before.exposure_s
    if seen.light.shape != before.light.shape:
        return f"it has {seen.light.shape} cells, the frame before {before.light.shape}"
    bright = ~seen.clipped & ~before.clipped & (before.light * ratio > _SIGMAS * max(seen.noise, before.noise * ratio))
    if not bright.any():
        return "" if seen.is_lit or not before.is_lit else _too_dark(seen, before, ratio)
    expected, got = ratio * before.light[bright].sum(), seen.light[bright].sum()
    error = _SIGMAS * seen.noise * np.sqrt(bright.sum()) + 8 * np.sqrt(abs(expected) * seen.step)
    if abs(got - expected) > _IN_STEP * expected + error:
        return f"its light is {got / expected:.2f} of what the frame of {before.exposure_s:g} s lets expect"
    return ""


def _too_dark(seen: SeenFrame, before: SeenFrame, ratio: float) -> str:
    """Nothing shows: fair enough, unless the last frame was so bright that something had to."""
    return "it is all dark: shutter or beam" if before.spot * ratio > 2 * _SIGMAS * seen.noise else ""


def drift(first: SeenFrame, again: SeenFrame) -> float:
    """Relative change of the light between two frames of one exposure."""
    bright = ~first.clipped & ~again.clipped & (first.light > _SIGMAS * first.noise)
    total = first.light[bright].sum()
    return float(again.light[bright].sum() / total - 1) if total > 0 else 0.0


def check(file: Path, step: Step, before: SeenFrame | None, white: float | None) -> tuple[SeenFrame | None, str]:
    """What the frame shows, and what is wrong with it."""
    try:
        frame, seen = look(file, white)
    except InputError as error:
        return None, f"it cannot be read ({error})"
    seen = seen._replace(exposure_s=frame.exposure_s or step.exposure_s)
    return seen, fault_of(step, frame, seen, before)
