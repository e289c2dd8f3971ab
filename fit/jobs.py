"""From jobs to the terms of their objective: which can share a batch, whether R counts, which errors they share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from bssrdf.errors import InputError
from bssrdf.fit.compiled import FROM
from bssrdf.fit.layout import Curves, curves_of, factor_of, nodes_of, points_of, sight_of, total_of
from bssrdf.fit.models import ModelName
from bssrdf.fit.problem import (
    OF_MEDIUM,
    Constraint,
    Neighbours,
    Plan,
    Problem,
    Sds,
    Shared,
    Source,
)
from bssrdf.holding import held, samples_of
from bssrdf.session.records import Slice
from bssrdf.transport import Policy
from bssrdf.transport.light import Light
from bssrdf.transport.light_errors import EXIT_MODES, SIDE_MODES, TABLE_MODES
from bssrdf.transport.observed import Sight

POINTS = 205_000
"""Radii that a batch looks at together: more would not fit the caches, with fewer each call of NumPy costs too much."""
MOST_ROWS = 1024
_BY_TILE: tuple[Source, ...] = ("scale", "length", "view")
_DEPTH, _BACK = ("thickness", "thickness_rel_sd", "radius"), ("back", "back_sd")
"""Of `Held`: what slices of one sample have in common."""


@dataclass(frozen=True)
class FitOptions:
    """What the caller asked for; None leaves the choice to the data."""

    model: ModelName = "auto"
    constraint: Constraint | None = None
    """None is `soft` where R has an error, `exact` where it has none, `none` where R was not measured."""
    scale: Literal["given", "free"] = "given"
    window_mm: tuple[float, float] | None = None
    robust: bool = False
    """Huber's loss in place of squares; the fit is flagged."""
    tables: Policy = "make"
    """Which Monte Carlo tables may be used: all, those at hand, or those that ship."""


class Job(NamedTuple):
    """One channel of one slice, or of several that are fitted together."""

    pieces: tuple[Slice, ...]
    channel: str


class Cohort(NamedTuple):
    """Jobs that can share a batch, by their places."""

    places: list[int]
    compiled_for: int | None
    """Rows, where there are so many of the kind that compiling pays."""


def groups_of(jobs: Sequence[Job], options: FitOptions) -> list[Cohort]:
    """All jobs, each in one cohort."""
    groups: dict[Any, list[int]] = {}
    for at, job in enumerate(jobs):
        groups.setdefault(_key(job, options), []).append(at)
    alike = [same for places in groups.values() for same in _of_equal_nodes(jobs, places, options)]
    found = []
    for places in alike:
        rows = _rows_of(jobs[places[0]], options)
        compiled_for = rows if len(places) >= FROM else None
        found += [Cohort(places[k : k + rows], compiled_for) for k in range(0, len(places), rows)]
    return found


