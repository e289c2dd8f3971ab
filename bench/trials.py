"""`bssrdf bench trials`: does a fit find what made the light, and do its intervals hold it?

Each cell of the material table is walked by the engine (`trial_light`). A trial is that light with fresh noise, 1 % a
radius and 0.2 % on R, and with errors of scale and length drawn for the whole of it, fitted by `soft`. The walk's own
noise is counted as part of the 1 %; trials of a cell share it, or each has light of its own. What all cells come to is
bootstrapped over cells.
"""

from __future__ import annotations

import json
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.trial_light import Cell, TrialLight, batches, edges_mm, photons_for, shipped
from bssrdf.fit import FitOptions, fit_slices
from bssrdf.session.records import ChannelFit, ChannelSlice, Slice
from bssrdf.transport import shipped_table
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.light import shape_of

Floats = NDArray[np.float64]
ModelName = Literal["mc", "dipole", "auto"]
MODELS: tuple[ModelName, ...] = ("mc", "dipole", "auto")
NOISE = 0.01
TOTAL_NOISE = 0.002
LEAST_OVER_WALK = 1.2
"""A radius where the walk's own noise is not below the trial's gets this much more than the walk's."""
TRIALS = 64
SEED = 7
KEYS = ("sigma_sp", "sigma_a")


@dataclass(frozen=True)
class Outcome:
    """One cell by one model, over all trials; pairs are (σs′, σa), errors are relative."""

    cell: str
    model: ModelName
    trials: int
    light_noise: float
    median_error: tuple[float, float]
    bias: tuple[float, float]
    """Median."""
    model_error: tuple[float, float]
    """As stated, median; NaN where none was."""
    bound: tuple[float, float]
    """Cramér–Rao's, from slice and R."""
    sd: tuple[float, float]
    """Over the trials, of what `bound_of_noise` bounds."""
    bound_of_noise: tuple[float, float]
    """Cramér–Rao's for the noise that differs between trials: less the walk's own."""
    inside: tuple[int, int]
    """95 % intervals that hold the truth, of the `judged` fits."""
    judged: int
    """Fits that converged, with two-sided intervals."""
    apart_inside: tuple[int, int]
    """The same of bounds."""
    refused: int
    """Fits that were rejected or found unidentifiable."""
    width: tuple[float, float]
    """Median half width of the intervals in ln σ, over that of Cramér–Rao."""
    rms: tuple[float, float]
    """Of the errors."""
    flags: dict[str, int]
    """How often each was raised."""
    models: dict[str, int]
    """Which model each fit took."""


class Drawn(NamedTuple):
    """Relative standard deviations of the errors that a whole trial shares."""

    scale: float = 0.0
    length: float = 0.0


NOTHING = Drawn()


class _Tried(NamedTuple):
    """The trials of one cell."""

    light: TrialLight
    slices: list[Slice]
    own: bool
    """Whether each is of light of its own; `light` is then their mean with the errors of one."""


def run_trials(
    *,
    out: Path | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    lights: Sequence[TrialLight] | None = None,
    trials: int = TRIALS,
    noise: float = NOISE,
    models: Sequence[ModelName] = MODELS,
    drawn: Drawn = NOTHING,
    own_steps: float = 0.0,
) -> list[Outcome]:
    """Fit all trials of every cell by every model; with `out` also write trials.json there.

    With `own_steps` each trial has light of its own, walked for about so many collisions.
    """
    cells = []
    for at, light in enumerate(list(shipped().values()) if lights is None else lights):
        if own_steps:
            if progress is not None:
                progress(f"light of {light.cell.name}", at, len(lights or shipped()))
            cells.append(_own(light.cell, trials, noise, own_steps, SEED + at, drawn))
        else:
            cells.append(_Tried(light, slices_of(light, trials, noise, SEED + at, drawn), own=False))
    slices = [piece for each in cells for piece in each.slices]
    outcomes = []
    for number, model in enumerate(models):
        if progress is not None:
            progress(model, number, len(models))
        fits = [fit["G"] for fit in fit_slices(slices, FitOptions(model=model, constraint="soft"))]
        outcomes += [
            outcome_of(each.light, model, fits[at * trials : (at + 1) * trials], noise, drawn, own=each.own)
            for at, each in enumerate(cells)
        ]
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "trials.json").write_text(json.dumps([asdict(each) for each in outcomes], indent=1) + "\n")
    return outcomes


