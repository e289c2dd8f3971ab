"""The objective: a sum of terms over named parameters, and errors that data share, which are parameters with priors.

A term gives its value, its slopes by s = ln σt′, q and c = ln of an unknown factor, and its response to each shared
error, as `laying` has them. No term knows what else is in the sum. Shapes as in `problem`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bssrdf.fit.laying import TINY
from bssrdf.fit.layout import Curves
from bssrdf.fit.problem import Gaps, Laid, Looked, Plan, Point, Problem, System, Weights
from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import Light
from bssrdf.transport.light_errors import exit_rel_sd
from bssrdf.transport.observed import middles
from bssrdf.transport.q_root import q_of_total
from bssrdf.transport.sample_light import curve_off, q_of_sample, total_off

HUBER = 1.345
"""Standard deviations from which on a residual counts linearly: 95 % efficient on normal noise (Huber 1981)."""
FADE = 0.1
"""In ln r: over this a radius passes out of a window that hangs on the fit itself, so that no result jumps there."""


def totals_of(e: Engine, plan: Plan, data: Problem, laid: Laid, seen: Looked, shared: Any) -> Gaps:
    """R measured against that of the model, with its slopes at shared errors of that size."""
    xp = e.xp
    gaps, rows, sds = [], [], []
    for k, each, law, (value, by_s, by_q), response in zip(
        plan.totals, data.totals, laid.total_seen, seen.totals, laid.total_responses, strict=False
    ):
        gaps.append(each.r / law - value)
        lifted = 1 + (response * shared).sum(1, keepdims=True)
        rows.append(xp.concatenate([by_s * lifted, by_q * lifted, xp.zeros_like(value), value * response], axis=1))
        sds.append(xp.hypot(each.sd, total_off(laid.samples[k]) * each.r) if laid.samples[k] else each.sd)
    return Gaps(tuple(gaps), tuple(rows), tuple(sds))


def keeping(plan: Plan, totals: Gaps) -> tuple[Any, Any] | None:
    """Where R is a condition: (b, P) what q falls by as each other parameter grows, and (b, 1) what it lacks."""
    if not plan.exact:
        return None
    (gap,), (row,), _ = totals
    return row / row[:, 1:2], gap / row[:, 1:2]


def holding_sigma_a(e: Engine, full: System, at: Point) -> tuple[Any, Any]:
    """The same where σa = σt′ q²/3 is held, and the point is on it."""
    nothing = e.xp.zeros_like(full.gradient[:, 2:])
    return e.xp.concatenate([at.q / 2, e.xp.ones_like(at.q), nothing], axis=1), e.xp.zeros_like(at.q)


def elimination(e: Engine, keeps: tuple[Any, Any]) -> tuple[Any, Any]:
    """(b, P, P) that lifts a move of all other parameters to one that keeps R, and the (b, P) move that meets R."""
    xp = e.xp
    falls, missing = keeps
    eye = np.eye(falls.shape[1])
    unit = xp.asarray(eye[1])
    return xp.asarray(eye) - unit[None, :, None] * falls[:, None, :], unit[None, :] * missing


def meeting(e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point) -> Point:
    """The point, where R is a condition with the q that meets it."""
    if not plan.exact:
        return at
    seen = data.totals[0].r / laid.total_seen[0]
    kind, least = plan.sights[plan.totals[0]].held, e.xp.minimum(seen, 1.0)
    if kind == "half":
        q = q_of_total(e, model, least)
    else:
        q = q_of_sample(e, model, kind == "dish", data.samples[plan.totals[0]], at.log_sigma, least)
    return at._replace(q=e.xp.where(seen < 1, q, at.q))


def weigh(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, seen: Looked, shared: Any
) -> Weights:
    """Window and weights about the model's curve and not about the data; `shared`: fitted shared errors."""
    xp = e.xp
    masses, means = [], []
    for k, c in enumerate(data.curves):
        value = seen.curves[k][0]
        w2 = squares(e, plan, model, data, laid, at, value, k)
        if plan.robust:
            w2 = w2 * _huber(e, c, w2, value * (1 + answer_of(e, laid.responses[k], shared)))
        mass = over_data(w2)
        masses.append(mass)
        means.append(over_data(w2 * c.rd) / xp.where(mass > 0, mass, 1.0))
    return Weights(tuple(masses), tuple(means))


def over_data(each: Any) -> Any:
    """The sum over the few data of a radius, (b, u): faster than that of an array library over so short an axis."""
    return sum(each[..., k] for k in range(1, each.shape[-1])) + each[..., 0]


def answer_of(e: Engine, responses: Any, shared: Any) -> Any:
    """What shared errors of this size do to ln of a curve, (b, u)."""
    return e.xp.matmul(shared[:, None, :], responses)[:, 0]


def squares(e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, value: Any, k: int) -> Any:
    """w² of each datum (b, u, m): 1/(sd² + what the model may be off by²), or 1/value² where no error is known."""
    xp = e.xp
    c = data.curves[k]
    value = xp.maximum(value, TINY**0.25)
    allowed = xp.square(model_sd(e, plan, model, data, laid, at, value, k))[..., None]
    known2 = c.known * c.known
    relative = (known2 != 0) / xp.square(value)[..., None]
    w2 = xp.where(c.errors_known[..., None], known2 / (1 + known2 * allowed), relative)
    return window(e, model, c, at.log_sigma)[..., None] * w2


def model_sd(e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, value: Any, k: int) -> Any:
    """What the model may be off by at each radius for itself."""
    relative: Any = model.relative_error
    if laid.samples[k]:
        relative = e.xp.hypot(relative, 2 * curve_off(laid.samples[k]))
    if plan.sights[k].camera:
        c = data.curves[k]
        relative = e.xp.hypot(relative, exit_rel_sd(e, model, middles(e, c, at.log_sigma), c.arc))
    return value * relative


