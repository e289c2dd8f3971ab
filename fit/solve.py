"""The minimum of the objective: damped Gauss–Newton whose weights follow the model, and rest.

Shared errors are linear and have priors: they are eliminated in one place (`marginal`). The fit rests where neither
point nor weights move. One text for NumPy and JAX; b problems at once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bssrdf.fit.laying import answering, costly, lay, look
from bssrdf.fit.problem import Laid, Looked, Neighbours, Plan, Point, Problem, System, Weights, held_any
from bssrdf.fit.terms import (
    cost_at,
    elimination,
    holding_sigma_a,
    keeping,
    meeting,
    of_shared,
    solved,
    system,
    totals_of,
    weigh,
)
from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import Light

MAX_STEPS = 40
LAID_STEPS = 8
"""From one laying to the next: far from rest laying anew gains more than further steps do."""
LAYS = 12
"""Times that exit law, spot and responses are worked out anew; two or three suffice but for dark media."""
REST = 1e-8
"""In the parameters, of order 1: below this neither point nor weights move."""
NEAR = 1e-4
"""What spot and camera do, to first order about where it was worked out, is right to 1e-7 within this; and no step so
short is refused, since the weights that follow it may cost more than it gains."""
LAID = 1e-5
"""Between one laying and the next, after which none is needed: each brings the point some ten times nearer to rest."""
QUIET, CREEPING, PATIENCE = 1e-5, 1e-3, 12
"""In standard deviations: a shorter step is rest; after so many steps a longer one is, since where the data hardly tell
a search creeps along as its weights follow."""
SHORTENED = 0.5
"""Steps after as many: where data contradict the model, weights and responses that follow it throw a whole step to and
fro about where it would rest."""
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


class Solution(NamedTuple):
    """Where a search ended."""

    point: Point
    laid: Laid
    weights: Weights
    shared: Any
    """(b, K): fitted shared errors, in their sd."""
    cost: Any
    """(b,): the marginal cost, by the weights in force."""
    converged: Any
    stated: Any
    """(b,): the cost at rest by errors as they are stated."""
    ease: Any
    """(b,): what the curves' variances were multiplied by since; see `batch`."""


class Marginal(NamedTuple):
    """Normal equations in the free parameters, with shared errors at their best."""

    cost: Any
    gradient: Any
    curvature: Any
    shared: Any
    """(b, K): those errors, in their sd."""
    answer: Any
    """(b, K, p): how they fall as the free parameters grow."""
    keeps: tuple[Any, Any] | None
    """Where a condition fixes q: (b, P) what it falls by as each other parameter grows, and (b, 1) what it lacks."""


class _State(NamedTuple):
    trial: Point
    errors: Any
    """(b, K): the shared errors there, if all were linear."""
    best: Point
    laid: Laid
    here: Marginal
    weights: Weights
    damping: Any
    steps: Any
    done: Any


