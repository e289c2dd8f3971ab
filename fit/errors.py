"""How well an optimum is known: covariance by source, and what contradicts it. Shapes: b problems, P parameters.

The fit answers a change d of data and priors by δ = G Xᵀ W d, G = L (Lᵀ N L)⁻¹ Lᵀ, N the normal equations with priors
and L the lift that keeps an exact R. So each independent source adds G S Gᵀ, S its own covariance of Xᵀ W d, and the
sources' shares add up to the whole.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from bssrdf.fit.laying import look
from bssrdf.fit.problem import Gaps, Looked, Plan, Problem
from bssrdf.fit.solve import Solution
from bssrdf.fit.terms import (
    elimination,
    keeping,
    model_sd,
    of_shared,
    over_data,
    rows_of,
    squares,
    system,
    totals_of,
    window,
)
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.light import Light

FIFTH, STARTS = 5, 17
"""A misfit that runs through this share of the window is one of shape; the share is laid at so many places."""

SIGNIFICANT = 4.0
"""Of its own sd: a running mean below this is scatter."""
SCATTERED = 2.0
"""Standard deviations by which runs of residuals may fall short and still be scatter: 98 % of it is below."""


class Judged(NamedTuple):
    """What is known of each problem beside its optimum."""

    sources: dict[str, Any]
    """(b, 2, 2) by source: covariance of (s, q). They add up to the whole: `noise` is what the errors state, `misfit`
    what the curves scatter beyond."""
    chi2: Any
    """(b,), reduced, by errors as they are stated and with shared ones at their best."""
    grown: Any
    """(b,): what variances grow by, χ² where it is known and above 1: those of the curves' own errors where residuals
    scatter, and all where they run, since a shape that is off puts everything in doubt."""
    errors_known: Any
    """(b,): whether all curves came with errors."""
    n: Any
    """(b,): radii in the window, a faded one in part."""
    seen: Looked
    """What the model has there."""
    pull: Any
    """(b,): R measured less that of the curve alone, in sd, which grow by the misfit; 0 where R is not a datum."""
    runs_z: Any
    """(b,): sd by which runs of one sign fall short of chance."""
    drift: Any
    """(b,): largest running mean of the relative residual over a fifth of the window, of those that are significant."""
    answer: tuple[Any, ...]
    """By slice (b, 2, u): (s, q) to a relative change of the data."""
    total_answer: Any
    """(b, 2): to one of all R."""
    used: tuple[Any, ...]
    """By slice (b, u): whether a radius counts."""


def judge(
    plan: Plan,
    model: Light,
    data: Problem,
    found: Solution,
    *,
    significant: float = SIGNIFICANT,
    n: Any = None,
) -> Judged:
    """Linear error propagation about the optimum, and tests of the residuals; on light without noise every drift is
    `significant`. `n`: how many radii (b,) there were where some stand for all."""
    at, laid, by = found.point, found.laid, found.weights
    seen = look(NUMPY, plan, model, data, laid, at)
    looks, totals = seen.curves, totals_of(NUMPY, plan, data, laid, seen, found.shared)
    rows = [rows_of(NUMPY, laid, each, k, found.shared) for k, each in enumerate(looks)]
    full = system(NUMPY, plan, data, laid, seen, totals, by, found.shared)
    keeps = keeping(plan, totals)
    answer = _answer(plan, keeps, full.matrix)
    w2 = [squares(NUMPY, plan, model, data, laid, at, each[0], k) for k, each in enumerate(looks)]
    windows = [window(NUMPY, model, c, at.log_sigma) for c in data.curves]
    used = tuple((inside > 0.5) & (mass > 0) for inside, mass in zip(windows, by.mass, strict=True))
    if n is None:
        n = sum((over_data(c.known != 0) * inside).sum(1) for c, inside in zip(data.curves, windows, strict=True))
    in_force = [each * _rescaled(each, mass) for each, mass in zip(w2, by.mass, strict=True)]
    apart = sum(_within(c.rd, w).sum(1) for c, w in zip(data.curves, in_force, strict=True))
    chi2 = (found.stated + found.ease * apart) / np.maximum(n + plan.weighed - len(plan.free), 1)
    known = reduce(np.logical_and, [c.errors_known[:, 0] for c in data.curves])
    grown = np.where(known & np.isfinite(chi2), np.maximum(chi2, 1.0), 1.0)

    sources = _by_prior(plan, answer)
    noise, allowed = 0.0, 0.0
    for c, x, force, mass, seen_k, k in zip(data.curves, rows, in_force, by.mass, looks, range(len(rows)), strict=True):
        variance = np.where(c.errors_known[..., None], 1 / np.maximum(c.known, 1e-300) ** 2, 0.0)
        unknown = np.where(c.errors_known[..., None], 0.0, force * chi2[:, None, None])
        noise = noise + _gram(x, np.where(force > 0, force**2 * variance + unknown, 0.0).sum(2))
        off = model_sd(NUMPY, plan, model, data, laid, at, seen_k[0], k)
        allowed = allowed + _gram(x, np.where(c.errors_known, mass * off, 0.0) ** 2)
    own = sources["noise"] = _seen(answer, noise)
    if not model.biased:
        of_table = _seen(answer, allowed)
        sources["table"] = sources.get("table", 0.0) + of_table
        own = own + of_table
    total_answer, pull = _by_totals(keeps, data, found, totals, full.matrix, answer, sources)
    runs_z = _runs(data, laid, looks, w2, found.shared)
    doubted = np.where((runs_z < SCATTERED)[:, None, None], own, sum(sources.values()))
    sources["misfit"] = (grown - 1)[:, None, None] * doubted
    return Judged(
        sources=sources,
        chi2=chi2,
        grown=grown,
        errors_known=known,
        n=n,
        seen=seen,
        pull=pull / np.sqrt(grown / found.ease),
        runs_z=runs_z,
        drift=_drift(laid, looks, by, found.shared, 1 / found.ease, significant),
        answer=tuple(
            np.matmul(answer[:, :2], x) * (mass * each[0])[:, None, :]
            for x, mass, each in zip(rows, by.mass, looks, strict=True)
        ),
        total_answer=total_answer[:, :2],
        used=used,
    )


def _answer(plan: Plan, keeps: tuple[Any, Any] | None, matrix: Any) -> Any:
    """G, (b, P, P)."""
    lift = elimination(NUMPY, keeps)[0] if keeps is not None else np.eye(matrix.shape[1])[None]
    alive = np.array([*plan.free, *range(3, matrix.shape[1])])
    short = lift[:, :, alive]
    down = short.swapaxes(1, 2)
    reduced = down @ (matrix @ short)
    scale = np.sqrt(np.maximum(np.diagonal(reduced, axis1=1, axis2=2), 1e-30))
    unit = reduced / scale[:, :, None] / scale[:, None, :] + 1e-13 * np.eye(alive.size)
    lost = ~np.isfinite(unit).all((1, 2))[:, None, None]
    unit = np.where(lost, np.eye(alive.size), unit)
    inverse = np.linalg.inv(unit) / scale[:, :, None] / scale[:, None, :]
    return short @ (inverse @ down)


def _by_prior(plan: Plan, answer: Any) -> dict[str, Any]:
    """Covariances by source of the shared errors, each of one sd."""
    sources: dict[str, Any] = {}
    for k, error in enumerate(plan.shared):
        moved = answer[:, :2, 3 + k]
        sources[error.source] = sources.get(error.source, 0.0) + moved[:, :, None] * moved[:, None, :]
    return sources


def _by_totals(
    keeps: tuple[Any, Any] | None,
    data: Problem,
    found: Solution,
    totals: Gaps,
    matrix: Any,
    answer: Any,
    sources: dict[str, Any],
) -> tuple[Any, Any]:
    """Adds the error of R, and gives the fit's answer to a relative change of R, and the pull of R."""
    b = found.point.q.shape[0]
    pull, total_answer = np.zeros(b), np.zeros(answer.shape[:2])
    covariance = np.zeros((b, 2, 2))
    for measured, law, gap, row, sd in zip(data.totals, found.laid.total_seen, *totals, strict=True):
        value = measured.r / law - gap
        if keeps is not None:
            shift = np.eye(row.shape[1])[1] / row[:, 1:2]
            moved = shift - np.matmul(answer, np.matmul(matrix, shift[:, :, None]))[:, :, 0]
            error = np.where(np.isfinite(sd), sd, 0.0)
        else:
            moved, error = np.matmul(answer, (row / sd**2)[:, :, None])[:, :, 0], sd
            left = gap - of_shared(row, found.shared)
            leverage = (row * np.matmul(answer, row[:, :, None])[:, :, 0]).sum(1, keepdims=True) / sd**2
            one = left / sd / np.sqrt(np.maximum(1 - leverage, 1e-6))
            pull = np.where(np.abs(one[:, 0]) > np.abs(pull), one[:, 0], pull)
        covariance = covariance + _outer(moved[:, :2] * error)
        total_answer = total_answer + moved * value
    sources["total"] = covariance
    return total_answer, pull