def _own(cell: Cell, trials: int, noise: float, steps: float, seed: int, drawn: Drawn) -> _Tried:
    lights = batches(cell, trials, photons_for(cell, steps), seed)
    typical = replace(
        lights[0],
        rd=np.mean([each.rd for each in lights], axis=0),
        total=float(np.mean([each.total for each in lights])),
    )
    seeds = np.random.SeedSequence(seed).generate_state(trials)
    slices = [slices_of(one, 1, noise, int(each), drawn, typical)[0] for one, each in zip(lights, seeds, strict=False)]
    return _Tried(typical, slices, own=True)


def table(outcomes: Sequence[Outcome]) -> str:
    """A line for each cell and model, and what they come to, as Markdown."""
    lines = [
        "| cell | model | light's noise | error σs′ / σa, median % | bound % | sd / bound | hold | refused |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for o in outcomes:
        ratio = [sd / bound for sd, bound in zip(o.sd, o.bound_of_noise, strict=True)]
        lines.append(
            f"| {o.cell} | {o.model} | {100 * o.light_noise:.2f} % "
            f"| {100 * o.median_error[0]:.2f} / {100 * o.median_error[1]:.2f} "
            f"| {100 * o.bound[0]:.2f} / {100 * o.bound[1]:.2f} | {ratio[0]:.2f} / {ratio[1]:.2f} "
            f"| {o.inside[0]} / {o.inside[1]} of {o.judged} | {o.refused or ''} |"
        )
    return "\n".join([*lines, "", *summary(outcomes)])


def summary(outcomes: Sequence[Outcome]) -> list[str]:
    """What all cells come to, a line each."""
    by_model: dict[str, list[Outcome]] = {}
    for each in outcomes:
        by_model.setdefault(each.model, []).append(each)
    lines = []
    for model, group in by_model.items():
        judged, apart = sum(o.judged for o in group), sum(o.trials - o.judged - o.refused for o in group)
        for at, name in enumerate(("σs′", "σa")):
            inside, outside = sum(o.inside[at] for o in group), sum(o.apart_inside[at] for o in group)
            ratio = np.sqrt(np.mean([(o.sd[at] / o.bound_of_noise[at]) ** 2 for o in group if o.judged]))
            width = np.median([o.width[at] for o in group if o.judged] or [np.nan])
            lo, hi = bootstrapped(group, at)
            lines.append(
                f"{model}, {name}: rms {100 * np.nanmedian([o.rms[at] for o in group]):.2f} % (median over cells), "
                f"intervals hold {inside} of {judged} ({100 * inside / max(judged, 1):.1f} %, {lo:.1f} to {hi:.1f} "
                f"over cells), {outside} of {apart} bounds; width {width:.2f} and "
                f"sd {ratio:.2f} × the bound"
            )
        lines.append(f"{model}: {sum(o.refused for o in group)} of {sum(o.trials for o in group)} refused")
    for at, name in enumerate(("σs′", "σa")):
        covered = [abs(o.bias[at]) <= o.model_error[at] + 2 * bias_sd(o, at) for o in by_model.get("dipole", [])]
        if covered:
            lines.append(f"dipole, {name}: the stated model error covers the bias in {sum(covered)} of {len(covered)}")
    if {"mc", "dipole", "auto"} <= set(by_model):
        lines.append("auto against the better model, worst cell: {:.2f} ({})".format(*_auto_at_worst(by_model)))
    return lines


def bootstrapped(group: Sequence[Outcome], at: int) -> tuple[float, float]:
    """The middle 95 % of the share of intervals that hold [%], cells drawn anew."""
    rng = np.random.default_rng(SEED)
    drawn = rng.integers(0, len(group), (2000, len(group)))
    inside = np.array([o.inside[at] for o in group], float)[drawn].sum(1)
    judged = np.array([o.judged for o in group], float)[drawn].sum(1)
    lo, hi = np.quantile(100 * inside / np.maximum(judged, 1), (0.025, 0.975))
    return float(lo), float(hi)


def bias_sd(outcome: Outcome, at: int) -> float:
    """How well the trials know the bias: over the trials, and by the walk's own noise, which all of them share."""
    drawn = outcome.bound_of_noise[at]
    walk = np.sqrt(max(outcome.bound[at] ** 2 - drawn**2, 0.0))
    return float(outcome.sd[at] * np.hypot(1 / np.sqrt(outcome.trials), walk / drawn))


def _auto_at_worst(by_model: dict[str, list[Outcome]]) -> tuple[float, str]:
    rows = zip(by_model["auto"], by_model["mc"], by_model["dipole"], strict=True)
    return max((sum(auto.rms) / min(sum(mc.rms), sum(dipole.rms)), auto.cell) for auto, mc, dipole in rows)


def slices_of(
    light: TrialLight, trials: int, noise: float, seed: int, shared: Drawn = NOTHING, typical: TrialLight | None = None
) -> list[Slice]:
    """The same light with fresh noise each time, and fresh errors of scale and length, which are stated.

    Errors are relative to the `typical` light, where that is another.
    """
    rng = np.random.default_rng(seed)
    edges, used = edges_mm(light.cell), light.used
    typical = light if typical is None else typical
    r_lo, r_hi, level = edges[:-1][used], edges[1:][used], typical.rd[used]
    stated, drawn = noise_of(typical, noise)
    pieces = []
    for _ in range(trials):
        noisy = light.rd[used] + drawn.curve * level * rng.standard_normal(level.size)
        scale, length = 1 + np.array(shared) * rng.standard_normal(2)
        lo, hi, per_mm2 = r_lo * length, r_hi * length, scale / length**2
        channel = ChannelSlice((lo + hi) / 2, per_mm2 * noisy, per_mm2 * stated.curve * level, lo, hi)
        pieces.append(
            Slice(
                channels={"G": channel},
                eta=light.cell.eta,
                g=0.0,
                flux="entering",
                exit="hemisphere",
                total_r={"G": scale * (light.total + drawn.total * typical.total * rng.standard_normal())},
                total_r_sd={"G": stated.total * typical.total},
                scale_rel_sd=shared.scale,
                mm_rel_sd=shared.length,
            )
        )
    return pieces


class Noise(NamedTuple):
    """Relative standard deviations."""

    curve: Floats
    """(n,)"""
    total: float


def noise_of(light: TrialLight, noise: float) -> tuple[Noise, Noise]:
    """What a trial's errors are, the walk's own among them, and what is left of that to draw."""
    walk = light.rd_se[light.used] / light.rd[light.used]
    walk_total = light.total_se / light.total
    stated = Noise(np.maximum(noise, LEAST_OVER_WALK * walk), max(TOTAL_NOISE, LEAST_OVER_WALK * walk_total))
    drawn = Noise(np.sqrt(stated.curve**2 - walk**2), float(np.sqrt(stated.total**2 - walk_total**2)))
    return stated, drawn


def cramer_rao(light: TrialLight, noise: Noise, shared: Drawn = NOTHING) -> tuple[float, float]:
    """Least relative sd of (σs′, σa) that any unbiased estimate can have, by the table's derivatives at the truth.

    The covariance of the data is that of the noise and, scaled by the light, of the shared errors.
    """
    cell = light.cell
    edges, model = edges_mm(cell), shipped_table(light.cell.eta, 0.0)
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(cell.sigma_a, cell.sigma_sp))
    middle = ((edges[:-1] + edges[1:]) / 2)[light.used] * np.exp(log_sigma)
    value, by_x, by_q = (each[0] for each in model.look(NUMPY, q, middle))
    by_length = 2 + by_x / value
    total, total_by_q = (float(each[0, 0]) for each in model.total(NUMPY, q))
    slopes = np.stack([np.append(by_length, 0.0), np.append(by_q / value, total_by_q / total)])
    common = np.stack([np.ones(value.size + 1), np.append(by_length, 0.0)]) * np.array(shared)[:, None]
    covariance = np.diag(np.square(np.append(noise.curve, noise.total))) + common.T @ common
    least = np.linalg.inv(slopes @ np.linalg.solve(covariance, slopes.T))
    root = float(q[0, 0])
    to_log = np.array([[1.0, -2 * root / 3 / (1 - root * root / 3)], [1.0, 2 / root]])
    sd_sp, sd_a = np.sqrt(np.diag(to_log @ least @ to_log.T))
    return float(sd_sp), float(sd_a)


