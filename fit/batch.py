"""Problems of one kind, found and judged together: from slices to optima. Nothing here opens a file."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.fit.compiled import FROM, settled
from bssrdf.fit.errors import SCATTERED, Judged, judge
from bssrdf.fit.holding import Held, held, samples_of
from bssrdf.fit.layout import Curves, camera_factor, curves_of, nodes_of, sight_of, total_of
from bssrdf.fit.models import Making, beam_of, beside, table_of_medium
from bssrdf.fit.problem import (
    EXIT_MODES,
    TABLE_MODES,
    Constraint,
    Neighbours,
    Plan,
    Point,
    Problem,
    Sds,
    Shared,
    Source,
)
from bssrdf.fit.solve import REST, Solution, optimise, settle, start, starts_of
from bssrdf.session.records import Slice
from bssrdf.transport import NORMAL, Policy
from bssrdf.transport.arrays import NUMPY, picked, replaced
from bssrdf.transport.light import Light, dipole

BATCH = 256
"""Rows that go through together: more would not fit the caches."""
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


_BY_TILE: tuple[Source, ...] = ("scale", "length", "view")
_OF_MEDIUM: tuple[Source, ...] = ("eta", "g")


class Options(NamedTuple):
    """What the caller asked for, as far as one problem is concerned."""

    constraint: Constraint | None
    scale_free: bool
    robust: bool
    window_mm: tuple[float, float] | None
    tables: Policy


class Job(NamedTuple):
    """One channel of one slice, or of several that are fitted together."""

    pieces: tuple[Slice, ...]
    channel: str


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


def groups_of(jobs: Sequence[Job], options: Options) -> list[tuple[list[int], bool]]:
    """Places of the jobs that can share a batch, and whether there are so many of their kind that compiling pays."""
    groups: dict[Any, list[int]] = {}
    for at, job in enumerate(jobs):
        groups.setdefault(_key(job, options), []).append(at)
    alike = [same for places in groups.values() for same in _of_equal_nodes(jobs, places, options)]
    return [(places[k : k + BATCH], len(places) >= FROM) for places in alike for k in range(0, len(places), BATCH)]


def _of_equal_nodes(jobs: Sequence[Job], places: list[int], options: Options) -> list[list[int]]:
    """The places by how finely their slices are averaged: a fit must not depend on those beside it."""
    first = jobs[places[0]]
    parts = [piece.channels[first.channel] for piece in first.pieces]
    if all(part.r_lo_mm is None for part in parts) and all(piece.spot_radius_mm is None for piece in first.pieces):
        return [places]
    groups: dict[Any, list[int]] = {}
    for k in range(0, len(places), BATCH):
        some = places[k : k + BATCH]
        names = [jobs[at].channel for at in some]
        by_slice = zip(*(jobs[at].pieces for at in some), strict=True)
        nodes = [nodes_of(curves_of(pieces, names, options.window_mm)) for pieces in by_slice]
        blurred = np.any([each.blurred for each in nodes], axis=0)
        near = [np.where(blurred, each.blur_inner, 0) for each in nodes]
        for at, *key in zip(some, blurred.tolist(), *(each.inner for each in nodes), *near, strict=True):
            groups.setdefault(tuple(key), []).append(at)
    return list(groups.values())


def _key(job: Job, options: Options) -> Any:
    first = job.pieces[0]
    seen = tuple((p.exit, p.flux, p.view_angle_deg, p.incidence_deg, p.azimuth) for p in job.pieces)
    size = math.ceil(math.log2(max(len(p.channels[job.channel].r_mm) for p in job.pieces)))
    binned = tuple(p.channels[job.channel].r_lo_mm is not None for p in job.pieces)
    spot = tuple(p.spot_radius_mm is not None for p in job.pieces)
    stated = tuple(_stated(piece) for piece in job.pieces)
    constraint = _constraint(job, options.constraint)
    totals = _totals(job, constraint)
    samples = tuple(held(piece).kind for piece in job.pieces), _same(job, _depth_of), _same(job, _back_of)
    return (first.eta, first.g, seen, binned, spot, stated, _sharing(job), constraint, totals, size, samples)


def _stated(piece: Slice) -> tuple[bool, ...]:
    lengths = (piece.scale_rel_sd, piece.mm_rel_sd, piece.spot_radius_sd_mm, piece.view_angle_sd_deg)
    one = held(piece)
    return tuple(bool(sd) for sd in (*lengths, piece.eta_sd, piece.g_sd, one.thickness_rel_sd, one.back_sd))


def _sharing(job: Job) -> tuple[int, ...]:
    """For each slice the place of the first with the same `shared_errors`, else its own."""
    ids = [piece.shared_errors for piece in job.pieces]
    return tuple(ids.index(name) if name is not None else at for at, name in enumerate(ids))


def _same(job: Job, of: Callable[[Held], tuple[float, ...]]) -> tuple[int, ...]:
    """For each slice the place of the first whose sample is held alike, in this respect: they share its error."""
    found = [of(held(piece)) for piece in job.pieces]
    return tuple(found.index(each) for each in found)


def _depth_of(one: Held) -> tuple[float, ...]:
    return one.thickness, one.thickness_rel_sd, one.radius


def _back_of(one: Held) -> tuple[float, ...]:
    return one.back, one.back_sd


def _constraint(job: Job, asked: Constraint | None) -> Constraint:
    known = [job.channel in piece.total_r for piece in job.pieces]
    with_sd = [piece.total_r_sd.get(job.channel, 0.0) > 0 for piece in job.pieces]
    if asked in ("exact", "soft") and not any(known):
        raise InputError(f"constraint {asked} needs total_r for channel {job.channel}: give it, or --constraint none")
    if asked == "soft" and not any(with_sd):
        raise InputError(f"constraint soft needs total_r_sd for channel {job.channel}: give it, or --constraint exact")
    chosen = asked or ("none" if not any(known) else "soft" if any(with_sd) else "exact")
    if chosen == "exact" and len(_totals(job, chosen)) > 1:
        raise InputError(f"R of channel {job.channel} has no error: give total_r_sd to weigh it, or --constraint none")
    return chosen


def _totals(job: Job, constraint: Constraint) -> tuple[int, ...]:
    """The slices whose R counts: one against the same tile with the same value counts once."""
    chosen: dict[Any, int] = {}
    if constraint == "none":
        return ()
    for at, piece in enumerate(job.pieces):
        if job.channel not in piece.total_r:
            continue
        sd = piece.total_r_sd.get(job.channel, 0.0)
        if constraint == "soft" and not sd > 0:
            continue
        own = (piece.shared_errors, piece.total_r[job.channel], sd) if piece.shared_errors else at
        chosen.setdefault(own, at)
    return tuple(chosen.values())


def fit_group(
    jobs: Sequence[Job],
    options: Options,
    name: Literal["dipole", "mc"],
    making: Making,
    *,
    compile_it: bool = False,
    model: Light | None = None,
    begin: Point | None = None,
) -> Fitted:
    """Fit jobs of one key, at most BATCH, by one model; with `compile_it` by JAX, which pays for many batches.

    `model` stands in for the named one, where a comparison asks for other weights or another window; `begin` for all
    starts, where a medium next to this was fitted.
    """
    piece = jobs[0].pieces[0]
    if model is None:
        model = dipole(piece.eta) if name == "dipole" else table_of_medium(piece, options.tables, making)
    aside = beside(name, piece.eta, piece.g) if beam_of(piece) == NORMAL else {}
    plan, data = problem_of(jobs, options, model, aside)
    if begin is None:
        found, rival = _best(plan, model, data, aside, compile_it=compile_it)
    else:
        found = settle(NUMPY, plan, model, data, begin, aside)
        rival = Point(*(np.full_like(each, np.nan) for each in begin))
    found, judged = _eased(plan, model, data, found)
    return Fitted(jobs, options, plan, model, aside, data, found, judged, rival)


def problem_of(jobs: Sequence[Job], options: Options, model: Light, aside: Neighbours) -> tuple[Plan, Problem]:
    """The terms of jobs of one key."""
    first, names = jobs[0], [job.channel for job in jobs]
    pieces = first.pieces
    by_slice = list(zip(*(job.pieces for job in jobs), strict=True))
    curves = [curves_of(each, names, options.window_mm) for each in by_slice]
    sights = [sight_of(piece, c) for piece, c in zip(pieces, curves, strict=True)]
    if any(sight.blurred for sight in sights):  # a slice in parts is blurred as the whole is
        sights = [sight_of(p, c, blurred=bool(c.spot_radius.any())) for p, c in zip(pieces, curves, strict=True)]
    constraint = _constraint(first, options.constraint)
    sds = tuple(_sds(each) for each in by_slice)
    totals = _totals(first, constraint)
    plan = Plan(
        totals=totals,
        exact=constraint == "exact",
        scale_free=options.scale_free,
        robust=options.robust,
        sights=tuple(sights),
        shared=_shared(first, sights, sds, curves, model, aside),
    )
    measured = tuple(total_of(by_slice[k], names) for k in totals)
    samples = tuple(
        () if sight.held == "half" else samples_of(each) for sight, each in zip(sights, by_slice, strict=True)
    )
    return plan, Problem(tuple(curves), measured, sds, tuple(_factor_slopes(piece) for piece in pieces), samples)


def _sds(pieces: Sequence[Slice]) -> Sds:
    def column(values: Sequence[float | None]) -> NDArray[np.float64]:
        return np.array([[value or 0.0] for value in values])

    return Sds(
        scale=column([p.scale_rel_sd for p in pieces]),
        length=column([p.mm_rel_sd for p in pieces]),
        spot=column([(p.spot_radius_sd_mm or 0.0) / (p.spot_radius_mm or 1.0) for p in pieces]),
        view=np.radians(column([p.view_angle_sd_deg for p in pieces])),
        eta=column([p.eta_sd for p in pieces]),
        g=column([p.g_sd for p in pieces]),
        thickness=column([held(p).thickness_rel_sd for p in pieces]),
        back=column([held(p).back_sd for p in pieces]),
    )


def _shared(
    job: Job, sights: Sequence[Any], sds: Sequence[Sds], curves: Sequence[Curves], model: Light, aside: Neighbours
) -> tuple[Shared, ...]:
    """The columns that the slices' stated errors and the model's own need."""
    sharing = _sharing(job)
    every = tuple(range(len(sights)))
    found: list[Shared] = []

    def touched(places: Sequence[int], source: str) -> tuple[int, ...]:
        return tuple(k for k in places if getattr(sds[k], source).any())

    for source in _BY_TILE:
        for first in sorted(set(sharing)):
            places = touched([k for k in every if sharing[k] == first], source)
            if source == "view":
                places = tuple(k for k in places if sights[k].camera)
            if places:
                found.append(Shared(source, places))
    found += [Shared("spot", (k,)) for k in touched([k for k in every if sights[k].blurred], "spot")]
    for source, same in (("thickness", _same(job, _depth_of)), ("back", _same(job, _back_of))):
        for first in sorted(set(same)):
            places = touched([k for k in every if same[k] == first], source)
            if places:
                found.append(Shared(source, places))
    finite = tuple(k for k in every if sights[k].held != "half")
    found += [Shared("ratio", finite)] if finite else []
    for source in _OF_MEDIUM:
        if source in aside and touched(every, source):
            found.append(Shared(source, every))
    slanted = tuple(k for k in every if sights[k].camera and (curves[k].arc < 1.5).any())
    if slanted and model.exit_error_mfp > 0:
        found += [Shared("exit", slanted, mode) for mode in range(EXIT_MODES)]
    if model.name == "mc":
        found += [Shared("table", every, mode) for mode in range(TABLE_MODES)]
    return tuple(found)


def _factor_slopes(piece: Slice) -> tuple[float, float]:
    """d ln of the convention's factor by view angle [1/rad] and by η, by differences."""
    angle, eta = 0.1, 1e-3
    by_view = 0.0
    if piece.exit == "fresnel":
        lo, hi = max(piece.view_angle_deg - angle, 0.0), min(piece.view_angle_deg + angle, 89.9)
        ends = [math.log(camera_factor(piece, view_deg=each)) for each in (lo, hi)]
        by_view = (ends[1] - ends[0]) / math.radians(hi - lo)
    by_eta = [math.log(camera_factor(piece, eta=piece.eta + each)) for each in (-eta, eta)]
    return by_view, (by_eta[1] - by_eta[0]) / (2 * eta)


def _best(plan: Plan, model: Light, data: Problem, aside: Neighbours, *, compile_it: bool) -> tuple[Solution, Point]:
    """The lowest of the optima reached from several starts, and one as good at another place."""
    every, more = starts_of(plan)
    b = data.curves[0].r_lo.shape[0]
    rival = np.full((b, 3), np.nan)
    rows = np.arange(b)
    if compile_it and len(every) == 1:
        found, others = settled(plan, model, data, aside, BATCH), []
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
    lost = (every / np.maximum(count, 1)) ** 2 if model.name == "mc" else 1.0
    score: NDArray[np.float64] = np.where(count > 0, found.cost / np.maximum(count, 1) * lost, np.inf)
    return score


def _count(found: Solution) -> NDArray[np.float64]:
    counted: NDArray[np.float64] = sum((mass > 0).sum(1) for mass in found.weights.mass).astype(float)
    return counted


def _logs(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([points[:, 0], np.log(np.maximum(np.abs(points[:, 1]), 1e-3))], axis=1)


def _point(values: NDArray[np.float64]) -> Point:
    return Point(*(values[:, k : k + 1] for k in range(3)))
