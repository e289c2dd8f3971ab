"""A batch of jobs of one kind: found, weighed anew where it scatters, and judged. Nothing here opens a file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.compiled import settled
from bssrdf.fit.errors import SCATTERED, Judged, judge
from bssrdf.fit.jobs import Job, Options, problem_of
from bssrdf.fit.models import beside_of
from bssrdf.fit.problem import Neighbours, Plan, Point, Problem
from bssrdf.fit.solve import NEAR, REST, Solution, optimise, settle, start, starts_of
from bssrdf.transport.arrays import NUMPY, picked, replaced
from bssrdf.transport.light import Light

DISTINCT = 0.02
"""In ln σt′ and ln q: rough optima nearer than this are one."""
NEAR_BEST = 30.0
"""Times the best rough misfit up to which another valley is followed to its end."""
DOUBTFUL = 2.0
"""Reduced cost from which on other starts are tried too."""
DARK_Q = 1.0
"""Likewise: R hardly tells one dark medium from another."""
SURELY_POOR = 4.0
"""Standard deviations of χ² from which on a misfit is not chance: errors are taken as larger, others are tried."""
FAR = 5.0
"""Mean free paths; without R every valley is followed from here on."""
FURTHER = 3
"""Times that a search which has run out of steps goes on: of 2,000 exact curves two that lie beyond 20 mean free paths
need one or two."""
RIVAL = 4.0
"""Of the cost, in the scatter's own variance: a second optimum this near the best is as good."""


class Fitted(NamedTuple):
    """A batch with its results, rows in the order of `jobs`."""

    jobs: Sequence[Job]
    options: Options
    plan: Plan
    model: Light
    beside: Neighbours
    data: Problem
    found: Solution
    judged: Judged
    rival: Point
    """Another optimum that fits as well; NaN where there is none."""


def fit_group(
    jobs: Sequence[Job],
    options: Options,
    model: Light,
    *,
    compiled_for: int | None = None,
    begin: Point | None = None,
) -> Fitted:
    """Fit jobs of one cohort by one model; by JAX `compiled_for` so many rows, which pays for many cohorts.

    `begin` stands in for all starts, where a medium next to this was fitted and only the cost of this one is wanted.
    """
    aside = beside_of(model, jobs[0].pieces[0])
    plan, data = problem_of(jobs, options, model, aside)
    if begin is None:
        found, rival = _best(plan, model, data, aside, compiled_for)
    else:
        found = settle(NUMPY, plan, model, data, begin, aside, rest=NEAR)
        rival = Point(*(np.full_like(each, np.nan) for each in begin))
    found, judged = _eased(plan, model, data, found)
    return Fitted(jobs, options, plan, model, aside, data, found, judged, rival)


def searched(fitted: Fitted, rows: slice, *, compiled_for: int | None = None, single: bool = False) -> Solution:
    """The search for some rows from their first start alone, to compare engines: by NumPy, or by JAX `compiled_for` so
    many rows, with `single` in float32."""
    plan, model, data = fitted.plan, fitted.model, picked(fitted.data, rows)
    if compiled_for:
        return settled(plan, model, data, fitted.beside, compiled_for, single=single)
    return settle(NUMPY, plan, model, data, start(NUMPY, plan, model, data, 0)[0], fitted.beside)


def _best(
    plan: Plan, model: Light, data: Problem, aside: Neighbours, compiled_for: int | None
) -> tuple[Solution, Point]:
    """The lowest of the optima reached from several starts, and one as good at another place."""
    every, more = starts_of(plan)
    b = data.curves[0].r_lo.shape[0]
    rival = np.full((b, 3), np.nan)
    rows = np.arange(b)
    if compiled_for and len(every) == 1:
        found, others = settled(plan, model, data, aside, compiled_for), []
    else:
        begun = [start(NUMPY, plan, model, data, number) for number in every]
        misfits = np.stack([np.where(np.isfinite(misfit), misfit, np.inf) for _, misfit in begun])
        points = np.stack([np.concatenate(point, axis=1) for point, _ in begun])
        order = np.argsort(misfits, axis=0, kind="stable")
        found = _at_rest(plan, model, data, _point(points[order[0], rows]), aside)
        vague = _is_far(data, found) if not plan.totals else np.zeros(b, bool)
        likely = [vague | (misfits[place, rows] < NEAR_BEST * misfits[order[0], rows] + 10) for place in order[1:]]
        others = [(np.flatnonzero(near), points[place, rows]) for near, place in zip(likely, order[1:], strict=True)]
    doubtful = np.flatnonzero(
        ~found.converged | (found.cost > DOUBTFUL * _count(found)) | (found.point.q[:, 0] > DARK_Q)
    )
    for number in more if doubtful.size else ():
        point = np.full((b, 3), np.nan)
        point[doubtful] = np.concatenate(start(NUMPY, plan, model, picked(data, doubtful), number)[0], axis=1)
        others.append((doubtful, point))
    for chosen, point in others:
        ours = np.concatenate(found.point, axis=1)[chosen]
        again = chosen[(np.abs(_logs(point[chosen]) - _logs(ours)) > DISTINCT).any(axis=1)]
        if again.size:
            ended = _at_rest(plan, model, picked(data, again), _point(point[again]), aside)
            found, rival = _compared(model, data, found, ended, again, rival)
    return found, _point(rival)


