"""How the frames of a session hang together: light scale and black of each frame, and the bend of the response.

Two frames i, j of one scene show x_i and x_j DN above their darks. To first order
    ln(x_j/x_i) − ln(t_j/t_i) = s_j − s_i + o_j/x_j − o_i/x_i − b (x_j − x_i)/span,
with s the scale of a frame, the error of its label and that of the lamp together (in one frame nothing tells them
apart; a label's error is shared by all kinds of frames, the lamp's is a frame's own), o its black less that of its
dark, and b the bend. All are Gaussian with spreads that the comparisons tell (MacKay 1992, Neural Computation 4, 415,
eq. 4.2). Lamp, offsets and bend come in one by one, as long as the comparisons bear them. Comparisons that still
contradict each other get a further error in common.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.exposures import Comparison

Array = NDArray[np.float64]

_ROUNDS = 40
_OUTLIER_SD = 2.0
"""Comparisons further off than this count as much as if they were so far (Huber)."""
_BEARS = 8.0
"""Gain of the logarithm of the evidence that a further part of the model must bring."""
_BEARS_LAMP = -3.0
"""The same of the lamp, which only widens errors: a flicker that a few comparisons tell is not left out."""
_AS_EXPECTED = 1.3
"""Up to this χ² per degree of freedom nothing is looked for."""
_LAMP, _BEND = (0.005, 6.0), (0.05, 2.0)
_BLACK, _COLOUR, _FRAME = (1.0, 2.0), (0.3, 1.0), (0.3, 1.0)
"""First guess of a spread and how many values it counts for; those of black in units of the read noise."""
_LEAK_SD = 10.0
"""Spread of what saturated neighbours add, in units of the read noise."""
_PARTS = (("lamp",), ("black",), ("black", "colour", "frame", "bend"))
_BISECTIONS = 40
_LINEARISATIONS = 2
_LEAST_VAR, _MOST_VAR = 1e-12, 1.0


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


class Exposures(NamedTuple):
    """What the frames of each kind and label stand for, and how their logarithms vary together."""

    frames: tuple[tuple[str, float], ...] = ()
    """(kind, label [s])."""
    log_scale: Array = np.zeros(0)
    """True over stated exposure and light, as a logarithm."""
    covariance: Array = np.zeros((0, 0))

    def factor(self, kind: str, label_s: float) -> float:
        """True over stated exposure and light; 1 where nothing was learnt."""
        key = (kind, label_s)
        return float(np.exp(self.log_scale[self.frames.index(key)])) if key in self.frames else 1.0

    @property
    def rel_sd(self) -> Array:
        """Relative standard errors, the common scale left out: it cancels between sample and reference."""
        shape = np.eye(len(self.frames)) - 1 / max(len(self.frames), 1)
        return np.sqrt(np.maximum(np.diag(shape @ self.covariance @ shape), 0))


@dataclass(frozen=True)
class FrameModel:
    """What the comparisons tell of n frames."""

    log_scale: Array
    """True over stated exposure and light, as a logarithm, (n,)."""
    covariance: Array
    """Of `log_scale`, (n, n), errors that all frames share included."""
    offset_dn: Array
    """Black of a frame less that of its dark, (n, colours)."""
    offset_sd_dn: Array
    bend: float
    """How much more the straight signal is than the shown one, relative, at the end of the range."""
    lamp_rel_sd: float
    """Half the range of the light within a kind of frames; 0 where the labels explain everything."""
    contradiction: float
    """Relative error that the comparisons need beyond their own."""


@dataclass(frozen=True)
class _Maps:
    """Linear maps from the parameters to what they do, each with its parameters' names."""

    names: NDArray[np.str_]
    scale: Array
    """(frames, parameters)."""
    offset: Array
    """(frames, colours, parameters)."""
    bend: Array
    """(parameters,)."""

    def only(self, groups: Sequence[str]) -> _Maps:
        kept = np.isin(self.names, groups)
        return _Maps(self.names[kept], self.scale[:, kept], self.offset[:, :, kept], self.bend[kept])


class _Pairs(NamedTuple):
    """Comparisons as arrays (m,)."""

    i: NDArray[np.int_]
    j: NDArray[np.int_]
    colour: NDArray[np.int_]
    x: Array
    y: Array
    log: Array
    """Of their ratio over that of the stated exposures."""
    var: Array


class _Solution(NamedTuple):
    theta: Array
    covariance: Array
    spread: dict[str, float]
    extra_var: float
    evidence: float
    chi2: float
    """Per degree of freedom, without the further error."""


