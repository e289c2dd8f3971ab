"""The minimum of the objective: starts, damped Gauss–Newton whose weights follow the model, and rest.

Shared errors are linear and have priors: they are eliminated in one place (`marginal`). The fit rests where neither
point nor weights move. One text for NumPy and JAX; b problems at once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bssrdf.fit.layout import Total
from bssrdf.fit.terms import (
    Laid,
    Neighbours,
    Plan,
    Point,
    Problem,
    System,
    Weights,
    curve,
    lay,
    lay_plainly,
    system,
    total_row,
    weigh,
)
from bssrdf.transport import R_MAX
from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import Light, q_of_total

MAX_STEPS = 40
START_STEPS = 15
LAYS = 8
"""Times that exit law, spot and responses are worked out anew; two or three suffice but for dark media."""
REST = 1e-8
"""In the parameters, of order 1: below this neither point nor weights move."""
NEAR = 1e-4
"""What spot and camera do, to first order about where it was worked out, is right to 1e-7 within this; and no step so
short is refused, since the weights that follow it may cost more than it gains."""
QUIET, CREEPING, PATIENCE = 1e-5, 1e-3, 12
"""In standard deviations: a shorter step is rest; after so many steps a longer one is, since where the data hardly tell
a search creeps along as its weights follow."""
GAINED = 1e-3
"""In χ², from one laying to the next: less is rest."""
ROUGH = 1e-3
SLACK = 1e-6
"""By how much of itself the cost may rise on a step: responses and weights follow the model, so that rest, where the
equations hold, lies a little beside the least cost."""
TINY_MOVE = 1e-30
LEAST_Q_STEP, PAST_ZERO = 4.0, 1e-3
"""q falls by no more than this factor a step, until it is next to 0: below 0, where R counts beyond 1, another optimum
waits for long steps from afar."""
LONGEST_STEP = 1.0
"""No step changes a scale by more than a factor e."""
Q_GRID = np.geomspace(0.03, 1.6, 16)
VALLEYS = 4
"""Ranges of albedo in which a curve is looked for, each for itself: shape alone has a second minimum at another."""
ABOUT = (1.0, 0.6, 1.5)
"""Factors on the q of R from which a fit with R starts: very dark media have two fixed points."""
LOG_EXTENT = np.linspace(np.log(0.3), np.log(1000.0), 24)
"""ln of (largest radius in mean free paths), tried for each curve."""
SCANNED = 3
"""Of the few radii of a start every third is scanned."""
LOST = 3.0
"""Misfit, in ln, of a radius that a start puts beyond the model's reach."""


class Solution(NamedTuple):
    """Where a search ended."""

    point: Point
    laid: Laid
    weights: Weights
    shared: Any
    """(b, K): fitted shared errors, in their sd."""
    cost: Any
    """(b,): the marginal cost."""
    converged: Any


class Marginal(NamedTuple):
    """Normal equations in the free parameters, with shared errors at their best."""

    cost: Any
    gradient: Any
    curvature: Any
    shared: Any
    """(b, K): those errors, in their sd."""
    answer: Any
    """(b, K, p): how they fall as the free parameters grow."""


class _State(NamedTuple):
    trial: Point
    best: Point
    here: Marginal
    weights: Weights
    damping: Any
    steps: Any
    done: Any


def start(e: Engine, plan: Plan, model: Light, data: Problem, number: int) -> tuple[Point, Any]:
    """The rough optimum from one of several places, and its misfit (b,): inf where it lost its radii."""
    few, plain = _few_of(e, plan, data)
    if plan.constraint == "none":
        zero = 0 * data.curves[0].spot_radius
        qs = [zero + q for q in Q_GRID.reshape(VALLEYS, -1)[number]]
    else:
        q = q_of_total(e, model, e.xp.minimum(data.totals[0].r, 1.0))
        qs = [e.xp.clip(q * ABOUT[number], 1e-6, model.q_max)]
    begun = _scanned(e, model, few, qs, plan.scale_free)
    laid = lay_plainly(e, plain, few, begun)
    ended = optimise(e, plain, model, few, laid, begun, ROUGH, relay=True, most=START_STEPS)
    finite = e.xp.isfinite(sum(ended.point))
    point = Point(*(e.xp.where(finite, new, old) for new, old in zip(ended.point, begun, strict=True)))
    return point, _misfit(e, plain, model, few, point)