def _outer(moved: Any) -> Any:
    return moved[:, :, None] * moved[:, None, :]


def _seen(answer: Any, scatter: Any) -> Any:
    """G S Gᵀ in (s, q)."""
    short = answer[:, :2]
    return short @ (scatter @ short.swapaxes(1, 2))


def _gram(x: Any, weight: Any) -> Any:
    return (x * weight[:, None, :]) @ x.swapaxes(1, 2)


def _rescaled(w2: Any, mass: Any) -> Any:
    """By which the weights in force fall short of plain ones, as Huber's do."""
    whole = over_data(w2)
    return np.where(whole > 0, mass / np.where(whole > 0, whole, 1.0), 0.0)[..., None]


def _within(values: Any, w2: Any) -> Any:
    """Σ w² (value − mean)² over the data of each radius, (b, u)."""
    if w2.shape[2] == 1:
        return 0 * w2[..., 0]
    mass = w2.sum(2, keepdims=True)
    mean = (w2 * values).sum(2, keepdims=True) / (mass + (mass == 0))
    return (w2 * (values - mean) ** 2).sum(2)


def _fitted(laid: Any, look: Any, shared: Any, k: int) -> Any:
    return look[0] * (1 + (laid.responses[k] * shared[:, :, None]).sum(1))


def _runs(data: Problem, laid: Any, looks: Any, w2: Any, shared: Any) -> Any:
    """Wald–Wolfowitz of the worst slice."""
    worst = -np.inf + np.zeros(looks[0][0].shape[0])
    for k, c in enumerate(data.curves):
        b = c.rd.shape[0]
        miss = (c.rd - _fitted(laid, looks[k], shared, k)[..., None]).reshape(b, -1)
        valid = (w2[k] > 0).reshape(b, -1)
        plus = (valid & (miss > 0)).sum(1)
        minus = valid.sum(1) - plus
        count = 1 + (valid[:, 1:] & valid[:, :-1] & ((miss[:, 1:] > 0) != (miss[:, :-1] > 0))).sum(1)
        n = np.maximum(plus + minus, 2)
        expected = 1 + 2 * plus * minus / n
        variance = (expected - 1) * (expected - 2) / (n - 1)
        worst = np.maximum(worst, (expected - count) / np.sqrt(np.maximum(variance, 1e-9)))
    return worst


