"""Each exposure left out of the merge and predicted from the others; the merge's noise against its bound.

Both on a sample of pixels, so that frames of any size take seconds. Radiance in DN/s, signals in DN.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import Sensor
from bssrdf.measure import Planes, bracket_of, corrections_of, grids_of, read_ahead, straight
from bssrdf.session import dark_for, from_plain
from bssrdf.session.records import Frame, Session

Floats = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

_PIXELS = 60_000
"""A ratio of sums over them is good to 0.01 % where they are bright."""
_BRIGHT_SD = 10.0
"""A pixel tells of an exposure where its prediction is that many times its noise."""
_FEWEST = 30
PREDICTED_WITHIN = 0.01
"""A shutter or lamp that departs by more makes an R that is off by as much."""
AT_BOUND = 1.25
"""Of the bound: neighbouring pixels differ by some percent of structure as well."""
_LEAST_PAIRS = 200
_DROWNED = 0.5
"""Of the light: where noise is more, a decade of it says nothing."""


class LeftOut(NamedTuple):
    """One frame, predicted from the others of its kind."""

    kind: str
    file: str
    exposure_s: float
    departure: float
    """Light seen over light predicted, less 1."""
    departure_sd: float
    """By noise, and the stated error of the exposure time."""
    n: int
    """Pixels that tell."""

    @property
    def holds(self) -> bool:
        return abs(self.departure) <= max(PREDICTED_WITHIN, 3 * self.departure_sd)


class Decade(NamedTuple):
    """Pixels of a tenth to all of ten to the −`below` of the brightest: relative noise, medians."""

    below: int
    bound: float
    """What no merge of these frames can beat: shot, read and dark noise, each frame weighted as it deserves."""
    stated: float
    """By the merge's own variance map."""
    seen: float
    """From the differences of neighbouring pixels of a colour; NaN where the light itself changes too much."""
    n: int


def sensor_of(provenance: Mapping[str, Any]) -> Sensor | None:
    """The sensor that the merge went by; None where it was merged elsewhere."""
    try:
        return from_plain(Sensor, provenance["sensor"])
    except (KeyError, TypeError, ValueError):
        return None