def starts_of(plan: Plan) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Numbers of the starts that every problem takes, and of those for the doubtful."""
    if plan.constraint == "exact":  # R leaves no choice of q
        return (0,), ()
    return (tuple(range(VALLEYS)), ()) if plan.constraint == "none" else ((0,), tuple(range(1, len(ABOUT))))


def settle(e: Engine, plan: Plan, model: Light, data: Problem, begin: Point, beside: Neighbours) -> Solution:
    """The optimum near `begin`, at rest."""
    xp = e.xp
    costly = any(sight.blurred or sight.camera for sight in plan.sights)
    near = NEAR if costly else 10 * REST

    def again(state: tuple[Solution, Any, Any, Any]) -> tuple[Solution, Any, Any, Any]:
        last, number, *_ = state
        laid = lay(e, plan, model, data, last.point, beside)
        found = optimise(e, plan, model, data, laid, last.point, REST, relay=True, shared=last.shared)
        quiet = xp.abs(found.cost - last.cost) < GAINED
        return found, number + 1, _distance(xp, found.point, last.point) > near, quiet

    laid = lay(e, plan, model, data, begin, beside)
    if plan.constraint == "exact":
        seen = data.totals[0].r / laid.total_seen[0]
        begin = begin._replace(q=xp.where(seen < 1, q_of_total(e, model, xp.minimum(seen, 1.0)), begin.q))
    first = optimise(e, plan, model, data, laid, begin, ROUGH, relay=True)
    begun = (first, xp.asarray(0), first.cost < np.inf, first.cost < 0)
    found, _, moving, quiet = e.loop(lambda s: s[2] & (s[1] < LAYS), again, begun)
    return found._replace(converged=(found.converged & ~moving) | quiet)


def optimise(
    e: Engine,
    plan: Plan,
    model: Light,
    data: Problem,
    laid: Laid,
    begin: Point,
    settled: float,
    *,
    relay: bool,
    weights: Weights | None = None,
    shared: Any = None,
    held_q: bool = False,
    most: int = MAX_STEPS,
) -> Solution:
    """Damped Gauss–Newton from `begin`; with `relay` the weights follow each step, else they stay as given."""
    xp = e.xp
    columns = _free(plan, held_q)
    b = begin.q.shape[0]
    zeros = xp.zeros(b)
    shared = xp.zeros((b, laid.responses[0].shape[1])) if shared is None else shared

    def look(at: Point) -> tuple[Any, ...]:
        return tuple(curve(e, plan, model, laid, at, k) for k in range(len(plan.sights)))

    def reduced(at: Point, looks: Any, by: Weights) -> Marginal:
        return marginal(e, plan, model, data, laid, at, system(e, plan, model, data, laid, at, looks, by), columns)

    def weighed(at: Point, looks: Any, errors: Any) -> Weights:
        return weigh(e, plan, model, data, laid, at, tuple(each[0] for each in looks), errors)

    def step(s: _State) -> _State:
        looks = look(s.trial)
        better = reduced(s.trial, looks, s.weights).cost <= s.here.cost + SLACK * (1 + s.here.cost)
        better = better | (xp.isfinite(s.here.cost) & (_distance(xp, s.trial, s.best) < NEAR))
        by = s.weights
        if relay:
            by = _chosen(xp, better, weighed(s.trial, looks, s.here.shared), s.weights)
        best = _chosen(xp, better, s.trial, s.best)
        here = _chosen(xp, better, reduced(s.trial, looks, by), s.here)
        damping = xp.where(better, s.damping * 0.1, xp.maximum(s.damping, 1e-3) * 10)
        move = solve_damped(xp, here.curvature, here.gradient, damping)
        if columns == (0, 1):
            move = _within(xp, model, best.q, move, here, damping)
        move = move * xp.minimum(1.0, LONGEST_STEP / xp.maximum(xp.abs(move).max(1), TINY_MOVE))[:, None]
        errors = here.shared - xp.matmul(here.answer, move[:, :, None])[:, :, 0]
        trial = _moved(e, plan, model, data, laid, best, move, errors, columns)
        quiet = xp.where(s.steps < PATIENCE, QUIET, CREEPING)
        short = (_distance(xp, trial, best) < settled) | (xp.abs((move * here.gradient).sum(1)) < quiet**2)
        done = (better & short) | (damping > 1e12) | ~xp.isfinite(here.cost)
        stepped = _State(trial, best, here, by, damping, s.steps + 1, done)
        return _State(*(_chosen(xp, s.done, o, n) for o, n in zip(s, stepped, strict=True)))

    by = weighed(begin, look(begin), shared) if weights is None else weights
    p = len(columns)
    k = shared.shape[1]
    here = Marginal(zeros + np.inf, xp.zeros((b, p)), xp.zeros((b, p, p)) + xp.eye(p), shared, xp.zeros((b, k, p)))
    first = _State(begin, begin, here, by, zeros, xp.zeros(b, dtype=xp.int32), zeros > 1)
    last = e.loop(lambda s: ~s.done & (s.steps < most), step, first)
    point = _chosen(xp, last.damping < 1, last.trial, last.best)
    return Solution(
        point, laid, last.weights, last.here.shared, last.here.cost, last.done & xp.isfinite(last.here.cost)
    )


def marginal(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, full: System, columns: tuple[int, ...]
) -> Marginal:
    """The normal equations in some columns alone. Where R is exact it fixes q given all else: that goes first."""
    xp = e.xp
    lift, shift = elimination(e, plan, model, data, laid, at)
    moved = xp.matmul(full.matrix, shift[:, :, None])[:, :, 0]
    cost = full.cost - 2 * (shift * full.gradient).sum(1) + (shift * moved).sum(1)
    down = xp.swapaxes(lift, 1, 2)
    gradient = xp.matmul(down, (full.gradient - moved)[:, :, None])[:, :, 0]
    matrix = xp.matmul(down, xp.matmul(full.matrix, lift))
    free, rest = np.array(columns), np.arange(3, gradient.shape[1])
    g, h = gradient[:, free], matrix[:, free][:, :, free]
    if not rest.size:
        return Marginal(cost, g, h, gradient[:, rest], matrix[:, rest][:, :, free])
    g_rest, h_rest, cross = gradient[:, rest], matrix[:, rest][:, :, rest], matrix[:, rest][:, :, free]
    solved = xp.linalg.solve(h_rest, xp.concatenate([g_rest[:, :, None], cross], axis=2))
    errors, answer = solved[:, :, 0], solved[:, :, 1:]
    turn = xp.swapaxes(cross, 1, 2)
    return Marginal(
        cost=cost - (g_rest * errors).sum(1),
        gradient=g - xp.matmul(turn, errors[:, :, None])[:, :, 0],
        curvature=h - xp.matmul(turn, answer),
        shared=errors,
        answer=answer,
    )


def elimination(e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point) -> tuple[Any, Any]:
    """(b, P, P) that lifts a move of all other parameters to one that keeps R, and the (b, P) move that meets R."""
    xp = e.xp
    size = 3 + laid.responses[0].shape[1]
    b = at.q.shape[0]
    lift = xp.zeros((b, size, size)) + xp.eye(size)
    if plan.constraint != "exact":
        return lift, xp.zeros((b, size))
    gap, row = total_row(e, model, data, laid, at, 0)
    unit = xp.asarray(np.eye(size)[1])
    lift = lift - unit[None, :, None] * (row / row[:, 1:2])[:, None, :]
    return lift, unit[None, :] * gap / row[:, 1:2]


def _moved(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, move: Any, errors: Any,
    columns: tuple[int, ...],
) -> Point:  # fmt: skip
    """The point after a move of the free parameters; q stays within the model."""
    xp = e.xp
    b = move.shape[0]
    given = {column: move[:, i : i + 1] for i, column in enumerate(columns)}
    zero = xp.zeros((b, 1))
    full = xp.concatenate([given.get(k, zero) for k in range(3)], axis=1)
    q_move = full[:, 1:2]
    if plan.constraint == "exact":
        lift, shift = elimination(e, plan, model, data, laid, at)
        every = xp.concatenate([full, errors], axis=1)
        q_move = (lift[:, 1] * every).sum(1, keepdims=True) + shift[:, 1:2]
        q_move = xp.clip(q_move, -0.5, 0.5)
    q = xp.clip(at.q + q_move, -model.q_max, model.q_max)
    q = xp.where(at.q > 0, xp.maximum(q, at.q / LEAST_Q_STEP - PAST_ZERO), q)
    if not plan.totals:
        q = xp.abs(q)  # a curve alone is even in q
    return Point(at.log_sigma + full[:, 0:1], q, at.log_scale + full[:, 2:3])


def solve_damped(xp: Any, curvature: Any, gradient: Any, damping: Any) -> Any:
    """(H + λ diag H)⁻¹ g, scaled so that the parameters' units do not matter."""
    p = gradient.shape[1]
    scale = xp.sqrt(xp.maximum(xp.diagonal(curvature, axis1=1, axis2=2), 1e-30))
    h = curvature / scale[:, :, None] / scale[:, None, :]
    h = xp.where(xp.isfinite(h), h, 0.0) + (damping + 1e-14)[:, None, None] * xp.eye(p)
    h = xp.where(xp.eye(p) > 0, xp.maximum(h, 1e-14), h)
    g = xp.where(xp.isfinite(gradient), gradient, 0.0) / scale
    return xp.linalg.solve(h, g[:, :, None])[:, :, 0] / scale


