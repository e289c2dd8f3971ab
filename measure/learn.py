"""What the frames tell of their own camera: gain, read noise, saturation, hot pixels, exposure times; what moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.exposures import Exposures, Ratio, comparable, measured_ratio, solve_exposures
from bssrdf.calib.photon_transfer import Gain, clipped_variance, pair_gain, read_noise_dn
from bssrdf.calib.registration import shift_between
from bssrdf.calib.saturation import plateau_dn
from bssrdf.calib.sensor import Sensor
from bssrdf.measure.bracket import Bracket
from bssrdf.measure.levels import Level, levels_of
from bssrdf.measure.merge import Progress
from bssrdf.session.records import Camera

_MARGIN = 0.01
"""Samples this close to saturation, as a share of the range, are taken as clipped: the response bends there."""
_MAX_PIXELS = 2_000_000
"""More than this many pixels tell nothing new about a pair of exposures."""
_HOT_SD = 8.0
_CLIPPED_SHARE = 0.3
"""Share of a dark's pixels at its lowest value above which the camera clips at black."""
_GAIN_GUESS = 1.0
_MOVED_PX = 0.15
_MOVED_SD = 6.0
_LABEL_OFF = 0.01
_RATIOS_DISAGREE = 0.005
_NONLINEAR = 0.03
_DRIFT = 0.005


@dataclass(frozen=True)
class Learnt:
    """The sensor model, the exposure times and what was found on the way."""

    sensor: Sensor
    hot: NDArray[np.bool_]
    exposures: Exposures
    gain_rel_sd: float
    """NaN where the gain was given or could not be measured."""
    nonlinearity: float
    flux_rel_sd: dict[str, float]
    """Scatter of the light between repeated frames, by kind."""
    flags: tuple[str, ...]


@dataclass
class _Found:
    """What the pairs of neighbouring exposures told."""

    gains: list[Gain] = field(default_factory=list)
    ratios: list[Ratio] = field(default_factory=list)
    plateaus: list[float] = field(default_factory=list)
    moved: bool = False
    flux_rel_sd: dict[str, float] = field(default_factory=dict)


def learn_camera(brackets: Sequence[Bracket], camera: Camera, period: int, progress: Progress | None = None) -> Learnt:
    """Complete the model of `camera` from the frames of all brackets together."""
    sensor = _first_guess(brackets, camera)
    found = _compare(brackets, sensor, period, progress)
    lowest = min(found.plateaus, default=np.inf)
    if lowest < sensor.saturation_dn:
        sensor = replace(sensor, saturation_dn=lowest - _MARGIN * (lowest - sensor.black_dn))
        found = _compare(brackets, sensor, period, progress)

    flags = []
    gain = camera.gain_e_per_dn
    gain_rel_sd = np.nan
    if gain is None:
        estimate = _mean_gain(found.gains)
        gain, gain_rel_sd = estimate or Gain(_GAIN_GUESS, np.nan)
        if estimate is None:
            flags.append("gain_unknown")
    read_noise_e = camera.read_noise_e
    if read_noise_e is None:
        read_noise_e = sensor.read_noise_e / sensor.gain_e_per_dn * gain
    sensor = replace(sensor, gain_e_per_dn=gain, read_noise_e=read_noise_e)

    labels = [frame.exposure_s for bracket in brackets for frame in bracket.frames]
    exposures = solve_exposures(labels, found.ratios)
    nonlinearity = max((ratio.nonlinearity for ratio in found.ratios), default=0.0)
    flags += ["black_clipped"] if sensor.black_clipped else []
    flags += _flags(exposures, found, nonlinearity)
    return Learnt(sensor, _hot(brackets), exposures, gain_rel_sd, nonlinearity, found.flux_rel_sd, tuple(flags))