def _is_far(data: Problem, found: Solution) -> NDArray[np.bool_]:
    """Rows whose data all lie beyond FAR: there light tells the scale and the albedo by its decay alone."""
    inner = np.min([c.reach[:, 0] for c in data.curves], axis=0)
    far: NDArray[np.bool_] = inner * np.exp(found.point.log_sigma[:, 0]) > FAR
    return far


def _at_rest(plan: Plan, model: Light, data: Problem, begin: Point, aside: Neighbours) -> Solution:
    """`settle`, and again for those on a long way: far out, where light falls by decades, each turn goes part of it."""
    found = settle(NUMPY, plan, model, data, begin, aside)
    for _ in range(FURTHER):
        far = np.flatnonzero(~found.converged & np.isfinite(found.cost))
        if not far.size:
            break
        rest = settle(NUMPY, plan, model, picked(data, far), picked(found.point, far), aside)
        found = replaced(found, far, rest)
    return found


def surely_poor(judged: Judged) -> NDArray[np.bool_]:
    """Rows whose χ² lies beyond chance."""
    poor: NDArray[np.bool_] = (judged.chi2 - 1) * np.sqrt(judged.n / 2) > SURELY_POOR
    return poor


def _eased(plan: Plan, model: Light, data: Problem, found: Solution) -> tuple[Solution, Judged]:
    """Where curves surely scatter by more than their errors say, and do not run to one side, they are weighed by that
    scatter and fitted again: against R and shared errors they counted too much."""
    judged = judge(NUMPY, plan, model, data, found)
    scattered = (judged.grown > 1) & (judged.runs_z < SCATTERED)
    rows = np.flatnonzero(found.converged & scattered & surely_poor(judged))
    if not rows.size:
        return found, judged
    old, those, grown = picked(found, rows), picked(data, rows), judged.grown[rows]
    weights = old.weights._replace(mass=tuple(mass / grown[:, None] for mass in old.weights.mass))
    new = optimise(NUMPY, plan, model, those, old.laid, old.point, 10 * REST, relay=False, weights=weights)
    new = new._replace(stated=old.stated, ease=grown)
    good = np.flatnonzero(new.converged)
    found = replaced(found, rows[good], picked(new, good))
    return found, judge(NUMPY, plan, model, data, found)


def _compared(
    model: Light, data: Problem, found: Solution, ended: Solution, again: NDArray[np.int_], rival: NDArray[np.float64]
) -> tuple[Solution, NDArray[np.float64]]:
    """The better of two optima of some rows, and the other as a rival where it is as good and elsewhere."""
    rival = rival.copy()
    ours, theirs = picked(found, again), ended
    old, new = _score(model, picked(data, again), ours), _score(model, picked(data, again), theirs)
    a, b = (np.concatenate(each.point, axis=1) for each in (ours, theirs))
    apart = (np.abs(_logs(a) - _logs(b)) > DISTINCT).any(axis=1)
    better = theirs.converged & (new < old - 1e-9)
    scatter = np.maximum(np.minimum(ours.cost, theirs.cost) / np.maximum(_count(ours), 1), 1.0)
    as_good = apart & ours.converged & theirs.converged & (np.abs(ours.cost - theirs.cost) < RIVAL * scatter)
    rival[again[as_good]] = np.where(better[:, None], a, b)[as_good]
    return replaced(found, again[better], picked(ended, np.flatnonzero(better))), rival


def _score(model: Light, data: Problem, found: Solution) -> NDArray[np.float64]:
    """Reduced cost; a table that has lost radii, which it never should, counts them as misfit."""
    count = _count(found)
    every = sum((c.known != 0).any(2).sum(1) for c in data.curves)
    lost = (every / np.maximum(count, 1)) ** 2 if not model.biased else 1.0
    score: NDArray[np.float64] = np.where(count > 0, found.cost / np.maximum(count, 1) * lost, np.inf)
    return score


def _count(found: Solution) -> NDArray[np.float64]:
    counted: NDArray[np.float64] = sum((mass > 0).sum(1) for mass in found.weights.mass).astype(float)
    return counted


def _logs(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([points[:, 0], np.log(np.maximum(np.abs(points[:, 1]), 1e-3))], axis=1)


def _point(values: NDArray[np.float64]) -> Point:
    return Point(*(values[:, k : k + 1] for k in range(3)))