def _within(xp: Any, model: Light, q: Any, move: Any, here: Marginal, damping: Any) -> Any:
    """The move of (s, q), or where q would leave the model that to its edge and the best of s there."""
    room = (xp.clip(q[:, 0] + move[:, 1], -model.q_max, model.q_max) - q[:, 0])[:, None]
    g, h = here.gradient[:, :1], here.curvature
    s = (g - h[:, 0, 1:2] * room) / xp.maximum(h[:, 0, :1] * (1 + damping)[:, None], 1e-30)
    return xp.where(xp.abs(room - move[:, 1:2]) > 0, xp.concatenate([s, room], axis=1), move)


def _distance(xp: Any, a: Point, b: Point) -> Any:
    """Largest difference in any parameter, (b,)."""
    return xp.max(xp.abs(xp.concatenate(a, axis=1) - xp.concatenate(b, axis=1)), axis=1)


def _free(plan: Plan, held_q: bool) -> tuple[int, ...]:
    """Columns that move: s, q unless R or the caller fixes it, c where the scale is free."""
    q = () if held_q or plan.constraint == "exact" else (1,)
    return (0, *q, *((2,) if plan.scale_free else ()))


def _chosen(xp: Any, test: Any, a: Any, b: Any) -> Any:
    """`a` where the test holds, else `b`, through tuples of arrays."""
    if isinstance(b, tuple):
        made = [_chosen(xp, test, x, y) for x, y in zip(a, b, strict=True)]
        return type(b)(*made) if hasattr(b, "_fields") else tuple(made)
    return xp.where(test.reshape((-1,) + (1,) * (b.ndim - 1)), a, b)