def outcome_of(
    light: TrialLight,
    model: ModelName,
    fits: Sequence[ChannelFit],
    noise: float,
    shared: Drawn = NOTHING,
    *,
    own: bool = False,
) -> Outcome:
    """What the trials of a cell come to; `own`: each has light of its own, so that all noise differs between them."""
    cell, (stated, drawn) = light.cell, noise_of(light, noise)
    drawn = stated if own else drawn
    truth = (cell.sigma_sp, cell.sigma_a)
    bound = cramer_rao(light, stated, shared)
    relative = np.array([[getattr(fit, f"{key}_per_mm") for key in KEYS] for fit in fits]) / truth - 1
    model_error = np.array([[fit.model_error.get(key, np.nan) for key in KEYS] for fit in fits])
    plain = np.array([fit.status == "converged" for fit in fits])
    bounds = np.array([fit.status == "upper_bound" for fit in fits])
    inside = np.array([_holds(fit, cell) for fit in fits])
    ends = np.array([[getattr(fit, f"{key}_interval95_per_mm") for key in KEYS] for fit in fits])[plain]
    with np.errstate(divide="ignore", invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # where all fits are refused, nothing is left to average
        width = (
            np.median(np.log(ends[:, :, 1] / ends[:, :, 0]), axis=0) / (2 * 1.96) / bound if len(ends) else np.ones(2)
        )
        found = {
            "median_error": np.nanmedian(np.abs(relative), axis=0),
            "bias": np.nanmedian(relative, axis=0),
            "model_error": np.nanmedian(model_error, axis=0),
            "sd": np.nanstd(relative, axis=0, ddof=1),
            "width": width,
            "rms": np.sqrt(np.nanmean(relative**2, axis=0)),
        }
    return Outcome(
        cell=cell.name,
        model=model,
        trials=len(fits),
        light_noise=light.noise,
        bound=bound,
        bound_of_noise=cramer_rao(light, drawn, shared),
        inside=_counts(inside[plain]),
        judged=int(plain.sum()),
        apart_inside=_counts(inside[bounds]),
        refused=int((~plain & ~bounds).sum()),
        flags=dict(Counter(flag for fit in fits for flag in fit.flags)),
        models=dict(Counter(fit.model for fit in fits)),
        **{name: _pair(each) for name, each in found.items()},
    )


def _holds(fit: ChannelFit, cell: Cell) -> tuple[bool, bool]:
    """Whether the intervals hold (σs′, σa)."""
    (sp_lo, sp_hi), (a_lo, a_hi) = fit.sigma_sp_interval95_per_mm, fit.sigma_a_interval95_per_mm
    return sp_lo <= cell.sigma_sp <= sp_hi, a_lo <= cell.sigma_a <= a_hi


def _pair(values: Floats) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _counts(inside: NDArray[np.bool_]) -> tuple[int, int]:
    return int(inside[:, 0].sum()), int(inside[:, 1].sum())
