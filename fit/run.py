"""Fit slices: group their channels into batches of one shape, run the kernel, and judge what comes back."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from bssrdf.errors import InputError
from bssrdf.fit.curves import Curves, bucket_of, stack
from bssrdf.fit.intervals import Profile, profile_batch
from bssrdf.fit.kernel import Common, Constraint, Judged, Task, fit_batch
from bssrdf.fit.result import Job, channel_fit, factor_of, needs_profile
from bssrdf.session.records import ChannelFit, Slice
from bssrdf.transport.forward import DipoleModel, ForwardModel
from bssrdf.transport.precision import scoped_x64

BATCHES = (4, 64, 1024)
"""Sizes a batch is padded to, so that a kernel is compiled for a few shapes only."""


@dataclass(frozen=True)
class FitOptions:
    """What the caller asked for; None leaves the choice to the data."""

    model: Literal["auto", "dipole", "mc"] = "auto"
    constraint: Constraint | None = None
    """None is `soft` where R has an error, `exact` where it has none, `none` where R was not measured."""
    scale: Literal["given", "free"] = "given"
    window_mm: tuple[float, float] | None = None


class Group(NamedTuple):
    """What the curves of one batch have in common."""

    task: Task
    eta: float
    width: int


@scoped_x64
def fit_slices(slices: Sequence[Slice], options: FitOptions = FitOptions()) -> list[dict[str, ChannelFit]]:
    """Fit every channel of every slice.

    Returns, in order, a `ChannelFit` by channel for each slice. A fit that fails says so in its `status` and `flags`;
    raises InputError where the options ask for what a slice does not hold.
    """
    groups: dict[Group, list[Job]] = defaultdict(list)
    for at, piece in enumerate(slices):
        for channel in piece.channels:
            job = Job(at, piece, channel)
            width = bucket_of(len(piece.channels[channel].r_mm))
            groups[Group(_task(job, options), piece.eta, width)].append(job)
    fits: list[dict[str, ChannelFit]] = [{} for _ in slices]
    for group, jobs in groups.items():
        for first in range(0, len(jobs), BATCHES[-1]):
            batch = jobs[first : first + BATCHES[-1]]
            for job, result in zip(batch, _fit_batch(group, batch, options), strict=True):
                fits[job.at][job.channel] = result
    return [{name: fit[name] for name in piece.channels} for fit, piece in zip(fits, slices, strict=True)]


def fit_slice(piece: Slice, options: FitOptions = FitOptions()) -> dict[str, ChannelFit]:
    """`fit_slices` for one slice."""
    return fit_slices([piece], options)[0]


def _task(job: Job, options: FitOptions) -> Task:
    channel = job.piece.channels[job.channel]
    return Task(
        constraint=_constraint(job, options.constraint),
        scale_free=options.scale == "free",
        binned=channel.r_lo_mm is not None,
        errors_known=bool(np.all(channel.sd_per_mm2 > 0)),
    )


def _constraint(job: Job, asked: Constraint | None) -> Constraint:
    known = job.channel in job.piece.total_r
    sd = job.piece.total_r_sd.get(job.channel, 0.0)
    if asked in ("exact", "soft") and not known:
        raise InputError(f"constraint {asked} needs total_r for channel {job.channel}: give it, or --constraint none")
    if asked == "soft" and not sd > 0:
        raise InputError(f"constraint soft needs total_r_sd for channel {job.channel}: give it, or --constraint exact")
    return asked or ("none" if not known else "soft" if sd > 0 else "exact")


def _fit_batch(group: Group, jobs: Sequence[Job], options: FitOptions) -> list[ChannelFit]:
    model = DipoleModel(jnp.asarray(group.eta))
    data = stack([(job.piece, job.channel) for job in jobs], window_mm=options.window_mm)
    judged = _fetch(fit_batch(group.task, model, *_padded((data, _common_errors(jobs)))))
    rows = [row for row in range(len(jobs)) if needs_profile(group.task, _row(judged, row))]
    profiles = dict(zip(rows, _profiles(group.task, model, data, judged, jobs, rows), strict=True))
    return [channel_fit(group.task, job, _row(judged, at), profiles.get(at)) for at, job in enumerate(jobs)]


def _profiles(
    task: Task, model: ForwardModel, data: Curves, judged: Judged, jobs: Sequence[Job], rows: Sequence[int]
) -> list[Profile]:
    """Profile likelihoods of some rows. An R without an error fixes q = 0; what bounds σa then is the curve alone."""
    if not rows:
        return []
    scale_sd = np.asarray([job.piece.scale_rel_sd for job in jobs])
    data = data._replace(total_r_sd=np.hypot(data.total_r_sd, scale_sd * data.total_r))
    constraint: Constraint = "none" if task.constraint == "exact" else task.constraint
    inflation = np.ones(len(jobs)) if task.errors_known else judged.chi2[: len(jobs)]
    solution = jax.tree.map(lambda x: x[: len(jobs)], judged.solution)
    chosen = jax.tree.map(lambda x: x[np.asarray(rows)], (data, solution, inflation))
    found = _fetch(profile_batch(task._replace(constraint=constraint), model, *_padded(chosen)))
    return [_row(found, at) for at in range(len(rows))]


def _common_errors(jobs: Sequence[Job]) -> Common:
    """Standard deviations of R (for `exact`), of ln scale and of ln mm; one row a job."""
    rows = [
        (job.piece.total_r_sd.get(job.channel, 0.0) / factor_of(job.piece), job.piece.scale_rel_sd, job.piece.mm_rel_sd)
        for job in jobs
    ]
    return Common(*np.asarray(rows).T)


def _padded(batch: Any) -> Any:
    """The batch with its last row repeated up to one of BATCHES."""
    rows = len(jax.tree.leaves(batch)[0])
    extra = next(size for size in BATCHES if size >= rows) - rows
    return jax.tree.map(lambda x: np.concatenate([x, np.repeat(x[-1:], extra, axis=0)]), batch)


def _fetch(tree: Any) -> Any:
    return jax.tree.map(np.asarray, tree)


def _row(tree: Any, at: int) -> Any:
    return jax.tree.map(lambda x: x[at], tree)