def settle(
    e: Engine,
    plan: Plan,
    model: Light,
    data: Problem,
    begin: Point,
    beside: Neighbours,
    *,
    rest: float = REST,
    most: int = LAID_STEPS,
) -> Solution:
    """The optimum near `begin`, at rest; a larger `rest` is enough where its cost alone is wanted. `most` steps are
    taken from one laying to the next."""
    xp = e.xp
    laid = lay(e, plan, model, data, begin, beside)
    begin = meeting(e, plan, model, data, laid, begin)
    if not costly(plan):
        return optimise(e, plan, model, data, laid, begin, rest, relay=True, beside=beside)

    def again(state: tuple[Solution, Any, Any, Any], data: Problem) -> tuple[Solution, Any, Any, Any]:
        last, number, *_ = state
        laid = lay(e, plan, model, data, last.point, beside, last.laid.nodes)
        found = optimise(e, plan, model, data, laid, last.point, rest, relay=True, shared=last.shared, most=most)
        quiet = xp.abs(found.cost - last.cost) < GAINED
        return found, number + 1, _distance(xp, found.point, last.point) > max(LAID, 10 * rest), quiet

    first = optimise(e, plan, model, data, laid, begin, ROUGH, relay=True, most=most)
    begun = (first, xp.zeros(first.cost.shape[0], dtype=xp.int32), first.cost < np.inf, first.cost < 0)
    found, _, moving, quiet = e.loop(lambda s: s[2] & (s[1] < LAYS), again, begun, data)
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
    beside: Neighbours | None = None,
    weights: Weights | None = None,
    shared: Any = None,
    held_sigma_a: bool = False,
    most: int = MAX_STEPS,
) -> Solution:
    """Damped Gauss–Newton from `begin`; with `relay` the weights follow each step, with `beside` the shared responses
    too, else they stay as given. `held_sigma_a` keeps σa as it begins; R is not a condition then."""
    xp = e.xp
    columns = tuple(k for k in plan.free if not (held_sigma_a and k == 1))
    b = begin.q.shape[0]
    zeros = xp.zeros(b)

    def reduced(data: Problem, laid: Laid, seen: Looked, by: Weights, at: Point, shared: Any) -> Marginal:
        gaps = totals_of(e, plan, data, laid, seen, shared)
        full = system(e, plan, data, laid, seen, gaps, by, shared)
        keeps = holding_sigma_a(e, full, at) if held_sigma_a else keeping(plan, gaps)
        return marginal(e, full, columns, keeps, shared)

    def ahead(best: Point, here: Marginal, damping: Any, steps: Any) -> tuple[Any, Any, Point]:
        """The next move, and shared errors and point after it."""
        move = solve_damped(xp, here.curvature, here.gradient, damping)
        if columns == (0, 1):
            move = _within(xp, model, best.q, move, here, damping)
        move = move * xp.minimum(1.0, LONGEST_STEP / xp.maximum(xp.abs(move).max(1), TINY_MOVE))[:, None]
        move = move * xp.where(steps < PATIENCE, 1.0, SHORTENED)[:, None]
        errors = here.shared - xp.matmul(here.answer, move[:, :, None])[:, :, 0]
        return move, errors, _moved(e, plan, model, best, here, move, errors, columns, held_sigma_a)

    def step(s: _State, data: Problem) -> _State:
        seen, laid, by = look(e, plan, model, data, s.laid, s.trial), s.laid, s.weights
        if beside is not None:
            laid = answering(e, plan, model, data, laid, s.trial, beside, seen.curves)
        if relay:
            by = weigh(e, plan, model, data, laid, s.trial, seen, s.errors)
        there = reduced(data, laid, seen, by, s.trial, s.errors)
        near = xp.isfinite(s.here.cost) & (_distance(xp, s.trial, s.best) < NEAR)
        cost = there.cost
        if relay:
            cost = e.needed(~near, lambda: cost_at(e, plan, data, s.laid, seen, s.weights, s.errors), cost)
        better = near | (cost <= s.here.cost + SLACK * (1 + s.here.cost))
        best, laid, here, by = e.chosen(better, (s.trial, laid, there, by), (s.best, s.laid, s.here, s.weights))
        damping = xp.where(better, s.damping * 0.1, xp.maximum(s.damping, 1e-3) * 10)
        move, errors, trial = ahead(best, here, damping, s.steps)
        quiet = xp.where(s.steps < PATIENCE, QUIET, CREEPING)
        short = (_distance(xp, trial, best) < settled) | (xp.abs((move * here.gradient).sum(1)) < quiet**2)
        done = (better & short) | (damping > 1e12) | ~xp.isfinite(here.cost)
        return _State(trial, errors, best, laid, here, by, damping, s.steps + 1, done)

    shared = xp.zeros((b, laid.responses[0].shape[1])) if shared is None else shared
    seen = look(e, plan, model, data, laid, begin)
    by = weigh(e, plan, model, data, laid, begin, seen, shared) if weights is None else weights
    here = reduced(data, laid, seen, by, begin, shared)
    _, errors, trial = ahead(begin, here, zeros, zeros)
    first = _State(trial, errors, begin, laid, here, by, zeros, xp.zeros(b, dtype=xp.int32), ~xp.isfinite(here.cost))
    last = e.loop(lambda s: ~s.done & (s.steps < most), step, first, data)
    point, shared = e.chosen(last.damping < 1, (last.trial, last.errors), (last.best, last.here.shared))
    converged = last.done & xp.isfinite(last.here.cost)
    cost = last.here.cost
    return Solution(point, last.laid, last.weights, shared, cost, converged, cost, zeros + 1)


