"""One model of how the frames of a session hang together, solved: the equation stands in `frame_model`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.exposures import Comparison, InCommon

Array = NDArray[np.float64]

ROUNDS = 40
OUTLIER_SD = 2.0
"""Comparisons further off than this count as much as if they were so far (Huber)."""
_BEND = (0.05, 2.0)
_BLACK, _COLOUR, _FRAME = (1.0, 2.0), (0.3, 1.0), (0.3, 1.0)
"""First guess of a spread and how many values it counts for; those of black in units of the read noise."""
_SETTLED = 1e-3
"""In standard errors."""
LEAST_VAR, _MOST_VAR = 1e-12, 1.0


class Exposed(NamedTuple):
    """One exposure of one kind of frame."""

    kind: str
    label_s: float
    """As nominally set: frames of one label share its error."""
    seconds: float
    rel_sd: float
    """Of `seconds`."""
    own_error: bool = False
    """Whether `seconds` was measured for this frame alone."""


@dataclass(frozen=True)
class FrameMaps:
    """Linear maps from the parameters to what they do, each with its parameters' names."""

    names: NDArray[np.str_]
    scale: Array
    """(frames, parameters)."""
    offset: Array
    """(frames, colours, parameters)."""
    bend: Array
    """(parameters,)."""

    @property
    def flat_offset(self) -> Array:
        """`offset` as (frames colours, parameters)."""
        return self.offset.reshape(-1, len(self.names))

    def only(self, groups: Sequence[str]) -> FrameMaps:
        kept = np.isin(self.names, groups)
        return FrameMaps(self.names[kept], self.scale[:, kept], self.offset[:, :, kept], self.bend[kept])


class Pairs(NamedTuple):
    """Comparisons as arrays (m,)."""

    i: NDArray[np.int_]
    j: NDArray[np.int_]
    colour: NDArray[np.int_]
    x: Array
    y: Array
    log: Array
    """Of their ratio over that of the stated exposures."""
    var: Array
    correlation: Array | None
    """(m, m), of the errors, without the diagonal."""


class FrameSolution(NamedTuple):
    """The most probable parameters of one model."""

    maps: FrameMaps
    theta: Array
    covariance: Array
    by_noise: Array
    """Covariance of `theta` over repeated comparisons of the same frames."""
    extra_var: float
    """What the comparisons need beyond their own errors, relative."""
    evidence: float
    """Its logarithm."""

    def seen(self, by: Array) -> tuple[Array, Array]:
        """What a linear map (n, parameters) makes of them, and its covariance."""
        return by @ self.theta, by @ self.covariance @ by.T


def correlations(n: int, shared: Sequence[InCommon]) -> Array:
    """Of the errors of n comparisons, the diagonal left out."""
    found = np.zeros((n, n))
    for first, second, correlation in shared:
        found[first, second] = found[second, first] = correlation
    return found


def pairs_of(frames: Sequence[Exposed], comparisons: Sequence[Comparison], common: Array | None = None) -> Pairs:
    i, j, colour = (np.array([c[at] for c in comparisons], int) for at in range(3))
    x, y, var = (np.array([c[at] for c in comparisons], float) for at in range(5, 8))
    log_seconds = np.log([frame.seconds for frame in frames])
    return Pairs(i, j, colour, x, y, np.log(y / x) - log_seconds[j] + log_seconds[i], var, common)


def about(pairs: Pairs, offset: Array) -> Pairs:
    """The pairs with the signals about which offsets (frames, colours) are linear to second order."""
    first, second = offset[pairs.i, pairs.colour] / 2, offset[pairs.j, pairs.colour] / 2
    return pairs._replace(x=np.maximum(pairs.x - first, pairs.x / 2), y=np.maximum(pairs.y - second, pairs.y / 2))


def maps_of(frames: Sequence[Exposed], n_colours: int) -> FrameMaps:
    n = len(frames)
    labels = _numbered([(f.label_s, f.kind, at) if f.own_error else (f.label_s,) for at, f in enumerate(frames)])
    kinds = _numbered([(f.kind,) for f in frames])
    sizes = {
        "label": max(labels) + 1,
        "lamp": n,
        "drift": max(kinds) + 1,
        "black": max(kinds) + 1,
        "colour": (max(kinds) + 1) * n_colours,
        "frame": n,
        "bend": 1,
    }
    starts = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
    total = sum(sizes.values())
    scale, offset, bend = np.zeros((n, total)), np.zeros((n, n_colours, total)), np.zeros(total)
    for at in range(n):
        scale[at, [starts["label"] + labels[at], starts["lamp"] + at]] = 1
        scale[at, starts["drift"] + kinds[at]] = _place_in_kind(frames, at)
        offset[at, :, [starts["black"] + kinds[at], starts["frame"] + at]] = 1
        offset[at, range(n_colours), starts["colour"] + kinds[at] * n_colours + np.arange(n_colours)] = 1
    bend[starts["bend"]] = 1
    return FrameMaps(np.repeat(list(sizes), list(sizes.values())), scale, offset, bend)


