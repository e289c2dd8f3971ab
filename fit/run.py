"""Fit slices: choose the model, ask what else would fit, and report each channel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bssrdf.errors import InputError
from bssrdf.fit.batch import Fitted, fit_group, surely_poor
from bssrdf.fit.intervals import Profile, profile
from bssrdf.fit.jobs import FitOptions, Job, groups_of
from bssrdf.fit.models import DIPOLE_BEST, DIPOLE_SHARE, Truth, named, table_key, truth_of
from bssrdf.fit.neighbours import TableSays, bias, dipole_on_light, fewer, sample_error, sensitivities, table_error
from bssrdf.fit.sample_verdict import thin_rows
from bssrdf.fit.verdict import FEWEST, Extra, channel_fits, needs_profile, relative_sds
from bssrdf.session.flags import Flag
from bssrdf.session.records import ChannelFit, Slice
from bssrdf.transport import NORMAL, SILENT, Making, has_light_table, shipped_table, tabulated
from bssrdf.transport.light import Light, coefficients, dipole

OTHER_G = (0.0, 0.35, 0.6, 0.8, 0.9)
ETA_AWAY = 0.1
"""Tried where a curve does not fit: does another g or η?"""
SPOTS_MFP = (0.25, 0.5, 1.0)
"""1/e² radii tried likewise, where none is stated."""
MUCH_BETTER = 0.5
"""Of χ²: below this share another g, η or spot is more likely than the one given."""
DEFAULT = FitOptions()


def fit_slices(
    slices: Sequence[Slice], options: FitOptions = DEFAULT, *, making: Making = SILENT
) -> list[dict[str, ChannelFit]]:
    """Fit every channel of every slice.

    Returns, in order, a `ChannelFit` by channel for each slice. A fit that fails says so in its `status` and `flags`;
    raises InputError where the options ask for what a slice does not hold, or a channel has no radius. `making` is
    told of a table that has to be made first.
    """
    jobs = [Job((piece,), channel) for piece in slices for channel in piece.channels]
    fits = iter(_fit_jobs(jobs, options, making))
    return [{channel: next(fits) for channel in piece.channels} for piece in slices]


def fit_slice(piece: Slice, options: FitOptions = DEFAULT) -> dict[str, ChannelFit]:
    """`fit_slices` for one slice."""
    return fit_slices([piece], options)[0]


def fit_joint(
    slices: Sequence[Slice], options: FitOptions = DEFAULT, *, making: Making = SILENT
) -> dict[str, ChannelFit]:
    """One fit by channel for all slices: σa and σs′ in common, and the errors of those with the same `shared_errors`.

    Raises InputError where they are not of one medium or cannot be joined.
    """
    first = slices[0]
    for piece in slices[1:]:
        for key in ("eta", "g"):
            ours, other = getattr(first, key), getattr(piece, key)
            if ours != other:
                raise InputError(f"{key} = {ours} in one slice and {other} in another: join slices of one medium only")
    if options.scale == "free" and len(slices) > 1:
        raise InputError("scale free leaves each slice its own factor: fit such slices one by one")
    shared = [name for name in first.channels if all(name in piece.channels for piece in slices)]
    if not shared:
        raise InputError("the slices have no channel in common: give slices with the same channel names")
    fits = _fit_jobs([Job(tuple(slices), name) for name in shared], options, making)
    return dict(zip(shared, fits, strict=True))


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # what is not finite is found in the result
def _fit_jobs(jobs: Sequence[Job], options: FitOptions, making: Making) -> list[ChannelFit]:
    if bare := {job.channel for job in jobs if not all(p.channels[job.channel].r_mm.size for p in job.pieces)}:
        raise InputError(f"channel {', '.join(sorted(bare))} of a slice has no radius: give R_d at five at least")
    fits: dict[int, ChannelFit] = {}
    for places, fitted in batches(jobs, options, making):
        fits |= dict(zip(places, channel_fits(fitted, extra_of(fitted, making)), strict=True))
    return [fits[at] for at in range(len(jobs))]


def batches(jobs: Sequence[Job], options: FitOptions, making: Making) -> Iterator[tuple[list[int], Fitted]]:
    """Batches with the places of their jobs, by the model asked for; with auto the dipole where it will do."""
    for places, rows in groups_of(jobs, options):
        members, piece = [jobs[at] for at in places], jobs[places[0]].pieces[0]
        auto, name = options.model == "auto", options.model
        if name == "auto":
            name = "mc" if has_light_table(*table_key(piece), options.tables) else "dipole"
        model = named(name, piece, options.tables, making)
        fitted = fit_group(members, options, model, compiled_for=rows)
        simple = np.flatnonzero(_dipole_will_do(fitted)) if auto and not model.biased else np.array([])
        if not simple.size:
            yield places, fitted
            continue
        rest = np.setdiff1d(np.arange(len(places)), simple)
        if rest.size:
            yield [places[row] for row in rest], fitted.part(rest)
        others = [members[row] for row in simple]
        again = fit_group(others, options, dipole(piece.eta), compiled_for=rows)
        yield [places[row] for row in simple], again


def _dipole_will_do(fitted: Fitted) -> np.ndarray:
    """The rule of `models.RULE`: whether the dipole, fitted to the table's light, finds its medium."""
    sd = relative_sds(fitted)
    good = fitted.found.converged & (sd > DIPOLE_BEST).all(axis=1)
    rows = np.flatnonzero(good)
    if rows.size:
        good[rows] = (dipole_on_light(fitted.part(rows)) < DIPOLE_SHARE * sd[rows]).all(axis=1)
    return good