def _few_of(e: Engine, plan: Plan, data: Problem) -> tuple[Problem, Plan]:
    """A sample of the radii of every slice as plain curves of a narrow beam."""
    curves = tuple(
        c._replace(r_lo=c.few_r, r_hi=c.few_r, arc=0 * c.few_r, rd=c.few_rd[..., None], known=c.few_known[..., None])
        for c in data.curves
    )
    plain = tuple(s._replace(camera=False, binned=False, inner=0, blurred=False, blur_inner=0) for s in plan.sights)
    totals = tuple(Total(e.xp.minimum(each.r, 1.0), each.sd) for each in data.totals)
    return data._replace(curves=curves, totals=totals), plan._replace(sights=plain, shared=(), robust=False)


def _scanned(e: Engine, model: Light, few: Problem, qs: list[Any], scale_free: bool) -> Point:
    """The scale of a grid whose curve of one of these q is nearest, in the logarithm."""
    xp = e.xp
    r = xp.concatenate([c.few_r[:, ::SCANNED] for c in few.curves], axis=1)
    rd = xp.concatenate([c.few_rd[:, ::SCANNED] for c in few.curves], axis=1)
    good = xp.concatenate([c.few_known[:, ::SCANNED] for c in few.curves], axis=1) * (rd > 0) > 0
    weight = good / xp.maximum(good.sum(1, keepdims=True), 1)
    log_rd = xp.log(xp.where(good, rd, 1.0))
    b, n = r.shape
    log_sigma = xp.asarray(LOG_EXTENT)[None, :] - xp.log(xp.max(xp.where(good, r, TINY_MOVE), axis=1, keepdims=True))
    log_sigma = xp.where(good.any(1)[:, None], log_sigma, 0.0)
    x = xp.maximum((xp.exp(log_sigma)[:, :, None] * r[:, None, :]).reshape(b, -1), 1e-3)
    costs, offsets = [], []
    for q in qs:
        shape = xp.log(xp.maximum(model.look(e, q, x)[0], 1e-300)).reshape(b, -1, n)
        difference = log_rd[:, None, :] - shape - 2 * log_sigma[:, :, None]
        offset = (weight[:, None, :] * difference).sum(2)
        misfit = (weight[:, None, :] * xp.abs(difference - (offset[..., None] if scale_free else 0.0))).sum(2)
        costs.append(misfit)
        offsets.append(offset)
    cost, offset = xp.stack(costs, 1).reshape(b, -1), xp.stack(offsets, 1).reshape(b, -1)
    best = xp.argmin(xp.where(xp.isfinite(cost), cost, np.inf), axis=1)[:, None]
    q = xp.take_along_axis(xp.concatenate(qs, axis=1), best // LOG_EXTENT.size, axis=1)
    found = xp.take_along_axis(log_sigma, best % LOG_EXTENT.size, axis=1)
    c = xp.take_along_axis(offset, best, axis=1)
    return Point(found, q, c if scale_free else 0 * c)


def _misfit(e: Engine, plain: Plan, model: Light, few: Problem, at: Point) -> Any:
    """Mean square of the relative misfit, cut at LOST for radii that the model does not reach or misses altogether."""
    xp = e.xp
    laid = lay_plainly(e, plain, few, at)
    squares, count = 0.0, 0.0
    for k, c in enumerate(few.curves):
        value = curve(e, plain, model, laid, at, k)[0]
        x = xp.exp(at.log_sigma) * c.few_r
        off = xp.abs(xp.log(xp.maximum(c.few_rd, 1e-300) / xp.maximum(value, 1e-300)))
        off = xp.where((x > R_MAX) | ~xp.isfinite(off), LOST, xp.minimum(off, LOST))
        noise = 1 / xp.maximum(xp.abs(c.few_known * c.few_rd), 1e-6)
        good = (c.few_known > 0) & (c.few_rd > 0)
        squares = squares + (good * off * off / (1e-6 + xp.square(xp.minimum(noise, 1.0)))).sum(1)
        count = count + good.sum(1)
    return squares / xp.maximum(count, 1)
