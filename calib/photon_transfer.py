"""Gain and read noise from the frames themselves (photon transfer). Signals in DN above the dark frame."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BINS = 20
_PER_BIN = 50
_FEWEST, _SPREAD = 5, 2.0
"""Levels of brightness, and their range, from which a power of the signal can be told."""
_CLIP_SD = 4.0
_CLIPPED_SHARE = 0.99893
"""Variance left of a normal distribution when all beyond 4 sd is cut off."""
_ENOUGH = 1_000_000
"""Pixels by which a variance is known to 0.1 %."""


class Gain(NamedTuple):
    """Electrons per DN and the relative standard deviation of that estimate."""

    e_per_dn: float
    rel_sd: float
    power: float = np.nan
    """Of the signal by which the variance rises: 1 is photon noise, 2 light that itself changes from frame to frame."""


def thinned(values: NDArray[Any]) -> NDArray[Any]:
    """Every so many of many values, all columns of a mosaic among them."""
    return values.reshape(-1)[:: values.size // _ENOUGH | 1]


def clipped_variance(x: Array) -> float:
    """Variance of `x` about 0 without its outliers; of many values, that of some."""
    x = thinned(x)
    for _ in range(3):
        x = x[np.abs(x) <= _CLIP_SD * np.sqrt(np.mean(x**2))]
    return float(np.mean(x**2)) / _CLIPPED_SHARE


def read_noise_dn(dark: NDArray[Any], other: NDArray[Any] | None) -> float:
    """Standard deviation [DN] of one sample without light, from two darks of one exposure.

    From a single dark it is that of its pixels about their median: fixed pattern counts as noise.
    """
    if other is None:
        some = thinned(dark).astype(float)
        return float(np.sqrt(clipped_variance(some - np.median(some))))
    difference = thinned(dark).astype(float) - thinned(other)
    return float(np.sqrt(clipped_variance(difference - difference.mean()) / 2))


def pair_gain(shorter: Array, longer: Array, read_var_dn: float) -> Gain | None:
    """Gain from two frames of the same scene, of the same exposure or another; None where they hold too little.

    Within pixels of like signal n = a + b, the difference b − ρa, with ρ = Σb/Σa, has the variance
    ρn/gain + (1 + ρ²) read variance. Arrays of shape (n,), unsaturated pixels only.
    """
    total = shorter + longer
    order = np.argsort(total)
    inverse_gains, weights, signals = [], [], []
    for members in np.array_split(order, min(_BINS, max(1, len(order) // _PER_BIN))):
        if len(members) < _PER_BIN:
            continue
        a, b = shorter[members], longer[members]
        if not (a.sum() > 0 and b.sum() > 0):
            continue
        rho = b.sum() / a.sum()
        shot = clipped_variance(b - rho * a) - (1 + rho**2) * read_var_dn
        scale = rho * float(np.mean(total[members]))
        inverse_gains.append(shot / scale)
        signals.append(scale)
        weights.append(len(members) / (1 + (1 + rho**2) * read_var_dn / max(shot, 1e-9)) ** 2)
    if not weights:
        return None
    inverse = float(np.average(inverse_gains, weights=weights))
    if not inverse > 0:
        return None
    return Gain(1 / inverse, float(np.sqrt(2 / np.sum(weights))), _power(np.array(signals), np.array(inverse_gains)))


def _power(signal: Array, inverse_gain: Array) -> float:
    """The power of the signal by which the variance rises; NaN where the signals are too much alike."""
    told = inverse_gain > 0
    if told.sum() < _FEWEST or signal[told].max() < _SPREAD * signal[told].min():
        return np.nan
    return float(1 + np.polyfit(np.log(signal[told]), np.log(inverse_gain[told]), 1)[0])
