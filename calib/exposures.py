"""What two exposures of one scene tell about each other. Signals in DN above the dark frame, flat arrays (n,)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.sensor import Sensor

Array = NDArray[np.float64]

LABEL_REL_SD = 0.05
"""How far a label is trusted: EXIF times are rounded by up to 6.7 %."""
_LEAST_DN = 20.0
_LEAST_SD = 10.0
_MOST_SHARE = 0.9
_LEVELS = 4
_PER_LEVEL = 500
_MODEL_REL_SD = 1e-5


class Ratio(NamedTuple):
    """ln of the ratio of two exposure times, its variance, and how far the response bends it."""

    shorter_s: float
    longer_s: float
    log: float
    var: float
    nonlinearity: float
    """Largest relative departure of the ratio at a level of brightness from that over all."""


class Exposures(NamedTuple):
    """Exposure times by label [s], with the covariance of their logarithms."""

    labels_s: tuple[float, ...]
    seconds: dict[float, float]
    covariance: Array
    residual: float
    """Largest relative disagreement of a measured ratio with these times that its error does not explain."""

    @property
    def rel_sd(self) -> dict[float, float]:
        """Relative standard errors, the common scale left out: it cancels between sample and reference."""
        return dict(zip(self.labels_s, np.sqrt(np.maximum(np.diag(self.covariance), 0)).tolist(), strict=True))

    def of(self, label_s: float) -> float:
        """The time that frames of this label are taken to have lasted; the label itself where nothing was learnt."""
        return self.seconds.get(label_s, label_s)


def comparable(
    shorter: NDArray[np.float32], longer: NDArray[np.float32], ratio: float, sensor: Sensor
) -> NDArray[np.bool_]:
    """Pixels by which two exposures can be compared: clear of noise in the one, of saturation in the other.

    They are chosen by the sum of the two. Given the sum, the split of Poisson counts tells nothing but the ratio of
    the times, so the choice does not bias it; a choice by either value would. At the dark end read noise, equal in
    both, comes in, and the sum that has this property gives the longer exposure another weight.
    """
    span = sensor.saturation_dn - sensor.black_dn
    noise_var = 2 * sensor.read_var_dn()
    least = max(_LEAST_DN, _LEAST_SD * np.sqrt(noise_var))
    shot_var = least / sensor.gain_e_per_dn
    weight = ratio * (shot_var + noise_var) / (ratio * shot_var + noise_var)
    bright = shorter + np.float32(weight) * longer > least * (1 + weight * ratio)
    return bright & (shorter + longer < _MOST_SHARE * span * (1 + 1 / ratio))


def measured_ratio(shorter_s: float, longer_s: float, shorter: Array, longer: Array) -> Ratio | None:
    """Ratio of two exposure times from comparable pixels with its error from their scatter, None without pixels."""
    if not (shorter.sum() > 0 and longer.sum() > 0):
        return None
    ratio = float(longer.sum() / shorter.sum())
    scatter = float(np.sum((longer - ratio * shorter) ** 2))
    var = (scatter + 1) / longer.sum() ** 2 + _MODEL_REL_SD**2
    return Ratio(shorter_s, longer_s, float(np.log(ratio)), float(var), _nonlinearity(shorter, longer, ratio))


def _nonlinearity(shorter: Array, longer: Array, ratio: float) -> float:
    """Largest departure, above its noise, of the ratio at one of a few levels of brightness."""
    levels = np.array_split(np.argsort(shorter + longer), _LEVELS)
    departures = [0.0]
    for members in levels:
        if len(members) < _PER_LEVEL:
            continue
        a, b = shorter[members], longer[members]
        noise = np.std(b - ratio * a) / np.sqrt(len(members)) / b.mean()
        departure = abs(b.sum() / a.sum() / ratio - 1)
        if departure > 5 * noise:
            departures.append(float(departure))
    return max(departures)


def solve_exposures(labels_s: Sequence[float], ratios: Sequence[Ratio]) -> Exposures:
    """The most probable exposure times, from all measured ratios of a sample and its reference together.

    Each label is right to within `LABEL_REL_SD`; the ratios say the rest. What the ratios cannot tell, the common
    scale, stays that of the labels.
    """
    labels = sorted(set(labels_s))
    place = {label: i for i, label in enumerate(labels)}
    normal = np.eye(len(labels)) / LABEL_REL_SD**2
    right = np.zeros(len(labels))
    for ratio in ratios:
        step = np.zeros(len(labels))
        step[place[ratio.longer_s]], step[place[ratio.shorter_s]] = 1, -1
        normal += np.outer(step, step) / ratio.var
        right += step * _departure(ratio) / ratio.var
    log_scale = np.linalg.solve(normal, right)
    shape = np.eye(len(labels)) - 1 / max(len(labels), 1)
    residuals = [0.0]
    for ratio in ratios:
        left = _departure(ratio) - log_scale[place[ratio.longer_s]] + log_scale[place[ratio.shorter_s]]
        residuals.append(max(0.0, abs(float(left)) - 4 * float(np.sqrt(ratio.var))))
    return Exposures(
        tuple(labels),
        {label: float(label * np.exp(log_scale[i])) for label, i in place.items()},
        shape @ np.linalg.inv(normal) @ shape,
        max(residuals),
    )


def _departure(ratio: Ratio) -> float:
    return float(ratio.log - np.log(ratio.longer_s / ratio.shorter_s))
