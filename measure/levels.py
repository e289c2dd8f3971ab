"""The frames of a bracket by exposure label, repeats averaged: what calibration compares."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.measure.bracket import Bracket
from bssrdf.measure.merge import Shot, read_ahead

_DARKER_SD = 5.0
_LEAST_FLUX_PIXELS = 100


@dataclass(frozen=True)
class Level:
    """All frames of one label."""

    label_s: float
    signal: NDArray[np.float32]
    """Mean of the frames above their dark [DN]."""
    brightest: NDArray[Any]
    """Largest raw value of each pixel over the frames [DN]."""
    n_frames: int
    n_darks: int
    flux_rel_sd: float
    """Relative scatter of the light between the repeats; 0 for a single frame."""


def levels_of(bracket: Bracket, saturation_dn: float, noise_dn: float) -> Iterator[Level]:
    """The levels of a bracket, shortest first; InputError where a dark is brighter than its frame."""
    shots = bracket.shots(bracket.exposures_s())
    label = {frame.file: frame.exposure_s for frame in bracket.frames}
    for label_s, group in groupby(read_ahead(shots), key=lambda pair: label[pair[0].name]):
        signals, brightest, n_darks = [], None, 1
        for shot, sample in group:
            signal = np.subtract(sample.raw, sample.dark, dtype=np.float32)
            _check_brighter_than_dark(shot, signal, noise_dn)
            signals.append(signal)
            brightest = sample.raw if brightest is None else np.maximum(brightest, sample.raw)
            n_darks = sample.n_darks
        assert brightest is not None
        mean = np.asarray(np.mean(signals, axis=0), np.float32)
        scatter = _flux_scatter(signals, mean, brightest < saturation_dn, noise_dn)
        yield Level(label_s, mean, brightest, len(signals), n_darks, scatter)


def _check_brighter_than_dark(shot: Shot, signal: NDArray[np.float32], noise_dn: float) -> None:
    thin = max(1, signal.shape[0] // 200)
    middle = float(np.median(signal[::thin]))
    if middle < -_DARKER_SD * max(noise_dn, 0.5):
        raise InputError(
            f"{shot.name}: its dark frame is brighter than the frame, by {-middle:.4g} DN in the median; "
            "check that the two were not exchanged, and that the dark has the same exposure"
        )


def _flux_scatter(
    signals: list[NDArray[np.float32]], mean: NDArray[np.float32], good: NDArray[np.bool_], noise_dn: float
) -> float:
    """Relative standard deviation of the light of repeated frames, over the pixels that are clear of noise in all."""
    clear = good & (mean > 10 * max(noise_dn, 0.5))
    if len(signals) < 2 or clear.sum() < _LEAST_FLUX_PIXELS:
        return 0.0
    light = np.array([float(signal[clear].sum(dtype=float)) for signal in signals])
    return float(np.std(light, ddof=1) / np.mean(light))
