"""How the frames of a session hang together: light scale and black of each frame, and the bend of the response.

Two frames i, j of one scene show x_i and x_j DN above their darks. To first order
    ln(x_j/x_i) − ln(t_j/t_i) = s_j − s_i + o_j/x_j − o_i/x_i − b (x_j − x_i)/span,
with s the scale of a frame, the error of its label and that of the lamp together (in one frame nothing tells them
apart; a label's error is shared by all kinds of frames, the lamp's grows along the bracket, or is a frame's own), o its
black less that of its dark, and b the bend. All are Gaussian; the spreads of black and bend are the most probable ones
(MacKay 1992, Neural Computation 4, 415, eq. 4.2). Comparisons that contradict each other get a further error in common.

Whether black and bend come in, and how much the lamp varies, is not decided: all such models are averaged by their
evidence (Hoeting et al. 1999, Statistical Science 14, 382), so that no error jumps where a little more is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.exposures import Comparison, InCommon
from bssrdf.calib.frame_solution import (
    LEAST_VAR,
    OUTLIER_SD,
    ROUNDS,
    Exposed,
    FrameMaps,
    FrameSolution,
    Pairs,
    about,
    correlations,
    first_spreads,
    further_var,
    maps_of,
    pairs_of,
    solved,
)

Array = NDArray[np.float64]

_LEAK_SD = 10.0
"""Spread of what saturated neighbours add, in units of the read noise."""
_PARTS = {(): 0.0, ("black",): -8.0, ("black", "colour", "frame", "bend"): -8.0}
"""Of a model beside labels and lamp, with the logarithm of the odds that they are there before anything is seen."""
_NONE = 1e-6
_SPREADS = 5e-4 * 2.0 ** np.arange(7)
"""Of a lamp that varies, from frame to frame, relative."""
_TREND = 4.0
"""How far it drifts along a bracket over that: an ageing lamp changes its way."""


class Lamp(NamedTuple):
    """Spreads of the light within a kind of frames, relative, and the odds of them before anything is seen."""

    odds: float
    by_frame: float = _NONE
    drift: float = _NONE
    """From the first frame to the last."""


_LIKELY = 1 / (1 + (_SPREADS / 0.01) ** 2)
_GRID = tuple(zip((0.15 * _LIKELY / _LIKELY.sum()).tolist(), _SPREADS.tolist(), strict=True))
_STEADY = Lamp(0.7)
_UNSTEADY = [Lamp(odds, drift=_TREND * s) for odds, s in _GRID], [Lamp(odds, s, _TREND * s) for odds, s in _GRID]
"""Three lamps in ten vary, by any spread up to 1 %, by more the rarer; half of them drift and do nothing else."""
_NEGLIGIBLE = 1e-3
"""Share of the most probable model's weight below which another one is left out."""
_LINEARISATIONS = 2


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


def solve_frames(
    frames: Sequence[Exposed],
    comparisons: Sequence[Comparison],
    n_colours: int,
    noise_dn: float,
    span_dn: float,
    shared: Sequence[InCommon] = (),
) -> FrameModel:
    """The most probable scales, offsets and bend; frames that nothing is compared with keep their labels.

    `noise_dn` is the read noise, `shared` what comparisons have in common. Pixels beside saturated ones are
    left out; what these add to them comes last.
    """
    kept = [at for at, c in enumerate(comparisons) if not (c.first_beside or c.second_beside)]
    common = correlations(len(comparisons), shared)[np.ix_(kept, kept)]
    pairs = pairs_of(frames, [comparisons[at] for at in kept], common)
    maps = maps_of(frames, n_colours)
    found = _weighed(_every_model(maps, pairs, first_spreads(frames, maps, noise_dn), span_dn))
    return _averaged(frames, found)


def _lamp_of_kind(frames: Sequence[Exposed], solution: FrameSolution) -> Array:
    """Error of the light that all frames of a kind have in common, by frame.

    Where the lamp changed within a bracket, any of its frames may have the light of the other kind's bracket: half
    the range of what was found, of all kinds together, since two brackets cannot tell which of them it was; less what
    noise alone would feign.
    """
    lamp = np.isin(solution.maps.names, ("lamp", "drift"))
    kinds = np.array([frame.kind for frame in frames])
    same = _same_kind(frames)
    about_mean = (np.eye(len(frames)) - same / same.sum(axis=1)) @ solution.maps.scale[:, lamp]
    own = about_mean @ solution.theta[lamp]
    noise = about_mean @ solution.by_noise[np.ix_(lamp, lamp)] @ about_mean.T
    clear = np.sqrt(max(1 - np.trace(noise) / max(float(own @ own), 1e-300), 0.0))
    ranges = {kind: clear * float(np.ptp(own[kinds == kind])) for kind in set(kinds.tolist())}
    return np.array([np.sqrt(ranges[kind] * sum(ranges.values())) / 2 for kind in kinds.tolist()])


def _same_kind(frames: Sequence[Exposed]) -> Array:
    kinds = np.array([frame.kind for frame in frames])
    return np.equal.outer(kinds, kinds).astype(float)


