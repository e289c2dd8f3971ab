"""From jobs to the terms of their objective: which can share a batch, whether R counts, which errors they share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.fit.compiled import FROM
from bssrdf.fit.holding import Held, held, samples_of
from bssrdf.fit.layout import Curves, Sight, camera_factor, curves_of, nodes_of, points_of, sight_of, total_of
from bssrdf.fit.problem import (
    EXIT_MODES,
    OF_MEDIUM,
    SIDE_MODES,
    TABLE_MODES,
    Constraint,
    Neighbours,
    Plan,
    Problem,
    Sds,
    Shared,
    Source,
)
from bssrdf.session.records import Slice
from bssrdf.transport import Policy
from bssrdf.transport.light import Light

POINTS = 130_000
"""Radii that a batch looks at together: more would not fit the caches, with fewer each call of NumPy costs too much."""
MOST_ROWS = 1024
_BY_TILE: tuple[Source, ...] = ("scale", "length", "view")
_WHOLE_CIRCLE = 1.5
"""Radians of arc from which on a slice is a mean over all azimuths."""


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


class _Totals(NamedTuple):
    """Whether R is a condition, and the slices whose R counts."""

    exact: bool
    places: tuple[int, ...]


class Cohort(NamedTuple):
    """Jobs that can share a batch, by their places."""

    places: list[int]
    compiled_for: int | None
    """Rows, where there are so many of the kind that compiling pays."""


def groups_of(jobs: Sequence[Job], options: Options) -> list[Cohort]:
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


def _rows_of(job: Job, options: Options) -> int:
    """How many jobs like this one go through together."""
    curves = [curves_of([piece], [job.channel], options.window_mm) for piece in job.pieces]
    sights = [sight_of(piece, c) for piece, c in zip(job.pieces, curves, strict=True)]
    points = sum(points_of(sight, c.r_lo.shape[1]) for sight, c in zip(sights, curves, strict=True))
    return min(max(POINTS // points, 1), MOST_ROWS)


def _of_equal_nodes(jobs: Sequence[Job], places: list[int], options: Options) -> list[list[int]]:
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


def _key(job: Job, options: Options) -> Any:
    first = job.pieces[0]
    seen = tuple((p.exit, p.flux, p.view_angle_deg, p.incidence_deg, p.azimuth) for p in job.pieces)
    size = math.ceil(math.log2(max(len(p.channels[job.channel].r_mm) for p in job.pieces)))
    binned = tuple(p.channels[job.channel].r_lo_mm is not None for p in job.pieces)
    spot = tuple(p.spot_radius_mm is not None for p in job.pieces)
    stated = tuple(_stated(piece) for piece in job.pieces)
    totals = _totals_of(job, options.constraint)
    samples = tuple(held(piece).kind for piece in job.pieces), _same(job, _depth_of), _same(job, _back_of)
    return (first.eta, first.g, seen, binned, spot, stated, _sharing(job), totals, size, samples)


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


def _totals_of(job: Job, asked: Constraint | None) -> _Totals:
    """By what was asked for, else by whether R has an error."""
    known = {at: piece.total_r_sd.get(job.channel, 0.0) for at, piece in _with_total(job)}
    weighed = [at for at, sd in known.items() if sd > 0]
    if asked in ("exact", "soft") and not known:
        raise InputError(f"constraint {asked} needs total_r for channel {job.channel}: give it, or --constraint none")
    if asked == "soft" and not weighed:
        raise InputError(f"constraint soft needs total_r_sd for channel {job.channel}: give it, or --constraint exact")
    if asked == "none" or not known:
        return _Totals(False, ())
    exact = asked == "exact" or not weighed
    places = _told_once(job, known if exact else weighed)
    if exact and len(places) > 1:
        raise InputError(f"R of channel {job.channel} has no error: give total_r_sd to weigh it, or --constraint none")
    return _Totals(exact, places)


def _with_total(job: Job) -> Iterator[tuple[int, Slice]]:
    return ((at, piece) for at, piece in enumerate(job.pieces) if job.channel in piece.total_r)


def _told_once(job: Job, places: Iterable[int]) -> tuple[int, ...]:
    """One R against the same tile with the same value counts once."""
    chosen: dict[Any, int] = {}
    for at in places:
        piece = job.pieces[at]
        told = (piece.shared_errors, piece.total_r[job.channel], piece.total_r_sd.get(job.channel, 0.0))
        chosen.setdefault(told if piece.shared_errors else at, at)
    return tuple(chosen.values())


def problem_of(jobs: Sequence[Job], options: Options, model: Light, aside: Neighbours) -> tuple[Plan, Problem]:
    """The terms of jobs of one key."""
    first, names = jobs[0], [job.channel for job in jobs]
    pieces = first.pieces
    by_slice = list(zip(*(job.pieces for job in jobs), strict=True))
    curves = [curves_of(each, names, options.window_mm) for each in by_slice]
    sights = [sight_of(piece, c) for piece, c in zip(pieces, curves, strict=True)]
    if any(sight.blurred for sight in sights):  # a slice in parts is blurred as the whole is
        sights = [sight_of(p, c, blurred=bool(c.spot_radius.any())) for p, c in zip(pieces, curves, strict=True)]
    sds = tuple(_sds(each) for each in by_slice)
    totals = _totals_of(first, options.constraint)
    plan = Plan(
        totals=totals.places,
        exact=totals.exact,
        scale_free=options.scale_free,
        robust=options.robust,
        sights=tuple(sights),
        shared=_shared(first, sights, sds, curves, model, aside),
    )
    measured = tuple(total_of(by_slice[k], names) for k in totals.places)
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
    found += by_group("thickness", _same(job, _depth_of)) + by_group("back", _same(job, _back_of))
    finite = tuple(k for k in every if sights[k].held != "half")
    found += [Shared("ratio", finite)] if finite else []
    found += [Shared(source, every) for source in OF_MEDIUM if source in aside and touched(every, source)]
    slanted = tuple(k for k in filmed if (curves[k].arc < _WHOLE_CIRCLE).any())
    if slanted and model.exit_error_mfp > 0:
        found += [Shared("exit", slanted, mode) for mode in range(EXIT_MODES)]
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
        ends = [math.log(camera_factor(piece, view_deg=each)) for each in (lo, hi)]
        by_view = (ends[1] - ends[0]) / math.radians(hi - lo)
    by_eta = [math.log(camera_factor(piece, eta=piece.eta + each)) for each in (-eta, eta)]
    return by_view, (by_eta[1] - by_eta[0]) / (2 * eta)