def marginal(e: Engine, full: System, columns: tuple[int, ...], keeps: tuple[Any, Any] | None, shared: Any) -> Marginal:
    """The normal equations in some columns alone, from those at shared errors of that size. What `keeps` a condition
    fixes q given all else: that goes first."""
    xp = e.xp
    cost, gradient, matrix = full
    if keeps is not None:
        falls, missing = keeps
        lift, shift = elimination(e, (falls, missing - of_shared(falls, shared)))
        moved = xp.matmul(matrix, shift[:, :, None])[:, :, 0]
        cost = cost - 2 * (shift * gradient).sum(1) + (shift * moved).sum(1)
        down = xp.swapaxes(lift, 1, 2)
        gradient = xp.matmul(down, (gradient - moved)[:, :, None])[:, :, 0]
        matrix = xp.matmul(down, xp.matmul(matrix, lift))
    free, rest = np.array(columns), np.arange(3, gradient.shape[1])
    g, h = gradient[:, free], matrix[:, free][:, :, free]
    g_rest, h_rest, cross = gradient[:, 3:], matrix[:, 3:, 3:], matrix[:, 3:][:, :, free]
    if not rest.size:
        return Marginal(cost, g, h, shared, cross, keeps)
    both = solved(xp, h_rest, xp.concatenate([g_rest[:, :, None], cross], axis=2))
    errors, answer = both[:, :, 0], both[:, :, 1:]
    turn = xp.swapaxes(cross, 1, 2)
    return Marginal(
        cost=cost - (g_rest * errors).sum(1),
        gradient=g - xp.matmul(turn, errors[:, :, None])[:, :, 0],
        curvature=h - xp.matmul(turn, answer),
        shared=shared + errors,
        answer=answer,
        keeps=keeps,
    )


def _moved(
    e: Engine,
    plan: Plan,
    model: Light,
    at: Point,
    here: Marginal,
    move: Any,
    errors: Any,
    columns: tuple[int, ...],
    held_sigma_a: bool,
) -> Point:
    """The point after a move of the free parameters; q stays within the model."""
    xp = e.xp
    zero = xp.zeros_like(at.q)
    s, q_move, c = (move[:, columns.index(k)][:, None] if k in columns else zero for k in range(3))
    if held_sigma_a:
        return Point(at.log_sigma + s, xp.minimum(at.q * xp.exp(-s / 2), model.q_max), at.log_scale + c)
    if here.keeps is not None:
        falls, missing = here.keeps
        every = xp.concatenate([s, zero, c, errors], axis=1)
        q_move = xp.clip(missing - (falls * every).sum(1, keepdims=True), -0.5, 0.5)
    q = xp.clip(at.q + q_move, -model.q_max, model.q_max)
    q = xp.where(at.q > 0, xp.maximum(q, at.q / LEAST_Q_STEP - PAST_ZERO), q)
    if here.keeps is not None and held_any(plan):
        q = xp.maximum(q, 0.0)
    elif not plan.totals or held_any(plan):
        q = xp.abs(q)  # a curve alone is even in q, and so is all light of a finite sample
    return Point(at.log_sigma + s, q, at.log_scale + c)


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