def window(e: Engine, model: Light, c: Curves, log_sigma: Any) -> Any:
    """1 within the caller's window and the model's, which fades out, else 0."""
    xp = e.xp
    log_x = c.log_r + log_sigma
    lo, hi = model.window_mfp
    inside = c.within * xp.clip((np.log(hi) - log_x) / FADE + 0.5, 0, 1)
    return inside * xp.clip((log_x - np.log(lo)) / FADE + 0.5, 0, 1) if lo > 0 else inside


def _huber(e: Engine, c: Curves, w2: Any, fitted: Any) -> Any:
    xp = e.xp
    distance = xp.abs(c.rd - fitted[..., None]) * xp.sqrt(w2)
    b = distance.shape[0]
    ordered = xp.sort(xp.where(w2 > 0, distance, np.inf).reshape(b, -1), axis=1)
    middle = xp.clip((w2 > 0).reshape(b, -1).sum(1) // 2, 0, ordered.shape[1] - 1)
    median = xp.take_along_axis(ordered, middle[:, None], axis=1)
    scatter = xp.where(c.errors_known, 1.0, median / 0.6745)[..., None]
    return xp.minimum(1.0, HUBER * scatter / xp.maximum(distance, 1e-12))


def system(
    e: Engine, plan: Plan, data: Problem, laid: Laid, seen: Looked, totals: Gaps, by: Weights, shared: Any
) -> System:
    """The sum over curves, soft totals and priors, at a point and at shared errors of that size."""
    xp = e.xp
    whole: Any = 0.0
    for k, each in enumerate(seen.curves):
        root = xp.sqrt(by.mass[k])
        rows = rows_of(e, laid, tuple(root * part for part in each), k, shared, root * by.mean[k])
        whole = whole + xp.matmul(rows, xp.swapaxes(rows, 1, 2))
    for gap, row, sd in list(zip(*totals, strict=True))[: plan.weighed]:
        one = xp.concatenate([row, gap - of_shared(row, shared)], axis=1) / sd
        whole = whole + one[:, :, None] * one[:, None, :]
    size = 3 + len(plan.shared)
    pulled = xp.concatenate([xp.zeros((shared.shape[0], 3)), shared], axis=1)
    return System(
        whole[:, size, size] + xp.square(shared).sum(1),
        whole[:, :size, size] - pulled,
        whole[:, :size, :size] + prior(e, plan),
    )


def of_shared(row: Any, shared: Any) -> Any:
    """What shared errors of this size add where the slopes are `row` (b, P), (b, 1)."""
    return (row[:, 3:] * shared).sum(1, keepdims=True)


def cost_at(e: Engine, plan: Plan, data: Problem, laid: Laid, seen: Looked, by: Weights, shared: Any) -> Any:
    """The objective (b,) with shared errors at their best, near those given; where R is exact, at the q near by that
    meets it."""
    xp = e.xp
    gaps, rows, sds = totals = totals_of(e, plan, data, laid, seen, shared)
    keeps = keeping(plan, totals)
    whole: Any = 0.0
    for k, (value, _, by_q) in enumerate(seen.curves):
        parts = [*(value * each for each in _by_error(laid.responses[k])), by.mean[k] - value]
        if keeps is not None:
            away = xp.concatenate([keeps[0][:, 3:], keeps[1]], axis=1)
            by_q = by_q * (1 + answer_of(e, laid.responses[k], shared))
            parts = [part - by_q * away[:, j : j + 1] for j, part in enumerate(parts)]
        stacked = xp.stack(parts, axis=1) * xp.sqrt(by.mass[k])[:, None, :]
        whole = whole + xp.matmul(stacked, xp.swapaxes(stacked, 1, 2))
    for gap, row, sd in list(zip(gaps, rows, sds, strict=True))[: plan.weighed]:
        one = xp.concatenate([row[:, 3:], gap], axis=1) / sd
        whole = whole + one[:, :, None] * one[:, None, :]
    if not plan.shared:
        return whole[:, 0, 0]
    fall = whole[:, :-1, -1]
    best = solved(xp, whole[:, :-1, :-1] + xp.eye(fall.shape[1]), fall[:, :, None])[:, :, 0]
    return whole[:, -1, -1] - (fall * best).sum(1)


def solved(xp: Any, matrix: Any, right: Any) -> Any:
    """matrix⁻¹ right, its diagonal a hair larger: beside weights of 10⁴⁰, of light that has all but gone, the priors
    are lost in rounding."""
    hair = 1e-14 * xp.diagonal(matrix, axis1=1, axis2=2)[:, :, None] * xp.eye(matrix.shape[1])
    return xp.linalg.solve(matrix + hair, right)


def rows_of(e: Engine, laid: Laid, seen: tuple[Any, Any, Any], k: int, shared: Any, data: Any = None) -> Any:
    """(b, P, u): slopes of slice k by every parameter at shared errors of that size, as large as what is `seen`; and
    what the `data` lie above it as a last row."""
    value, by_s, by_q = seen
    lifted = 1 + answer_of(e, laid.responses[k], shared)
    rows = [by_s * lifted, by_q * lifted, value * lifted, *(value * each for each in _by_error(laid.responses[k]))]
    return e.xp.stack(rows if data is None else [*rows, data - rows[2]], axis=1)


def _by_error(responses: Any) -> list[Any]:
    return [responses[:, j] for j in range(responses.shape[1])]


def prior(e: Engine, plan: Plan) -> Any:
    """Unit information on each shared error; none on s, q and c."""
    return e.xp.asarray(np.diag([0.0, 0.0, 0.0] + [1.0] * len(plan.shared)))