def _drift(laid: Any, looks: Any, by: Any, shared: Any, least: Any, significant: float) -> Any:
    """The mean over a fifth of the radii that is largest against the curve, of those beyond `significant` of their sd.
    Variances in force are enlarged by what radii scatter against the next, which no shape makes, `least` by so much."""
    largest = np.zeros(looks[0][0].shape[0])
    for k, each in enumerate(looks):
        value = np.maximum(each[0], 1e-300)
        counts = by.mass[k] > 0
        weight = by.mass[k] * value * value
        relative = np.where(counts, (by.mean[k] - _fitted(laid, each, shared, k)) / value, 0.0)
        if not counts.all():  # those that count, in order of radius
            first = np.argsort(~counts, axis=1, stable=True)
            weight = np.take_along_axis(np.where(counts, weight, 0.0), first, axis=1)
            relative = np.take_along_axis(relative, first, axis=1)
        moment = weight * relative
        apart = (relative * np.sqrt(weight))[:, 1:] - (relative * np.sqrt(weight))[:, :-1]
        pairs = np.arange(1, weight.shape[1]) < counts.sum(1, keepdims=True)
        scatter = np.where(pairs, apart * apart, 0.0).sum(1) / 2 / np.maximum(pairs.sum(1), 1)
        grown = np.maximum(least, scatter)[:, None]
        ended = np.zeros_like(weight[:, :1])  # summed inwards: light far out would be lost in sums from the beam
        beyond = [
            np.concatenate([np.cumsum(each[:, ::-1], axis=1)[:, ::-1], ended], axis=1) for each in (weight, moment)
        ]
        at = np.linspace(0, 1 - 1 / FIFTH, STARTS)
        ends = [(counts.sum(1, keepdims=True) * share + 1e-9).astype(np.int32) for share in (at, at + 1 / FIFTH)]
        mass, sums = (np.take_along_axis(s, ends[0], axis=1) - np.take_along_axis(s, ends[1], axis=1) for s in beyond)
        mass = np.maximum(mass, 1e-300)
        mean = np.abs(sums) / mass
        largest = np.maximum(largest, np.where(mean * np.sqrt(mass / grown) > significant, mean, 0.0).max(1))
    return largest