def solve_frames(
    frames: Sequence[Exposed], comparisons: Sequence[Comparison], n_colours: int, noise_dn: float, span_dn: float
) -> FrameModel:
    """The most probable scales, offsets and bend; frames that nothing is compared with keep their labels.

    `noise_dn` is the read noise. Pixels beside saturated ones are left out; what these add to them comes last.
    """
    pairs = _pairs(frames, [c for c in comparisons if not (c.first_beside or c.second_beside)])
    every = _maps(frames, n_colours)
    first = _first_spreads(frames, every, noise_dn)
    solution, maps = _simplest(every, pairs, first, span_dn)
    for _ in range(_LINEARISATIONS if "black" in maps.names else 0):
        solution = _solved(maps, _about(pairs, maps.offset @ solution.theta), first, span_dn)
    lamp = _lamp_of_kind(frames, maps, solution)
    offset_var = np.einsum("ncp,pq,ncq->nc", maps.offset, solution.covariance, maps.offset)
    return FrameModel(
        maps.scale @ solution.theta,
        maps.scale @ solution.covariance @ maps.scale.T + _same_kind(frames) * np.outer(lamp, lamp),
        maps.offset @ solution.theta,
        np.sqrt(np.maximum(offset_var, 0)),
        float(maps.bend @ solution.theta),
        float(lamp.max(initial=0.0)),
        float(np.sqrt(solution.extra_var)),
    )


def _lamp_of_kind(frames: Sequence[Exposed], maps: _Maps, solution: _Solution) -> Array:
    """Error of the light that all frames of a kind have in common, by frame.

    Where the lamp changed within a bracket, any of its frames may have the light of the other kind's bracket: half
    the range of what was found. If one lamp of two changed, each of them gets half of it, whence the root of two.
    """
    lamp = maps.names == "lamp"
    own = maps.scale[:, lamp] @ solution.theta[lamp]
    kinds = np.array([frame.kind for frame in frames])
    return np.array([np.ptp(own[kinds == kind]) / np.sqrt(2) for kind in kinds])


def _same_kind(frames: Sequence[Exposed]) -> Array:
    kinds = np.array([frame.kind for frame in frames])
    return np.equal.outer(kinds, kinds).astype(float)


def _pairs(frames: Sequence[Exposed], comparisons: Sequence[Comparison]) -> _Pairs:
    i, j, colour = (np.array([c[at] for c in comparisons], int) for at in range(3))
    x, y, var = (np.array([c[at] for c in comparisons], float) for at in range(5, 8))
    log_seconds = np.log([frame.seconds for frame in frames])
    return _Pairs(i, j, colour, x, y, np.log(y / x) - log_seconds[j] + log_seconds[i], var)


def _about(pairs: _Pairs, offset: Array) -> _Pairs:
    """The pairs with the signals about which offsets (frames, colours) are linear to second order."""
    first, second = offset[pairs.i, pairs.colour] / 2, offset[pairs.j, pairs.colour] / 2
    return pairs._replace(x=np.maximum(pairs.x - first, pairs.x / 2), y=np.maximum(pairs.y - second, pairs.y / 2))


