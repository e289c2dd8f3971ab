"""A batch of jobs of one kind: found, weighed anew where it scatters, and judged. Nothing here opens a file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.compiled import settled
from bssrdf.fit.errors import SCATTERED, Judged, judge
from bssrdf.fit.jobs import FitOptions, Job, problem_of
from bssrdf.fit.models import beside_of
from bssrdf.fit.problem import Neighbours, Plan, Point, Problem
from bssrdf.fit.solve import GAINED, MAX_STEPS, NEAR, REST, Solution, optimise, settle
from bssrdf.fit.starts import misfit, start, starts_of
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
    options: FitOptions
    plan: Plan
    model: Light
    beside: Neighbours
    data: Problem
    found: Solution
    judged: Judged
    rival: Point
    """Another optimum that fits as well; NaN where there is none."""

    def part(self, rows: NDArray[np.int_]) -> Fitted:
        """Some of the rows."""
        arrays = {name: picked(getattr(self, name), rows) for name in ("data", "found", "judged", "rival")}
        return self._replace(jobs=[self.jobs[row] for row in rows], **arrays)


def fit_group(
    jobs: Sequence[Job],
    options: FitOptions,
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
    return settle(NUMPY, plan, model, data, start(NUMPY, plan, model, data, 0), fitted.beside)


def _best(
    plan: Plan, model: Light, data: Problem, aside: Neighbours, compiled_for: int | None
) -> tuple[Solution, Point]:
    """The lowest of the optima reached from several starts, and one as good at another place."""
    every, more = starts_of(plan)
    rows = np.arange(data.curves[0].r_lo.shape[0])
    others: list[_Begun] = []
    if compiled_for and len(every) == 1:
        found = settled(plan, model, data, aside, compiled_for)
        tried = [_logs(found.point)]
    else:
        points, misfits = _begun(plan, model, data, rows, every)
        order = np.argsort(misfits, axis=0, kind="stable")
        first = _point(points[order[0], rows])
        found = _at_rest(plan, model, data, first, aside)
        tried = [_logs(first), _logs(found.point)]
        vague = _is_far(data, found) if not plan.totals else np.zeros(rows.size, bool)
        for place in order[1:]:
            likely = vague | (misfits[place, rows] < NEAR_BEST * misfits[order[0], rows] + 10)
            others.append(_Begun(rows[likely], points[place, rows][likely]))
    doubtful = np.flatnonzero(
        ~found.converged | (found.cost > DOUBTFUL * _count(found)) | (found.point.q[:, 0] > DARK_Q)
    )
    if more and doubtful.size:
        others += [_Begun(doubtful, points) for points in _begun(plan, model, data, doubtful, more)[0]]
    return _followed(plan, model, data, aside, found, tried, others)


class _Begun(NamedTuple):
    """Rough optima (n, 3) of some rows (n,)."""

    rows: NDArray[np.int_]
    points: NDArray[np.float64]


def _begun(
    plan: Plan, model: Light, data: Problem, rows: NDArray[np.int_], numbers: Sequence[int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rough optima (k, n, 3) of some rows from starts of these numbers, and the misfits (k, n) of several."""
    several = picked(data, np.tile(rows, len(numbers)))
    point = start(NUMPY, plan, model, several, np.repeat(numbers, rows.size))
    found = misfit(NUMPY, plan, model, several, point) if len(numbers) > 1 else np.zeros(rows.size)
    found = np.where(np.isfinite(found), found, np.inf)
    return np.concatenate(point, axis=1).reshape(len(numbers), -1, 3), found.reshape(len(numbers), -1)


def _followed(
    plan: Plan,
    model: Light,
    data: Problem,
    aside: Neighbours,
    found: Solution,
    tried: list[NDArray[np.float64]],
    others: Sequence[_Begun],
) -> tuple[Solution, Point]:
    """What is found from other starts too, all at once; those next to one that was `tried` would end where it did."""
    rival = np.full((found.cost.size, 3), np.nan)
    new: list[_Begun] = []
    for rows, points in others:
        logs = _logs(_point(points))
        known = np.any([(np.abs(logs - each[rows]) < DISTINCT).all(axis=1) for each in tried], axis=0)
        new.append(_Begun(rows[~known], points[~known]))
        tried.append(np.full_like(tried[0], np.nan))
        tried[-1][rows] = logs
    rows = np.concatenate([np.zeros(0, int), *(each.rows for each in new)])
    if rows.size:
        begin = _point(np.concatenate([each.points for each in new]))
        ended = _at_rest(plan, model, picked(data, rows), begin, aside)
        for each, end in zip(new, np.cumsum([each.rows.size for each in new]), strict=True):
            part = picked(ended, slice(end - each.rows.size, end))
            found, rival = _compared(model, data, found, part, each.rows, rival)
    return found, _point(rival)


def _is_far(data: Problem, found: Solution) -> NDArray[np.bool_]:
    """Rows whose data all lie beyond FAR: there light tells the scale and the albedo by its decay alone."""
    inner = np.min([c.reach[:, 0] for c in data.curves], axis=0)
    far: NDArray[np.bool_] = inner * np.exp(found.point.log_sigma[:, 0]) > FAR
    return far


def _at_rest(plan: Plan, model: Light, data: Problem, begin: Point, aside: Neighbours) -> Solution:
    """`settle`, and again with more patience for those on a long way, where light falls by decades and each turn goes
    part of it. One that goes round in a circle gains nothing and ends."""
    found = settle(NUMPY, plan, model, data, begin, aside)
    far = np.flatnonzero(~found.converged & np.isfinite(found.cost))
    for _ in range(FURTHER if far.size else 0):
        rest = settle(NUMPY, plan, model, picked(data, far), picked(found.point, far), aside, most=MAX_STEPS)
        gains = rest.cost < found.cost[far] - GAINED
        found = replaced(found, far, rest)
        far = far[gains & ~rest.converged]
        if not far.size:
            break
    return found


def surely_poor(judged: Judged) -> NDArray[np.bool_]:
    """Rows whose χ² lies beyond chance."""
    poor: NDArray[np.bool_] = (judged.chi2 - 1) * np.sqrt(judged.n / 2) > SURELY_POOR
    return poor


def _eased(plan: Plan, model: Light, data: Problem, found: Solution) -> tuple[Solution, Judged]:
    """Where curves surely scatter by more than their errors say, and do not run to one side, they are weighed by that
    scatter and fitted again: against R and shared errors they counted too much."""
    judged = judge(plan, model, data, found)
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
    return found, judge(plan, model, data, found)


def _compared(
    model: Light, data: Problem, found: Solution, ended: Solution, again: NDArray[np.int_], rival: NDArray[np.float64]
) -> tuple[Solution, NDArray[np.float64]]:
    """The better of two optima of some rows, and the other as a rival where it is as good and elsewhere."""
    rival = rival.copy()
    ours, theirs = picked(found, again), ended
    old, new = _score(model, picked(data, again), ours), _score(model, picked(data, again), theirs)
    a, b = (np.concatenate(each.point, axis=1) for each in (ours, theirs))
    apart = (np.abs(_logs(ours.point) - _logs(theirs.point)) > DISTINCT).any(axis=1)
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


def _logs(point: Point) -> NDArray[np.float64]:
    """(b, 2): ln σt′ and ln q."""
    return np.concatenate([point.log_sigma, np.log(np.maximum(np.abs(point.q), 1e-3))], axis=1)


def _point(values: NDArray[np.float64]) -> Point:
    return Point(*(values[:, k : k + 1] for k in range(3)))
