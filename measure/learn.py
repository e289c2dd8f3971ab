"""What the frames tell of their own camera: gain, read noise, hot pixels, scale and black by frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import (
    Comparison,
    Exposed,
    Exposures,
    FrameModel,
    Gain,
    InCommon,
    Sensor,
    clipped_variance,
    comparable,
    compared,
    leak_of,
    local_log_ratios,
    pair_gain,
    plateau_dn,
    rough_log_ratio,
    shared_noise,
    shift_between,
    solve_frames,
    thinned,
)
from bssrdf.errors import InputError
from bssrdf.measure.bracket import Bracket
from bssrdf.measure.first_look import MARGIN, first_guess
from bssrdf.measure.frame_checks import LEAST_PLACES, check_gains, check_light, is_blunder, uneven_light
from bssrdf.measure.hdr import Progress
from bssrdf.measure.levels import Correction, Level, beside, levels_of
from bssrdf.measure.pixels import places
from bssrdf.session.flags import Flag
from bssrdf.session.records import Camera

_MAX_PIXELS = 2_000_000
"""More than this many pixels tell nothing new about a pair of exposures."""
_HOT_SD = 8.0
_MOVED_PX = 0.15
_MOVED_SD = 6.0
_FAR_PX = 0.5
"""Pixels of a colour: the curve near the beam is off by percents from here on."""
_LABEL_OFF = 0.01
_CONTRADICT = 0.005
_NONLINEAR = 0.03
_DRIFT = 0.005
_SURE_SD = 4.0
"""An offset or a bend is allowed for where it is that clear."""
_NOTABLE = 0.1
"""Share of the read noise below which an offset is not worth the trouble."""


@dataclass(frozen=True)
class Learnt:
    """The sensor model, what the frames stand for, and what was found on the way."""

    sensor: Sensor
    hot: NDArray[np.bool_]
    exposures: Exposures
    corrections: Mapping[tuple[str, float], Correction]
    """By kind and label; only where there is something to correct."""
    gain_rel_sd: float
    """NaN where the gain was given or could not be measured."""
    nonlinearity: float
    """Bend of the response over the range, relative."""
    contradiction: float
    """Relative error of each frame's light that the frames' disagreement asks for."""
    flux_rel_sd: dict[str, float]
    """Scatter of the light between repeated frames, by kind."""
    flags: tuple[str, ...]


@dataclass
class _Found:
    """What the levels and the pairs of neighbouring ones told."""

    frames: list[Exposed] = field(default_factory=list)
    gains: dict[str, list[Gain]] = field(default_factory=dict)
    """By kind."""
    comparisons: list[Comparison] = field(default_factory=list)
    shared: list[InCommon] = field(default_factory=list)
    """Comparisons that rest on the same pixels of one frame."""
    n_compared: list[int] = field(default_factory=list)
    """Pixels of each comparison."""
    used: dict[int, NDArray[np.int32]] = field(default_factory=dict)
    """By colour: one more than the number of the comparison that each pixel of the last pair went into, 0 for none."""
    light: dict[tuple[int, int], float] = field(default_factory=dict)
    """Logarithm of the ratio of the light of two frames, roughly."""
    plateaus: dict[int, float] = field(default_factory=dict)
    """Lowest DN at which pixels stopped following the light, by place in a cell."""
    n_places: int = 1
    """In a cell of the mosaic, or channels."""
    moved: bool = False
    moved_far: list[str] = field(default_factory=list)
    """A line for each frame whose picture moved by more than can be borne."""
    uneven: list[str] = field(default_factory=list)
    """A line for each frame that was lit in part."""
    levels: dict[str, list[Level]] = field(default_factory=dict)
    """By kind, without their pixels."""


def learn_camera(brackets: Sequence[Bracket], camera: Camera, period: int, progress: Progress | None = None) -> Learnt:
    """Complete the model of `camera` from the frames of all brackets together.

    InputError, naming the frames, where one cannot be of the light that its label says.
    """
    sensor, flags = first_guess(brackets, camera)
    found = _compare(brackets, camera, sensor, period, progress)
    if found.plateaus:
        sensor = _lowered(sensor, found.plateaus, found.n_places)
        found = _compare(brackets, camera, sensor, period, progress)

    gain = camera.gain_e_per_dn
    gain_rel_sd = np.nan
    if gain is None:
        estimate = _mean_gain([each for of_kind in found.gains.values() for each in of_kind])
        gain, gain_rel_sd, _ = estimate or Gain(sensor.gain_e_per_dn, np.nan)  # the first guess
        if estimate is None:
            flags.append(Flag.GAIN_UNKNOWN)
    read_noise_e = camera.read_noise_e
    if read_noise_e is None:
        read_noise_e = sensor.read_noise_e / sensor.gain_e_per_dn * gain
    sensor = replace(sensor, gain_e_per_dn=gain, read_noise_e=read_noise_e)

    noise_dn, span_dn = float(np.sqrt(sensor.read_var_dn())), sensor.span_dn()
    model = solve_frames(found.frames, found.comparisons, found.n_places, noise_dn, span_dn, found.shared)
    near = leak_of(model, found.frames, found.comparisons, noise_dn, span_dn)
    sensor = replace(sensor, bend=model.bend)
    leak = np.where(np.abs(near.dn) > np.maximum(_SURE_SD * near.sd_dn, _NOTABLE * noise_dn), near.dn, 0.0)
    model = replace(model, contradiction=near.contradiction) if leak.any() else model
    names = tuple((frame.kind, frame.label_s) for frame in found.frames)
    corrections = _corrections(names, model, leak, noise_dn)
    flux = {kind: max(level.flux_rel_sd(sensor) for level in levels) for kind, levels in found.levels.items()}
    flags += [Flag.BLACK_CLIPPED] if sensor.black_clipped else []
    flags += _flags(found, model, corrections, flux)
    return Learnt(
        sensor,
        _hot(brackets, sensor),
        Exposures(names, model.log_scale, model.covariance),
        {name: replace(correction, sensor=sensor) for name, correction in corrections.items()},
        gain_rel_sd,
        abs(model.bend),
        model.contradiction,
        flux,
        tuple(flags),
    )


def _lowered(sensor: Sensor, plateaus: Mapping[int, float], n_places: int) -> Sensor:
    """The sensor that saturates at the plateaus which were found by place."""
    levels = {at: plateau - MARGIN * (plateau - sensor.black_dn) for at, plateau in plateaus.items()}
    lowered = tuple(min(sensor.saturation_at(at), levels.get(at, np.inf)) for at in range(n_places))
    return replace(sensor, saturation_dn=min(lowered), saturations_dn=lowered)


def _compare(
    brackets: Sequence[Bracket], camera: Camera, sensor: Sensor, period: int, progress: Progress | None
) -> _Found:
    """Hold each level of each bracket against the one before it."""
    found = _Found()
    for bracket in brackets:
        exposed = _exposed(bracket, camera)
        done: list[Level] = []
        found.used.clear()
        lit = False
        for level in levels_of(bracket, sensor):
            lit = lit or bool(level.unsaturated(sensor).any())
            found.frames.append(exposed[level.label_s])
            found.gains.setdefault(bracket.kind, []).extend([level.gain] if level.gain else [])
            if done:
                _compare_pair(found, done[-1], level, sensor, period)
                done[-1] = replace(done[-1], signal=np.zeros(0, np.float32), brightest=np.zeros(0))
            done.append(level)
            if progress:
                progress(f"compare {bracket.kind}", len(done), len(exposed))
        if not lit:
            raise InputError(
                f"{done[0].files[0]}: every pixel of the {bracket.kind} is saturated in every exposure; add "
                "shorter exposures"
            )
        found.levels[bracket.kind] = done
    check_light(found.frames, found.comparisons, found.light, found.levels, float(np.sqrt(sensor.read_var_dn())))
    for line in found.moved_far:
        raise InputError(line)
    if not found.moved:
        gains = {kind: _mean_gain(each) for kind, each in found.gains.items()}
        check_gains(gains, {kind: levels[0].files[0] for kind, levels in found.levels.items()})
    for line in found.uneven:  # last: numbers that were scaled look uneven where their white is not seen
        raise InputError(line)
    return found


def _exposed(bracket: Bracket, camera: Camera) -> dict[float, Exposed]:
    """What the frames of each label are stated to stand for: the mean where several were measured."""
    by_label: dict[float, Exposed] = {}
    seconds = dict[float, list[float]]()
    for frame, t in zip(bracket.frames, bracket.exposures_s(), strict=True):
        seconds.setdefault(frame.exposure_s, []).append(t)
        rel_sd, own = bracket.exposure_rel_sd(frame, camera), frame.exposure_measured_s is not None
        mean = float(np.mean(seconds[frame.exposure_s]))
        by_label[frame.exposure_s] = Exposed(bracket.kind, frame.exposure_s, mean, rel_sd, own)
    return by_label


def _compare_pair(found: _Found, before: Level, level: Level, sensor: Sensor, period: int) -> None:
    second = len(found.frames) - 1
    ratio = found.frames[second].seconds / found.frames[second - 1].seconds
    a, b = before.signal, level.signal
    fine = before.unsaturated(sensor), level.unsaturated(sensor)
    near = beside(~fine[0]), beside(~fine[1])
    rough = rough_log_ratio(a, b, fine[0] & fine[1], sensor)
    # Above the darkest pixels: there a black that moved since the dark was taken is not in the ratio.
    above = [each.signal - np.float32(max(each.floor_dn, 0.0)) for each in (before, level)]
    local = local_log_ratios(above[0], above[1], fine[0] & fine[1], ratio, sensor)
    if rough is None and len(local.log) >= LEAST_PLACES:
        rough = float(np.median(local.log))
    if rough is not None:
        found.light[second - 1, second] = rough
        if not is_blunder(rough, ratio):
            found.uneven += uneven_light(before, level, local, rough)
    chosen = np.zeros(a.shape, bool)
    found.n_places = len(places(a.shape, period))
    for colour, at in enumerate(places(a.shape, period)):
        saturation = sensor.saturation_at(colour)
        span = saturation - sensor.black_dn
        plateau = plateau_dn(a[at], level.brightest[at], ratio, sensor.black_dn, saturation)
        if plateau is not None and plateau < saturation:
            found.plateaus[colour] = min(plateau, found.plateaus.get(colour, np.inf))
        chosen[at] = fine[0][at] & fine[1][at] & comparable(a[at], b[at], ratio, sensor, span)
    _thin_rows(chosen, period)
    for colour, at in enumerate(places(a.shape, period)):
        _by_brightness(found, colour, (a[at], b[at]), (near[0][at], near[1][at]), chosen[at], ratio, sensor)
    if before.n_frames == level.n_frames == 1:
        x, y = (plane[chosen].astype(float) for plane in (a, b))
        gain = pair_gain(x, y, sensor.read_var_dn() * (1 + 1 / level.n_darks)) if x.sum() > 0 and y.sum() > 0 else None
        found.gains[found.frames[second].kind] += [gain] if gain else []
    one = (..., 1) if a.ndim == 3 else ...
    light = [float(plane[chosen].sum(dtype=float)) for plane in (a, b)]
    times = np.float32(light[1] / light[0]) if min(light) > 0 else None
    shift = None if times is None else shift_between(a[one], b[one] / times, chosen[one], period)
    if shift and shift.length_px > max(_MOVED_PX, _MOVED_SD * shift.sd_px):
        found.moved = True
        if shift.length_px > _FAR_PX * period:
            found.moved_far.append(
                f"{level.files[0]}: the picture moved by about {shift.length_px:.1f} px since {before.files[0]}; take "
                "the bracket again on a still stand"
            )


def _by_brightness(
    found: _Found,
    colour: int,
    signals: tuple[NDArray[np.float32], NDArray[np.float32]],
    near: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    chosen: NDArray[np.bool_],
    ratio: float,
    sensor: Sensor,
) -> None:
    """Compare one colour of the last two frames, pixels beside saturated ones apart."""
    second = len(found.frames) - 1
    before, used = found.used.get(colour), np.zeros(chosen.size, np.int32)
    every = np.flatnonzero(chosen)
    first_beside, second_beside = (plane.ravel()[every] for plane in near)
    shorter_, longer_ = (signal.ravel()[every].astype(float) for signal in signals)
    for beside_ in ((False, False), (False, True), (True, True)):
        here = (first_beside == beside_[0]) & (second_beside == beside_[1])
        which, x, y = every[here], shorter_[here], longer_[here]
        for members, shorter, longer, log_var in compared(x, y, ratio, sensor):
            found.comparisons.append(Comparison(second - 1, second, colour, *beside_, shorter, longer, log_var))
            found.n_compared.append(len(members))
            used[which[members]] = len(found.comparisons)
            if before is not None:
                _note_shared(found, before[which[members]], x[members])
    found.used[colour] = used


def _note_shared(found: _Found, before: NDArray[np.int32], light: NDArray[np.float64]) -> None:
    """What the newest comparison has in common with those that its pixels went into before."""
    newest = len(found.comparisons) - 1
    common = np.bincount(before, light)
    for number in np.flatnonzero(common[1:]).tolist():
        pairs = ((found.comparisons[at], found.n_compared[at]) for at in (number, newest))
        (first, n_first), (second, n_second) = pairs
        correlation = shared_noise(first, n_first, second, n_second, float(common[number + 1]))
        found.shared.append(InCommon(number, newest, correlation))


def _thin_rows(chosen: NDArray[np.bool_], period: int) -> None:
    """Clear whole rows of a mask, evenly, until few enough pixels are left."""
    keep_every = -(-int(np.count_nonzero(chosen)) // _MAX_PIXELS)
    if keep_every > 1:
        chosen[np.arange(len(chosen)) // period % keep_every != 0] = False


def _mean_gain(gains: Sequence[Gain]) -> Gain | None:
    if not gains:
        return None
    weights = [1 / gain.rel_sd**2 for gain in gains]
    inverse = np.average([1 / gain.e_per_dn for gain in gains], weights=weights)
    told = [(gain.power, weight) for gain, weight in zip(gains, weights, strict=True) if np.isfinite(gain.power)]
    power = sum(power * weight for power, weight in told) / sum(weight for _, weight in told) if told else np.nan
    return Gain(float(1 / inverse), float(np.sum(weights) ** -0.5), power)


def _corrections(
    names: Sequence[tuple[str, float]], model: FrameModel, leak: NDArray[np.float64], noise_dn: float
) -> dict[tuple[str, float], Correction]:
    """Offsets of black that are sure, and what saturated neighbours add, by kind and label."""
    sure = np.abs(model.offset_dn) > np.maximum(_SURE_SD * model.offset_sd_dn, _NOTABLE * noise_dn)
    offsets = model.offset_dn if sure.any() else np.zeros_like(model.offset_dn)
    if not (sure.any() or leak.any()):
        return {}
    return {
        name: Correction(tuple(offset.tolist()), tuple(leak.tolist()))
        for name, offset in zip(names, offsets, strict=True)
    }


def _hot(brackets: Sequence[Bracket], sensor: Sensor) -> NDArray[np.bool_]:
    """Pixels whose dark signal in the longest exposure stands far out: hot ones, and dead ones far below black."""
    longest = max((bracket.darks[-1][0] for bracket in brackets), key=lambda dark: dark.exposure_s)
    dark = brackets[0].read(longest).astype(np.float32)
    excess = dark - np.float32(np.median(thinned(dark)))
    noise = np.sqrt(clipped_variance(thinned(excess).astype(float)) + 3 * sensor.quantisation_var_dn())
    return np.asarray(np.abs(excess) > _HOT_SD * max(noise, np.finfo(np.float32).tiny))


def _flags(
    found: _Found, model: FrameModel, corrections: Mapping[tuple[str, float], Correction], flux: Mapping[str, float]
) -> list[str]:
    shape = np.eye(len(found.frames)) - 1 / max(len(found.frames), 1)
    sd = np.sqrt(np.maximum(np.diag(shape @ model.covariance @ shape), 0))
    raised = {
        Flag.EXPOSURE_LABELS_OFF: bool(np.any(np.abs(model.log_scale) > np.maximum(_LABEL_OFF, 3 * sd))),
        Flag.EXPOSURE_RATIOS_DISAGREE: model.contradiction > _CONTRADICT,
        Flag.NONLINEAR: abs(model.bend) > _NONLINEAR,
        Flag.BLACK_OFFSET: any(any(correction.offset_dn) for correction in corrections.values()),
        Flag.LEAK: any(any(correction.leak_dn) for correction in corrections.values()),
        Flag.MOVED: found.moved,
        Flag.DRIFT: max(max(flux.values()), model.lamp_rel_sd) > _DRIFT,
    }
    return [flag for flag, is_raised in raised.items() if is_raised]
