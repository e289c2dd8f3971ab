"""The frames of a bracket by exposure label, repeats averaged as they come: what calibration compares."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import BEND_PIVOT, Gain, Sensor, by_row, least_signal, pair_gain, rows_of
from bssrdf.errors import InputError
from bssrdf.measure.bracket import Bracket
from bssrdf.measure.hdr import DarkPaired, Shot, read_ahead

_DARKER_SD = 5.0
_BELOW_SD, _MOST_BELOW = 20.0, 0.01
"""Noises below the dark, and share of the pixels, that no noise and no hot pixels explain."""
_LEAST_FLUX_PIXELS = 100
_MOST_GAIN_PIXELS = 500_000
_STRIP_ROWS = 16
_DARKEST, _SOME = 0.01, 100_000
"""Share of a frame's pixels that are its darkest, and pixels that tell it."""
_SPOT_PIXELS, _MOST_PIXELS = 1_000_000, 2_000_000
"""Of a large frame the rows of the beam's spot are compared, and strips of others: more tell nothing new."""


@dataclass
class Level:
    """All frames of one label; complete once the next one is asked for."""

    label_s: float
    files: list[str]
    signal: NDArray[np.float32]
    """Mean of the frames above their dark [DN]."""
    floor_dn: float
    """What the darkest pixels show above their dark, of the first frame."""
    brightest: NDArray[Any]
    """Largest raw value of each pixel over the frames [DN]."""
    n_darks: int
    rows: NDArray[np.int_]
    """Of the frame, that are compared."""
    light: list[float] = field(default_factory=list)
    """Of each frame [DN], over the same pixels, clear of noise and of saturation."""
    n_light: int = 0
    """Pixels in that sum."""
    gain: Gain | None = None
    """From the first two frames."""

    @property
    def n_frames(self) -> int:
        return len(self.files)

    def unsaturated(self, sensor: Sensor) -> NDArray[np.bool_]:
        """Pixels that no frame of this label saturates."""
        return sensor.unsaturated(self.brightest)

    def flux_rel_sd(self, sensor: Sensor) -> float:
        """Relative scatter of the light between the frames beyond that of photons and read noise; 0 if none is sure."""
        if self.n_frames < 2 or self.n_light < _LEAST_FLUX_PIXELS:
            return 0.0
        mean = float(np.mean(self.light))
        scatter = float(np.var(self.light, ddof=1)) / mean**2
        noise = (max(mean, 0.0) / sensor.gain_e_per_dn + self.n_light * sensor.read_var_dn()) / mean**2
        chance = 1 + 3 * np.sqrt(2 / (self.n_frames - 1))
        return float(np.sqrt(scatter - noise)) if scatter > chance**2 * noise else 0.0