def extra_of(fitted: Fitted, making: Making) -> Extra:
    """What further models say of a batch."""
    few, of_sample = fewer(fitted.plan, fitted.data), sample_error(fitted)
    extra = Extra(_profiled(fitted), sensitivities(fitted, few), _others(fitted))
    if not fitted.model.biased:
        return extra._replace(model_error=np.hypot(of_sample, table_error(fitted)))
    truth = truth_of(fitted.jobs[0].pieces[0], fitted.options.tables, making)
    if truth is None:
        return extra._replace(checked=False)
    found = bias(fitted, few, truth)
    says = _by_table(fitted, truth, found.doubtful) if truth.own and fitted.plan.weighed else None
    error = np.hypot(of_sample, found.error)
    return extra._replace(model_error=error, bias=found, checked=truth.own, of_table=says)


def _by_table(fitted: Fitted, truth: Truth, doubted: np.ndarray) -> TableSays:
    """The table's fit to the radii that the biased model takes, of rows in doubt: it sees far smaller contradictions,
    an R of another sample among them."""
    says = TableSays(np.zeros(doubted.size), np.zeros(doubted.size))
    rows = np.flatnonzero(doubted & fitted.found.converged & fitted.judged.errors_known & (fitted.judged.n >= FEWEST))
    if rows.size:
        table = truth.table._replace(window_mfp=fitted.model.window_mfp)
        part = fitted.part(rows)
        again = fit_group(part.jobs, fitted.options, table, begin=part.found.point)
        good = again.found.converged
        says.pull[rows] = np.where(good, again.judged.pull, 0.0)
        says.drift[rows] = np.where(good, again.judged.drift, np.inf)
    return says


def _profiled(fitted: Fitted) -> tuple[np.ndarray, Profile] | None:
    wanted = np.flatnonzero(needs_profile(fitted) & fitted.found.converged & (fitted.judged.n >= FEWEST))
    if not wanted.size:
        return None
    part = fitted.part(wanted)
    grown = np.where(
        part.judged.errors_known, part.judged.grown / part.found.ease, np.maximum(part.judged.chi2, 1e-300)
    )
    return wanted, profile(part.plan, part.model, part.data, part.found, grown)


def _others(fitted: Fitted) -> list[tuple[str, ...]]:
    """Flags of rows whose curve does not fit here and far better under another g, η or spot, with other
    coefficients."""
    raised: list[tuple[str, ...]] = [() for _ in fitted.jobs]
    poor = np.flatnonzero(surely_poor(fitted.judged) & fitted.found.converged & ~thin_rows(fitted))
    if not poor.size or fitted.model.biased or table_key(fitted.jobs[0].pieces[0]).beam != NORMAL:
        return raised
    part = fitted.part(poor)
    for flag, jobs, model in _readings(part):
        again = fit_group(jobs, part.options, model, begin=part.found.point)
        for row in poor[_fits_better(part, again)]:
            raised[row] = tuple(dict.fromkeys((*raised[row], flag)))
    return raised


def _readings(part: Fitted) -> Iterator[tuple[Flag, Sequence[Job], Light]]:
    """The same curves as of another medium, or of a spot where they state none."""
    piece = part.jobs[0].pieces[0]
    g = table_key(piece).g
    nodes = [(Flag.G_SUSPECT, piece.eta, other) for other in OTHER_G if abs(other - g) > 0.05]
    nodes += [(Flag.ETA_SUSPECT, piece.eta + step, g) for step in (-ETA_AWAY, ETA_AWAY)]
    for flag, eta, other in nodes:
        if tabulated(eta, other):
            yield flag, part.jobs, shipped_table(eta, other)
    if any(each.spot_radius_mm for each in part.jobs[0].pieces):
        return
    mfp = np.exp(-part.found.point.log_sigma[:, 0])
    for share in SPOTS_MFP:
        jobs = [
            job._replace(pieces=tuple(replace(each, spot_radius_mm=share * float(one)) for each in job.pieces))
            for job, one in zip(part.jobs, mfp, strict=True)
        ]
        yield Flag.SPOT_SUSPECT, jobs, part.model


def _fits_better(ours: Fitted, theirs: Fitted) -> np.ndarray:
    """Rows where theirs has so much less χ² with most of the radii, and a coefficient elsewhere than within their
    error: if they are right, nothing is left for which errors would have to grow."""
    far_better = theirs.judged.chi2 < MUCH_BETTER * ours.judged.chi2
    most = theirs.judged.n > ours.judged.n / 2
    a, b = (np.concatenate(coefficients(each.found.point.log_sigma, each.found.point.q), 1) for each in (ours, theirs))
    moved = np.abs(np.log(np.maximum(b, 1e-300) / np.maximum(a, 1e-300)))
    elsewhere = (moved > 1.96 * relative_sds(theirs)).any(axis=1)
    return np.asarray(theirs.found.converged & far_better & most & elsewhere)