def _weighed(solutions: Sequence[FrameSolution]) -> list[tuple[float, FrameSolution]]:
    """Each model with its share of the evidence."""
    log_odds = np.array([each.evidence for each in solutions])
    weights = np.exp(log_odds - log_odds.max())
    weights[weights < _NEGLIGIBLE] = 0
    shares = (weights / weights.sum()).tolist()
    return [(share, each) for share, each in zip(shares, solutions, strict=True) if share]


def _averaged(frames: Sequence[Exposed], models: Sequence[tuple[float, FrameSolution]]) -> FrameModel:
    """The mean of the models; what sets them apart is an error."""
    scale, scale_cov = _mixed([(share, *each.seen(each.maps.scale)) for share, each in models])
    offset, offset_cov = _mixed([(share, *each.seen(each.maps.flat_offset)) for share, each in models])
    bend, _ = _mixed([(share, *each.seen(each.maps.bend[None])) for share, each in models])
    lamp = np.sqrt(sum(share * _lamp_of_kind(frames, each) ** 2 for share, each in models))
    shape = len(frames), -1
    return FrameModel(
        scale,
        scale_cov + _same_kind(frames) * np.outer(lamp, lamp),
        offset.reshape(shape),
        np.sqrt(np.maximum(np.diag(offset_cov), 0)).reshape(shape),
        float(bend[0]),
        float(lamp.max(initial=0.0)),
        float(np.sqrt(sum(share * each.extra_var for share, each in models))),
    )


def _mixed(parts: Sequence[tuple[float, Array, Array]]) -> tuple[Array, Array]:
    """Mean and covariance of a mixture of (weight, mean, covariance)."""
    mean = np.sum([w * each for w, each, _ in parts], axis=0)
    return mean, np.sum([w * (own + np.outer(each - mean, each - mean)) for w, each, own in parts], axis=0)


def _every_model(maps: FrameMaps, pairs: Pairs, first: dict[str, Array], span_dn: float) -> list[FrameSolution]:
    """Solutions of all models whose weight counts, with the prior odds in their evidence."""
    found, likeliest = list[FrameSolution](), _STEADY
    for part, odds in _PARTS.items():
        world = _World(maps.only(("label", "lamp", "drift", *part)), pairs, first, span_dn, odds)
        if found and not _counts(world.solved(likeliest), found):
            continue  # not worth a look at every lamp
        own = [(world.solved(_STEADY), _STEADY)]
        for lamps in _UNSTEADY:
            for lamp in lamps:
                own.append((world.solved(lamp), lamp))
                if not _counts(own[-1][0], [each for each, _ in own]):
                    break
        likeliest = max(own, key=lambda each: each[0].evidence)[1]
        found += [each for each, _ in own]
    return found


def _counts(solution: FrameSolution, among: Sequence[FrameSolution]) -> bool:
    return solution.evidence > max(each.evidence for each in among) + np.log(_NEGLIGIBLE)


class _World(NamedTuple):
    """What may be true, but for how much the lamp varies."""

    maps: FrameMaps
    pairs: Pairs
    first: dict[str, Array]
    span_dn: float
    log_odds: float

    def solved(self, lamp: Lamp) -> FrameSolution:
        """With that lamp, prior odds in the evidence."""
        spreads = {**self.first, "lamp": np.array(lamp.by_frame), "drift": np.array(lamp.drift)}
        solution = solved(self.maps, self.pairs, spreads, self.span_dn)
        for _ in range(_LINEARISATIONS if "black" in self.maps.names else 0):
            near = about(self.pairs, self.maps.offset @ solution.theta)
            solution = solved(self.maps, near, spreads, self.span_dn)
        odds = self.log_odds + float(np.log(lamp.odds))
        return solution._replace(evidence=solution.evidence + odds)


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
    i, j, colour, x, y, log, var, _ = pairs_of(frames, beside)
    offset = model.offset_dn[j, colour] / y - model.offset_dn[i, colour] / x
    left = log - model.log_scale[j] + model.log_scale[i] - offset + model.bend * (y - x) / span_dn
    design = np.zeros((len(left), n_colours))
    first, second = (np.array([float(getattr(c, name)) for c in beside]) for name in ("first_beside", "second_beside"))
    design[np.arange(len(left)), colour] = second / y - first / x
    extra, trust = model.contradiction**2 + LEAST_VAR, np.ones(len(left))
    for _ in range(ROUNDS):
        weight = trust / (var + extra)
        covariance = np.linalg.inv((design.T * weight) @ design + np.eye(n_colours) / spread**2)
        leak = covariance @ (design.T @ (weight * left))
        over = left - design @ leak
        trust = np.minimum(1.0, OUTLIER_SD / np.maximum(np.abs(over) / np.sqrt(var + extra), 1e-9))
        extra = max(further_var(trust * over**2, var, max(float(trust.sum()) - n_colours, 1.0)), LEAST_VAR)
    # By the median: the faintest pixels, of whose light a leak is a large share, are farther off than the others.
    unexplained = max(float(np.median(np.abs(over))) ** 2 - float(np.median(var)), 0.0)
    share = len(beside) / len(comparisons)
    contradiction = float(np.sqrt((1 - share) * model.contradiction**2 + share * unexplained))
    return Leak(leak, np.sqrt(np.diag(covariance)), max(model.contradiction, contradiction))