def left_out(
    session: Session, frames: Sequence[Frame], provenance: Mapping[str, Any], progress: Progress | None = None
) -> list[LeftOut] | str:
    """Every frame of sample and reference, predicted; or in words why not."""
    sensor = sensor_of(provenance)
    if sensor is None:
        return "the images were merged elsewhere"
    if session.camera.response is not None:
        return "not done for frames that are not linear"
    found: list[LeftOut] = []
    for kind in ("sample", "reference"):
        bracket = bracket_of(kind, session.path, frames)
        seconds = provenance.get("exposures_s", {}).get(kind, [])
        if len(bracket.frames) < 2 or len(seconds) != len(bracket.frames):
            continue
        signals, lit = [], []
        corrections = corrections_of(provenance, kind, [frame.exposure_s for frame in bracket.frames], sensor)
        for done, (_, sample) in enumerate(read_ahead(bracket.shots(seconds, corrections))):
            if progress:
                progress(f"leave out {kind}", done, len(seconds))
            step = max(1, sample.raw.shape[0] * sample.raw.shape[1] // _PIXELS)
            keep = sensor.unsaturated(sample.raw).reshape(-1)[::step]
            signals.append(straight(sample, sensor).reshape(-1)[::step].astype(float))
            lit.append(keep)
        by_label = provenance.get("exposures_rel_sd", {})
        found += _predicted(kind, bracket.frames, np.array(seconds), np.array(signals), np.array(lit), sensor, by_label)
    return found or "a bracket of one frame leaves nothing to predict it from"


def _predicted(
    kind: str,
    frames: Sequence[Frame],
    seconds: Floats,
    signals: Floats,
    lit: NDArray[np.bool_],
    sensor: Sensor,
    rel_sd: Mapping[str, float],
) -> list[LeftOut]:
    light, time = (signals * lit).sum(axis=0), (seconds[:, None] * lit).sum(axis=0)
    outcome = []
    for at, frame in enumerate(frames):
        others = time - seconds[at] * lit[at]
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = (light - signals[at] * lit[at]) / others * seconds[at]
        noise = _noise_of_prediction(
            expected, seconds[at] / np.maximum(others, 1e-12), lit.sum(axis=0) - lit[at], sensor
        )
        tells = lit[at] & (others > 0) & (expected > _BRIGHT_SD * noise) & (expected < 0.9 * sensor.span_dn())
        if tells.sum() < _FEWEST:
            continue
        whole = float(expected[tells].sum())
        own = float((noise[tells] ** 2).sum()) ** 0.5 / whole
        stated = float(rel_sd.get(f"{kind} {frame.exposure_s:g}", 0.0))
        departure = float(signals[at][tells].sum()) / whole - 1
        outcome.append(
            LeftOut(kind, frame.file, frame.exposure_s, departure, float(np.hypot(own, stated)), int(tells.sum()))
        )
    return outcome


def _noise_of_prediction(expected: Floats, ratio: Floats, n_others: NDArray[np.int_], sensor: Sensor) -> Floats:
    """Of signal less prediction [DN]: the frame's own, and that of `n_others` shorter by `ratio`, grown by as much.

    A choice of pixels by a noisy prediction favours what noise has lifted: where only the frame's own noise decided, a
    bracket in steps of 8 lost 2 % of its longest exposure.
    """
    read, shot = 2 * sensor.read_var_dn(), np.maximum(expected, 0) / sensor.gain_e_per_dn
    return np.sqrt(shot * (1 + ratio) + read * (1 + n_others * ratio**2))


def merge_noise(
    hdr: Planes, layout: str, channel: str, seconds: Sequence[float], sensor: Sensor, n_darks: float
) -> list[Decade]:
    """Noise by decade below the brightest pixel of a channel, beside the bound of its frames."""
    grid = grids_of(hdr, layout, channel)[0]
    good = (grid.mask == 0) & np.isfinite(grid.radiance) & (grid.radiance > 0)
    if not good.any():
        return []
    value, sd = grid.radiance.astype(float), np.sqrt(grid.variance.astype(float))
    trio = good[:, :-2] & good[:, 1:-1] & good[:, 2:]
    middle = value[:, 1:-1]
    bend = (middle - (value[:, :-2] + value[:, 2:]) / 2) / np.sqrt(1.5)
    slope = np.abs(value[:, 2:] - value[:, :-2]) / 2
    top, bound = float(value[good].max()), _bound(sensor, seconds, n_darks)
    decades = []
    for below in range(int(np.ceil(np.log10(top / max(float(np.median(value[good])), 1e-300)))) + 1):
        inside = (value <= top / 10**below) & (value > top / 10 ** (below + 1)) & good
        if inside.sum() < _FEWEST:
            continue
        light, own = float(np.median(value[inside])), float(np.median(sd[inside] / value[inside]))
        if own > _DROWNED:
            break
        pairs = inside[:, 1:-1] & trio & (slope < 2 * sd[:, 1:-1])
        seen = np.nan
        if pairs.sum() >= _LEAST_PAIRS:
            seen = float(1.4826 * np.median(np.abs(bend[pairs] / middle[pairs])))
        decades.append(Decade(below, float(bound(light) / light), own, seen, int(inside.sum())))
    return decades


def darks_each(frames: Sequence[Frame], kind: str) -> float:
    """Darks for a frame of a kind, on average."""
    own = [frame for frame in frames if frame.kind == kind]
    return float(np.mean([len(dark_for(frame, frames)) for frame in own])) if own else 1.0


def _bound(sensor: Sensor, seconds: Sequence[float], n_darks: float) -> Callable[[float], float]:
    """The sd that the best weighted mean of the unsaturated frames has at a radiance [DN/s]."""
    times = np.asarray(seconds, float)

    def sd(light: float) -> float:
        used = times[light * times < sensor.span_dn()]
        variance = light * used / sensor.gain_e_per_dn + sensor.read_var_dn() * (1 + 1 / max(n_darks, 1.0))
        information = float((used**2 / variance).sum())
        return information**-0.5 if information > 0 else float("nan")

    return sd