def _first_guess(brackets: Sequence[Bracket], camera: Camera) -> Sensor:
    """The sensor as the camera table and the shortest darks have it; read noise by a gain that is a guess yet."""
    shortest = max((bracket.darks[0] for bracket in brackets), key=len)[:2]
    darks = [brackets[0].read(dark) for dark in shortest]
    black = camera.black if camera.black is not None else float(np.median(darks[0]))
    white = float(camera.white if camera.white is not None else np.inf)
    saturation = white - _MARGIN * (white - black) if np.isfinite(white) else white
    gain = camera.gain_e_per_dn or _GAIN_GUESS
    noise_dn = read_noise_dn(darks[0], darks[1] if len(darks) > 1 else None)
    read_noise_e = camera.read_noise_e if camera.read_noise_e is not None else noise_dn * gain
    clipped = float(np.mean(darks[0] == darks[0].min())) > _CLIPPED_SHARE
    return Sensor(black, saturation, gain, read_noise_e, clipped)


def _compare(brackets: Sequence[Bracket], sensor: Sensor, period: int, progress: Progress | None) -> _Found:
    """Hold each level of each bracket against the one before it."""
    found = _Found()
    noise_dn = float(np.sqrt(sensor.read_var_dn()))
    for bracket in brackets:
        scatters = []
        seconds = dict(zip((f.exposure_s for f in bracket.frames), bracket.exposures_s(), strict=True))
        before = None
        for level in levels_of(bracket, sensor.saturation_dn, noise_dn):
            scatters.append(level.flux_rel_sd)
            if before is not None:
                _compare_pair(found, before, level, seconds[level.label_s] / seconds[before.label_s], sensor, period)
            before = level
            if progress:
                progress(f"compare {bracket.kind}", len(scatters), len(set(seconds)))
        found.flux_rel_sd[bracket.kind] = max(scatters)
    return found


def _compare_pair(found: _Found, before: Level, level: Level, ratio: float, sensor: Sensor, period: int) -> None:
    a, b = before.signal, level.signal
    good = (before.brightest < sensor.saturation_dn) & (level.brightest < sensor.saturation_dn)
    plateau = plateau_dn(a, level.brightest, ratio, sensor.black_dn, sensor.saturation_dn)
    if plateau is not None:
        found.plateaus.append(plateau)
    chosen = good & comparable(a, b, ratio, sensor)
    _thin_rows(chosen, period)
    shorter, longer = a[chosen].astype(float), b[chosen].astype(float)
    measured = measured_ratio(before.label_s, level.label_s, shorter, longer)
    if measured is None:
        return
    found.ratios.append(measured)
    if before.n_frames == level.n_frames == 1:
        gain = pair_gain(shorter, longer, sensor.read_var_dn() * (1 + 1 / level.n_darks))
        found.gains += [gain] if gain else []
    one = (..., 1) if a.ndim == 3 else ...
    shift = shift_between(a[one], b[one] / np.float32(np.exp(measured.log)), chosen[one], period)
    if shift and shift.length_px > max(_MOVED_PX, _MOVED_SD * shift.sd_px):
        found.moved = True


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
    return Gain(float(1 / inverse), float(np.sum(weights) ** -0.5))


def _hot(brackets: Sequence[Bracket]) -> NDArray[np.bool_]:
    """Pixels whose dark signal in the longest exposure stands far out."""
    longest = max((bracket.darks[-1][0] for bracket in brackets), key=lambda dark: dark.exposure_s)
    dark = brackets[0].read(longest).astype(np.float32)
    excess = dark - np.median(dark)
    return excess > _HOT_SD * max(np.sqrt(clipped_variance(excess.astype(float).ravel())), 0.5)


def _flags(exposures: Exposures, found: _Found, nonlinearity: float) -> list[str]:
    off = any(
        abs(seconds / label - 1) > max(_LABEL_OFF, 3 * exposures.rel_sd[label])
        for label, seconds in exposures.seconds.items()
    )
    raised = {
        "exposure_labels_off": off,
        "exposure_ratios_disagree": exposures.residual > _RATIOS_DISAGREE,
        "nonlinear": nonlinearity > _NONLINEAR,
        "moved": found.moved,
        "drift": max(found.flux_rel_sd.values()) > _DRIFT,
    }
    return [flag for flag, is_raised in raised.items() if is_raised]