def _maps(frames: Sequence[Exposed], n_colours: int) -> _Maps:
    n = len(frames)
    labels = _numbered([(f.label_s, f.kind, at) if f.own_error else (f.label_s,) for at, f in enumerate(frames)])
    kinds = _numbered([(f.kind,) for f in frames])
    sizes = {
        "label": max(labels) + 1,
        "lamp": n,
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
        offset[at, :, [starts["black"] + kinds[at], starts["frame"] + at]] = 1
        offset[at, range(n_colours), starts["colour"] + kinds[at] * n_colours + np.arange(n_colours)] = 1
    bend[starts["bend"]] = 1
    return _Maps(np.repeat(list(sizes), list(sizes.values())), scale, offset, bend)


def _numbered(keys: Sequence[tuple[object, ...]]) -> list[int]:
    place: dict[tuple[object, ...], int] = {}
    return [place.setdefault(key, len(place)) for key in keys]


def _first_spreads(frames: Sequence[Exposed], maps: _Maps, noise_dn: float) -> dict[str, Array]:
    """By group: the first guess of the spread of its parameters and how many values it counts for.

    A label's spread is its stated error, which counts for sure.
    """
    stated = maps.scale[:, maps.names == "label"].T @ np.array([f.rel_sd for f in frames])
    alike = maps.scale[:, maps.names == "label"].sum(axis=0)
    black = {"black": _BLACK, "colour": _COLOUR, "frame": _FRAME}
    return {
        "label": stated / alike,
        "lamp": np.array(_LAMP),
        "bend": np.array(_BEND),
        **{name: np.array([guess * noise_dn, weight]) for name, (guess, weight) in black.items()},
    }


def _simplest(maps: _Maps, pairs: _Pairs, first: dict[str, Array], span_dn: float) -> tuple[_Solution, _Maps]:
    """The simplest model that the comparisons bear: part by part, the most telling first."""
    groups: tuple[str, ...] = ("label",)
    chosen = maps.only(groups)
    best = _solved(chosen, pairs, first, span_dn)
    left = list(_PARTS)
    while left and best.chi2 > _AS_EXPECTED:
        tried = [(part, maps.only((*groups, *part))) for part in left]
        solutions = [(_solved(candidate, pairs, first, span_dn), part, candidate) for part, candidate in tried]
        solution, part, candidate = max(solutions, key=lambda each: each[0].evidence)
        least = _BEARS_LAMP if part == ("lamp",) else _BEARS
        if solution.evidence < best.evidence + least:
            break
        best, chosen, groups = solution, candidate, (*groups, *part)
        left.remove(part)
    return best, chosen


def _solved(maps: _Maps, pairs: _Pairs, first: dict[str, Array], span_dn: float) -> _Solution:
    i, j, colour, x, y, log, var = pairs
    design = maps.scale[j] - maps.scale[i] + maps.offset[j, colour] / y[:, None] - maps.offset[i, colour] / x[:, None]
    design = design - maps.bend * ((y - x) / span_dn)[:, None]
    fitted = [name for name in dict.fromkeys(maps.names.tolist()) if name != "label"]
    spread = {name: float(first[name][0]) for name in fitted}
    extra, trust = _LEAST_VAR, np.ones(len(log))
    for _ in range(_ROUNDS):
        weight = trust / (var + extra)
        prior = np.array([spread.get(name, 0.0) for name in maps.names]) if fitted else np.zeros(len(maps.names))
        prior[maps.names == "label"] = first["label"]
        normal = (design.T * weight) @ design
        covariance = np.linalg.inv(normal + np.diag(prior**-2))
        theta = covariance @ (design.T @ (weight * log))
        for name in fitted:
            guess, counts = first[name]
            own = maps.names == name
            told = float(np.sum(1 - np.diag(covariance)[own] / spread[name] ** 2))
            spread[name] = float(np.sqrt((np.sum(theta[own] ** 2) + counts * guess**2) / (max(told, 0.0) + counts)))
        left = log - design @ theta
        off = np.abs(left) / np.sqrt(var + extra)
        trust = np.minimum(1.0, _OUTLIER_SD / np.maximum(off, 1e-9))
        freedom = max(float(trust.sum() - np.trace(covariance @ normal)), 1.0)
        extra = _further_var(trust * left**2, var, freedom)
    fit = float(np.sum(weight * left**2) + np.sum((theta / prior) ** 2))
    volume = float(np.linalg.slogdet(covariance)[1] - np.sum(np.log(prior**2)))
    evidence = 0.5 * (volume - fit + float(np.sum(np.log(weight))))
    return _Solution(
        theta, np.asarray(covariance, float), spread, extra, evidence, float(np.sum(trust * left**2 / var)) / freedom
    )


def _further_var(square: Array, var: Array, freedom: float) -> float:
    """What must be added to the variances for χ² to be as large as expected: the PDG's scale factor, as a sum."""
    if np.sum(square / (var + _LEAST_VAR)) <= freedom:
        return _LEAST_VAR
    low, high = _LEAST_VAR, _MOST_VAR
    for _ in range(_BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if np.sum(square / (var + middle)) > freedom else (low, middle)
    return low


class Leak(NamedTuple):
    """What pixels beside saturated ones get more, by colour, and how well that explains them."""

    dn: Array
    sd_dn: Array
    contradiction: float
    """Relative error of a sample, those beside saturated ones with what one leak for all does not explain."""


def leak_of(
    model: FrameModel, frames: Sequence[Exposed], comparisons: Sequence[Comparison], noise_dn: float, span_dn: float
) -> Leak:
    """The leak from what `model` leaves of the pixels beside saturated ones."""
    beside = [c for c in comparisons if c.first_beside or c.second_beside]
    n_colours = model.offset_dn.shape[1]
    spread = _LEAK_SD * noise_dn
    if not beside:
        return Leak(np.zeros(n_colours), np.full(n_colours, spread), model.contradiction)
    i, j, colour, x, y, log, var = _pairs(frames, beside)
    offset = model.offset_dn[j, colour] / y - model.offset_dn[i, colour] / x
    left = log - model.log_scale[j] + model.log_scale[i] - offset + model.bend * (y - x) / span_dn
    design = np.zeros((len(left), n_colours))
    first, second = (np.array([float(getattr(c, name)) for c in beside]) for name in ("first_beside", "second_beside"))
    design[np.arange(len(left)), colour] = second / y - first / x
    extra, trust = model.contradiction**2 + _LEAST_VAR, np.ones(len(left))
    for _ in range(_ROUNDS):
        weight = trust / (var + extra)
        covariance = np.linalg.inv((design.T * weight) @ design + np.eye(n_colours) / spread**2)
        leak = covariance @ (design.T @ (weight * left))
        over = left - design @ leak
        trust = np.minimum(1.0, _OUTLIER_SD / np.maximum(np.abs(over) / np.sqrt(var + extra), 1e-9))
        extra = max(_further_var(trust * over**2, var, max(float(trust.sum()) - n_colours, 1.0)), _LEAST_VAR)
    # By the median: the faintest pixels, of whose light a leak is a large share, are farther off than the others.
    unexplained = max(float(np.median(np.abs(over))) ** 2 - float(np.median(var)), 0.0)
    share = len(beside) / len(comparisons)
    contradiction = float(np.sqrt((1 - share) * model.contradiction**2 + share * unexplained))
    return Leak(leak, np.sqrt(np.diag(covariance)), max(model.contradiction, contradiction))