def _place_in_kind(frames: Sequence[Exposed], at: int) -> float:
    """From -1/2 to 1/2, shortest to longest."""
    own = [i for i, f in enumerate(frames) if f.kind == frames[at].kind]
    return own.index(at) / max(len(own) - 1, 1) - 0.5


def _numbered(keys: Sequence[tuple[object, ...]]) -> list[int]:
    place: dict[tuple[object, ...], int] = {}
    return [place.setdefault(key, len(place)) for key in keys]


def first_spreads(frames: Sequence[Exposed], maps: FrameMaps, noise_dn: float) -> dict[str, Array]:
    """By group: the first guess of the spread of its parameters and how many values it counts for.

    A label's spread is its stated error, which counts for sure.
    """
    stated = maps.scale[:, maps.names == "label"].T @ np.array([f.rel_sd for f in frames])
    alike = maps.scale[:, maps.names == "label"].sum(axis=0)
    black = {"black": _BLACK, "colour": _COLOUR, "frame": _FRAME}
    return {
        "label": stated / alike,
        "bend": np.array(_BEND),
        **{name: np.array([guess * noise_dn, weight]) for name, (guess, weight) in black.items()},
    }


def solved(maps: FrameMaps, pairs: Pairs, first: dict[str, Array], span_dn: float) -> FrameSolution:
    """The most probable parameters; `first` has the spreads of labels and lamp, and the first guess of all others."""
    i, j, colour, x, y, log, var, common = pairs
    design = maps.scale[j] - maps.scale[i] + maps.offset[j, colour] / y[:, None] - maps.offset[i, colour] / x[:, None]
    design = design - maps.bend * ((y - x) / span_dn)[:, None]
    fitted = [name for name in dict.fromkeys(maps.names.tolist()) if name not in ("label", "lamp", "drift")]
    spread = {name: float(first[name][0]) for name in fitted}
    extra, trust, theta = LEAST_VAR, np.ones(len(log)), np.zeros(len(maps.names))
    for _ in range(ROUNDS):
        weight = trust / (var + extra)
        prior = np.array([spread.get(name, 0.0) for name in maps.names])
        for name in ("label", "lamp", "drift"):
            prior[maps.names == name] = first[name]
        normal = (design.T * weight) @ design
        covariance = np.asarray(np.linalg.inv(normal + np.diag(prior**-2)), float)
        before, theta = theta, covariance @ (design.T @ (weight * log))
        for name in fitted:
            guess, counts = first[name]
            own = maps.names == name
            told = float(np.sum(1 - np.diag(covariance)[own] / spread[name] ** 2))
            spread[name] = float(np.sqrt((np.sum(theta[own] ** 2) + counts * guess**2) / (max(told, 0.0) + counts)))
        left = log - design @ theta
        off = np.abs(left) / np.sqrt(var + extra)
        trust = np.minimum(1.0, OUTLIER_SD / np.maximum(off, 1e-9))
        freedom = max(float(trust.sum() - np.trace(covariance @ normal)), 1.0)
        extra = further_var(trust * left**2, var, freedom)
        if np.all((theta - before) ** 2 < _SETTLED**2 * np.diag(covariance)):
            break
    fit = float(np.sum(weight * left**2) + np.sum((theta / prior) ** 2))
    volume = float(np.linalg.slogdet(covariance)[1] - np.sum(np.log(prior**2)))
    evidence = 0.5 * (volume - fit + float(np.sum(np.log(weight))))
    by_noise = covariance @ normal @ covariance
    if common is not None:  # what comparisons share makes the steps of a chain err in opposite ways
        by_log = (covariance @ (design.T * weight)) * np.sqrt(var)
        covariance = covariance + by_log @ common @ by_log.T
    return FrameSolution(maps, theta, covariance, by_noise, extra, evidence)


def further_var(square: Array, var: Array, freedom: float) -> float:
    """What must be added to the variances for χ² to be as large as expected: the PDG's scale factor, as a sum.

    By Newton's method on 1/χ², which is concave: from below it never leaps beyond.
    """
    extra = LEAST_VAR
    for _ in range(ROUNDS):
        inverse = 1 / (var + extra)
        chi2, slope = float(np.sum(square * inverse)), float(np.sum(square * inverse**2))
        if chi2 <= freedom * (1 + _SETTLED):
            break
        extra += (chi2 / freedom - 1) * chi2 / slope
    return min(extra, _MOST_VAR)