def _rows_of(job: Job, options: FitOptions) -> int:
    """How many jobs like this one go through together."""
    curves = [curves_of([piece], [job.channel], options.window_mm) for piece in job.pieces]
    sights = [sight_of(piece, c) for piece, c in zip(job.pieces, curves, strict=True)]
    points = sum(points_of(sight, c.r_lo.shape[1]) for sight, c in zip(sights, curves, strict=True))
    return min(max(POINTS // points, 1), MOST_ROWS)


def _of_equal_nodes(jobs: Sequence[Job], places: list[int], options: FitOptions) -> list[list[int]]:
    """The places by how finely their slices are averaged: a fit must not depend on those beside it."""
    first = jobs[places[0]]
    parts = [piece.channels[first.channel] for piece in first.pieces]
    if all(part.r_lo_mm is None for part in parts) and all(piece.spot_radius_mm is None for piece in first.pieces):
        return [places]
    groups: dict[Any, list[int]] = {}
    for k in range(0, len(places), MOST_ROWS):
        some = places[k : k + MOST_ROWS]
        names = [jobs[at].channel for at in some]
        by_slice = zip(*(jobs[at].pieces for at in some), strict=True)
        nodes = [nodes_of(curves_of(pieces, names, options.window_mm)) for pieces in by_slice]
        blurred = np.any([each.blurred for each in nodes], axis=0)
        near = [np.where(blurred, each.blur_inner, 0) for each in nodes]
        for at, *key in zip(some, blurred.tolist(), *(each.inner for each in nodes), *near, strict=True):
            groups.setdefault(tuple(key), []).append(at)
    return list(groups.values())


def _key(job: Job, options: FitOptions) -> Any:
    """What the jobs of a batch have in common."""
    parts = [piece.channels[job.channel] for piece in job.pieces]
    size = math.ceil(math.log2(max(len(part.r_mm) for part in parts)))
    binned = tuple(part.r_lo_mm is not None for part in parts)
    several = (_sharing(job), _alike(job, *_DEPTH), _alike(job, *_BACK)) if len(parts) > 1 else ()
    return (tuple(map(_kind, job.pieces)), size, binned, _totals_of(job, options.constraint), several)


def _kind(piece: Slice) -> tuple[Any, ...]:
    """All of a slice that its model, its sight and its shared errors hang on, but for their sizes."""
    seen = piece.exit, piece.flux, piece.view_angle_deg, piece.incidence_deg, piece.azimuth
    stated = tuple(sd > 0 for sd in _sds_of(piece))
    return (piece.eta, piece.g, seen, piece.spot_radius_mm is not None, stated, held(piece).kind)


def _sharing(job: Job) -> tuple[int, ...]:
    """For each slice the place of the first with the same `shared_errors`, else its own."""
    ids = [piece.shared_errors for piece in job.pieces]
    return tuple(ids.index(name) if name is not None else at for at, name in enumerate(ids))


def _alike(job: Job, *keys: str) -> tuple[int, ...]:
    """For each slice the place of the first whose sample is held alike, in these respects: they share the error."""
    found = [[getattr(held(piece), key) for key in keys] for piece in job.pieces]
    return tuple(found.index(each) for each in found)


def _totals_of(job: Job, asked: Constraint | None) -> tuple[bool, tuple[int, ...]]:
    """Whether R is a condition, and the slices whose R counts: as asked, else by whether R has an error."""
    name = job.channel
    sds = {at: p.total_r_sd.get(name, 0.0) for at, p in enumerate(job.pieces) if name in p.total_r}
    weighed = [at for at, sd in sds.items() if sd > 0]
    if asked in ("exact", "soft") and not sds:
        raise InputError(f"constraint {asked} needs total_r for channel {name}: give it, or --constraint none")
    if asked == "soft" and not weighed:
        raise InputError(f"constraint soft needs total_r_sd for channel {name}: give it, or --constraint exact")
    if asked == "none" or not sds:
        return False, ()
    exact = asked == "exact" or not weighed
    once: dict[Any, int] = {}  # one R against the same tile with the same value counts once
    for at in sds if exact else weighed:
        piece = job.pieces[at]
        once.setdefault((piece.shared_errors, piece.total_r[name], sds[at]) if piece.shared_errors else at, at)
    if exact and len(once) > 1:
        raise InputError(f"R of channel {name} has no error: give total_r_sd to weigh it, or --constraint none")
    return exact, tuple(once.values())


def problem_of(jobs: Sequence[Job], options: FitOptions, model: Light, aside: Neighbours) -> tuple[Plan, Problem]:
    """The terms of jobs of one key."""
    first, names = jobs[0], [job.channel for job in jobs]
    pieces = first.pieces
    by_slice = list(zip(*(job.pieces for job in jobs), strict=True))
    curves = [curves_of(each, names, options.window_mm) for each in by_slice]
    sights = [sight_of(piece, c) for piece, c in zip(pieces, curves, strict=True)]
    if any(sight.blurred for sight in sights):  # a slice in parts is blurred as the whole is
        sights = [sight_of(p, c, blurred=bool(c.spot_radius.any())) for p, c in zip(pieces, curves, strict=True)]
    sds = tuple(
        Sds(*(np.array([[sd] for sd in of]) for of in zip(*map(_sds_of, each), strict=True))) for each in by_slice
    )
    exact, totals = _totals_of(first, options.constraint)
    plan = Plan(
        totals=totals,
        exact=exact,
        scale_free=options.scale == "free",
        robust=options.robust,
        sights=tuple(sights),
        shared=_shared(first, sights, sds, curves, model, aside),
    )
    measured = tuple(total_of(by_slice[k], names) for k in totals)
    samples = tuple(
        () if sight.held == "half" else samples_of(each) for sight, each in zip(sights, by_slice, strict=True)
    )
    return plan, Problem(tuple(curves), measured, sds, tuple(_factor_slopes(piece) for piece in pieces), samples)


def _sds_of(piece: Slice) -> Sds:
    sample = held(piece)
    return Sds(
        scale=piece.scale_rel_sd or 0.0,
        length=piece.mm_rel_sd or 0.0,
        spot=(piece.spot_radius_sd_mm or 0.0) / (piece.spot_radius_mm or 1.0),
        view=math.radians(piece.view_angle_sd_deg or 0.0),
        eta=piece.eta_sd or 0.0,
        g=piece.g_sd or 0.0,
        thickness=sample.thickness_rel_sd,
        back=sample.back_sd,
    )


def _shared(
    job: Job, sights: Sequence[Sight], sds: Sequence[Sds], curves: Sequence[Curves], model: Light, aside: Neighbours
) -> tuple[Shared, ...]:
    """The columns that the slices' stated errors and the model's own need."""
    sharing = _sharing(job)
    every = tuple(range(len(sights)))
    found: list[Shared] = []

    def touched(places: Sequence[int], source: str) -> tuple[int, ...]:
        return tuple(k for k in places if getattr(sds[k], source).any())

    def by_group(source: Source, same: tuple[int, ...], among: Sequence[int] = every) -> list[Shared]:
        groups = [touched([k for k in among if same[k] == first], source) for first in sorted(set(same))]
        return [Shared(source, places) for places in groups if places]

    filmed = [k for k in every if sights[k].camera]
    for source in _BY_TILE:
        found += by_group(source, sharing, filmed if source == "view" else every)
    found += [Shared("spot", (k,)) for k in touched([k for k in every if sights[k].blurred], "spot")]
    found += by_group("thickness", _alike(job, *_DEPTH)) + by_group("back", _alike(job, *_BACK))
    finite = tuple(k for k in every if sights[k].held != "half")
    found += [Shared("ratio", finite)] if finite else []
    found += [Shared(source, every) for source in OF_MEDIUM if source in aside and touched(every, source)]
    if filmed and model.exit_error_mfp > 0:
        found += [Shared("exit", tuple(filmed), mode) for mode in range(EXIT_MODES)]
    if not model.biased:
        found += [Shared("side", (k,), mode) for k in filmed if sights[k].slant > 0 for mode in range(SIDE_MODES)]
        found += [Shared("table", every, mode) for mode in range(TABLE_MODES)]
    return tuple(found)


def _factor_slopes(piece: Slice) -> tuple[float, float]:
    """d ln of the convention's factor by view angle [1/rad] and by η, by differences."""
    angle, eta = 0.1, 1e-3
    by_view = 0.0
    if piece.exit == "fresnel":
        lo, hi = max(piece.view_angle_deg - angle, 0.0), min(piece.view_angle_deg + angle, 89.9)
        ends = [math.log(factor_of(piece, view_angle_deg=each)) for each in (lo, hi)]
        by_view = (ends[1] - ends[0]) / math.radians(hi - lo)
    by_eta = [math.log(factor_of(piece, eta=piece.eta + each)) for each in (-eta, eta)]
    return by_view, (by_eta[1] - by_eta[0]) / (2 * eta)