def beside(saturated: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels that are saturated or next to one that is, in any channel: charge and read-out carry over."""
    flat = saturated.any(axis=2) if saturated.ndim == 3 else saturated
    pixels: Any = flat.astype(np.uint8)
    near = np.asarray(cv2.dilate(pixels, np.ones((3, 3), np.uint8))) > 0
    return np.broadcast_to(near[..., None], saturated.shape) if saturated.ndim == 3 else near


def levels_of(bracket: Bracket, sensor: Sensor) -> Iterator[Level]:
    """The levels of a bracket, shortest first; InputError where a dark is brighter than its frame."""
    shots = bracket.shots(bracket.exposures_s())
    label = {frame.file: frame.exposure_s for frame in bracket.frames}
    rows: Any = None
    for label_s, group in groupby(read_ahead(shots), key=lambda pair: label[pair[0].name]):
        level, clear = None, None
        for shot, whole in group:
            rows = telling_rows(whole) if rows is None else rows
            sample = whole._replace(raw=whole.raw[rows], dark=whole.dark[rows])
            signal = np.subtract(sample.raw, sample.dark, dtype=np.float32)
            some = signal.reshape(-1)[:: signal.size // _SOME | 1]  # all columns of a mosaic among them
            floor, middle = np.nanquantile(some, (_DARKEST, 0.5)).tolist()
            _check_brighter_than_dark(shot, some, middle, float(np.sqrt(sensor.read_var_dn())))
            if level is None or clear is None:
                level = Level(label_s, [], signal, floor, sample.raw, sample.n_darks, np.arange(len(whole.raw))[rows])
                clear = sensor.unsaturated(sample.raw) & (signal > least_signal(sensor))
                level.n_light = int(np.count_nonzero(clear))
            else:
                _add(level, signal, sample, sensor)
            level.files.append(shot.name)
            level.light.append(float(np.nansum(signal[clear], dtype=float)))
        assert level is not None
        yield level


def telling_rows(sample: DarkPaired) -> Any:
    """The rows of a bracket's shortest frame by which its frames are compared, in pairs as a mosaic has them."""
    height, pixels_a_row = len(sample.raw), sample.raw[0].size
    if sample.raw.size <= _SPOT_PIXELS + _MOST_PIXELS:
        return slice(None)
    of_a_row = tuple(range(1, sample.raw.ndim))
    raw = sample.raw if sample.raw.dtype.kind != "f" else np.nan_to_num(sample.raw, posinf=0.0)
    light = raw.sum(axis=of_a_row, dtype=float) - sample.dark.sum(axis=of_a_row, dtype=float)
    beam = int(np.argmax(np.convolve(light, np.ones(_STRIP_ROWS), "same")))
    every = -(-height * pixels_a_row // _MOST_PIXELS)
    strips = np.arange(height) // _STRIP_ROWS
    telling = (strips % every == 0) | (
        np.abs(strips - beam // _STRIP_ROWS) * _STRIP_ROWS * pixels_a_row < _SPOT_PIXELS // 2
    )
    return np.flatnonzero(telling)


def _add(level: Level, signal: NDArray[np.float32], sample: DarkPaired, sensor: Sensor) -> None:
    """One more frame of the label."""
    if level.n_frames == 1:
        level.gain = _gain_of_two(level, signal, sensor.unsaturated(np.maximum(level.brightest, sample.raw)), sensor)
    level.signal = level.signal + (signal - level.signal) / np.float32(level.n_frames + 1)
    level.brightest = np.maximum(level.brightest, sample.raw)


def _gain_of_two(level: Level, other: NDArray[np.float32], good: NDArray[np.bool_], sensor: Sensor) -> Gain | None:
    """From frames of one exposure and one dark: their difference has neither scene nor dark in it."""
    chosen = np.flatnonzero(good & (level.signal + other > 2 * least_signal(sensor)))
    chosen = chosen[:: max(1, chosen.size // _MOST_GAIN_PIXELS)]
    first, second = (plane.reshape(-1)[chosen].astype(float) for plane in (level.signal, other))
    return pair_gain(first, second, sensor.read_var_dn()) if chosen.size else None


def _check_brighter_than_dark(shot: Shot, some: NDArray[np.float32], middle: float, noise_dn: float) -> None:
    """InputError where pixels above their dark, or their median `middle`, lie far below it."""
    below = float(np.mean(some < -_BELOW_SD * noise_dn))
    if below > _MOST_BELOW and middle > -_DARKER_SD * noise_dn:
        raise InputError(
            f"{shot.name}: {100 * below:.2g} % of its pixels lie far below its dark; take it again (was the file cut?)"
        )
    if middle < -_DARKER_SD * noise_dn - np.spacing(noise_dn):
        raise InputError(
            f"{shot.name}: its dark frame is brighter than the frame, by {-middle:.4g} DN in the median; "
            "check that the two were not exchanged, and that the dark has the same exposure"
        )


@dataclass(frozen=True)
class Correction:
    """What a frame's dark does not take away, by place in a cell of the mosaic or by channel."""

    offset_dn: tuple[float, ...]
    """Black that moved between the frame and its dark."""
    leak_dn: tuple[float, ...]
    """What pixels beside saturated ones get more."""
    sensor: Sensor | None = None

    def __call__(self, sample: DarkPaired) -> DarkPaired:
        """The frame with its dark put right."""
        dark: NDArray[np.float32] = by_row(np.add, sample.dark, rows_of(self.offset_dn, sample.raw.shape))
        if self.sensor and any(self.leak_dn):
            leak = by_row(np.add, np.zeros(dark.shape, np.float32), rows_of(self.leak_dn, dark.shape))
            dark += leak * beside(~self.sensor.unsaturated(sample.raw))
        return sample._replace(dark=dark)


def straight(sample: DarkPaired, sensor: Sensor) -> NDArray[np.float32]:
    """Light above the dark [DN] of a response whose bend is taken out, as the merge counts it."""
    shown = np.subtract(sample.raw, sample.dark, dtype=np.float32)
    pivot = np.float32(BEND_PIVOT * sensor.span_dn()) if sensor.bend else np.float32(0)
    return np.asarray(shown + np.float32(sensor.bend_per_dn()) * shown * (shown - pivot))


def plain_corrections(corrections: Mapping[tuple[str, float], Correction]) -> dict[str, Any]:
    """By kind and label, for provenance."""
    return {
        f"{kind} {label:g}": {"offset_dn": list(each.offset_dn), "leak_dn": list(each.leak_dn)}
        for (kind, label), each in corrections.items()
    }


def corrections_of(
    provenance: Mapping[str, Any], kind: str, labels_s: Sequence[float], sensor: Sensor
) -> dict[tuple[str, float], Correction]:
    """The corrections that a merge went by, from its provenance."""
    told = provenance.get("corrections", {})
    named = {label: told.get(f"{kind} {label:g}") for label in labels_s}
    return {
        (kind, label): Correction(tuple(each["offset_dn"]), tuple(each["leak_dn"]), sensor)
        for label, each in named.items()
        if each
    }
