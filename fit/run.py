"""Fit slices: group their channels into batches of one shape, choose the model, and judge what comes back."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bssrdf.errors import InputError
from bssrdf.fit.batch import BATCH, Fitted, Group, fit_group, pick
from bssrdf.fit.choose import Announce, ModelName, tabulated
from bssrdf.fit.curves import bucket_of
from bssrdf.fit.kernel import Constraint, Task
from bssrdf.fit.model_error import chi2_by_g, model_errors, sensitivities
from bssrdf.fit.result import Job, channel_fit
from bssrdf.fit.spot import matters
from bssrdf.session.records import ChannelFit, Slice
from bssrdf.transport.precision import scoped_x64

OTHER_G = (0.0, 0.35, 0.6, 0.8, 0.9)
"""Tried where a curve does not fit: does another g?"""
MUCH_BETTER = 0.3
"""Of χ²: below this share another g is more likely than the one given."""


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


DEFAULT = FitOptions()


@scoped_x64
def fit_slices(
    slices: Sequence[Slice], options: FitOptions = DEFAULT, *, announce: Announce | None = None
) -> list[dict[str, ChannelFit]]:
    """Fit every channel of every slice.

    Returns, in order, a `ChannelFit` by channel for each slice. A fit that fails says so in its `status` and `flags`;
    raises InputError where the options ask for what a slice does not hold. `announce` is told the seconds that a table
    will take which has to be made first.
    """
    fits: dict[tuple[int, str], ChannelFit] = {}
    for fitted in fit_batches(slices, options, announce):
        fits |= {(job.at, job.channel): result for job, result in zip(fitted.jobs, _results(fitted), strict=True)}
    return [{channel: fits[at, channel] for channel in piece.channels} for at, piece in enumerate(slices)]


def fit_slice(piece: Slice, options: FitOptions = DEFAULT) -> dict[str, ChannelFit]:
    """`fit_slices` for one slice."""
    return fit_slices([piece], options)[0]


def fit_batches(slices: Sequence[Slice], options: FitOptions, announce: Announce | None) -> Iterator[Fitted]:
    """Batches by the model asked for; with auto the dipole's, less those that the table fits better."""
    jobs = [Job(at, piece, channel) for at, piece in enumerate(slices) for channel in piece.channels]
    if options.model != "auto":
        yield from _batches(jobs, options.model, options, announce)
        return
    rest: list[Job] = []
    for fitted in _batches(jobs, "dipole", options, announce):
        good = [_dipole_will_do(fitted, row, error) for row, error in enumerate(model_errors(fitted))]
        rest += [job for job, keep in zip(fitted.jobs, good, strict=True) if not keep]
        yield _subset(fitted, [row for row, keep in enumerate(good) if keep])
    yield from _batches(rest, "mc", options, announce)


def _dipole_will_do(fitted: Fitted, row: int, error: dict[str, float]) -> bool:
    """The rule of `choose.RULE`; where no table ships the dipole is taken, and flagged."""
    if not tabulated(fitted.group.eta, fitted.group.g):
        return True
    judged = pick(fitted.judged, row)
    sd_a, sd_sp = judged.sigma_a_sd / judged.sigma_a, judged.sigma_sp_sd / judged.sigma_sp
    return bool(error["sigma_a"] < sd_a and error["sigma_sp"] < sd_sp)


def _subset(fitted: Fitted, rows: list[int]) -> Fitted:
    at = np.asarray(rows, int)
    return fitted._replace(
        jobs=[fitted.jobs[row] for row in rows],
        data=pick(fitted.data, at),
        judged=pick(fitted.judged, at),
        profiles={new: fitted.profiles[old] for new, old in enumerate(rows) if old in fitted.profiles},
    )


def _batches(
    jobs: Sequence[Job], model: Literal["dipole", "mc"], options: FitOptions, announce: Announce | None
) -> Iterator[Fitted]:
    groups: dict[Group, list[Job]] = defaultdict(list)
    for job in jobs:
        width = bucket_of(len(job.piece.channels[job.channel].r_mm))
        groups[Group(_task(job, options), model, job.piece.eta, job.piece.g, width)].append(job)
    for group, members in groups.items():
        for first in range(0, len(members), BATCH):
            yield fit_group(group, members[first : first + BATCH], options.window_mm, announce)


def _results(fitted: Fitted) -> list[ChannelFit]:
    if not fitted.jobs:
        return []
    errors, slopes = model_errors(fitted), sensitivities(fitted)
    results = [
        channel_fit(fitted.group, job, pick(fitted.judged, row), fitted.profiles.get(row), errors[row], slopes[row])
        for row, job in enumerate(fitted.jobs)
    ]
    poor = [row for row, result in enumerate(results) if "poor_fit" in result.flags]
    if fitted.group.model == "mc" and poor and tabulated(fitted.group.eta, fitted.group.g):
        own = fitted.judged.chi2 * fitted.judged.solution.counts.sum(axis=1)
        better = chi2_by_g(fitted, OTHER_G).min(axis=0) < MUCH_BETTER * own
        for row in poor:
            if better[row]:
                results[row] = replace(results[row], flags=(*results[row].flags, "g_suspect"))
    return results


def _task(job: Job, options: FitOptions) -> Task:
    channel = job.piece.channels[job.channel]
    known = bool(np.all(channel.sd_per_mm2 > 0))
    relative_sd = (
        float(np.median(channel.sd_per_mm2 / np.maximum(np.abs(channel.rd_per_mm2), 1e-300))) if known else 0.01
    )
    return Task(
        constraint=_constraint(job, options.constraint),
        scale_free=options.scale == "free",
        binned=channel.r_lo_mm is not None,
        errors_known=known,
        blurred=matters(job.piece.spot_radius_mm or 0.0, channel.r_mm, relative_sd),
        camera=job.piece.exit == "fresnel",
        robust=options.robust,
    )


def _constraint(job: Job, asked: Constraint | None) -> Constraint:
    known = job.channel in job.piece.total_r
    sd = job.piece.total_r_sd.get(job.channel, 0.0)
    if asked in ("exact", "soft") and not known:
        raise InputError(f"constraint {asked} needs total_r for channel {job.channel}: give it, or --constraint none")
    if asked == "soft" and not sd > 0:
        raise InputError(f"constraint soft needs total_r_sd for channel {job.channel}: give it, or --constraint exact")
    return asked or ("none" if not known else "soft" if sd > 0 else "exact")
