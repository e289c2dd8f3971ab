"""Fit slices: group their channels into batches of one shape, run the kernel, and judge what comes back."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from bssrdf.errors import InputError
from bssrdf.fit.curves import Curves, bucket_of, convention_of, stack
from bssrdf.fit.kernel import Constraint, Judged, Nuisance, Task, fit_batch
from bssrdf.fit.window import FEWEST
from bssrdf.session.records import ChannelFit, Slice, Status
from bssrdf.transport.forward import DipoleModel
from bssrdf.transport.precision import scoped_x64

Z95 = 1.959964
POOR_RUNS = 4.0
LARGEST_BATCH = 1024


@dataclass(frozen=True)
class FitOptions:
    """What the caller asked for; None leaves the choice to the data."""

    model: Literal["auto", "dipole", "mc"] = "auto"
    constraint: Constraint | None = None
    """None is `soft` where R has an error, `exact` where it has none, `none` where R was not measured."""
    scale: Literal["given", "free"] = "given"
    window_mm: tuple[float, float] | None = None


class Job(NamedTuple):
    """One channel of one slice."""

    at: int
    piece: Slice
    channel: str


@scoped_x64
def fit_slices(slices: Sequence[Slice], options: FitOptions = FitOptions()) -> list[dict[str, ChannelFit]]:  # noqa: B008
    """Fit every channel of every slice.

    Returns, in order, a `ChannelFit` by channel for each slice. A fit that fails says so in its `status` and `flags`;
    raises InputError where the options ask for what a slice does not hold.
    """
    groups: dict[tuple[Task, float, int], list[Job]] = defaultdict(list)
    for at, piece in enumerate(slices):
        for channel in piece.channels:
            job = Job(at, piece, channel)
            groups[_task(job, options), piece.eta, bucket_of(len(piece.channels[channel].r_mm))].append(job)
    fits: list[dict[str, ChannelFit]] = [{} for _ in slices]
    for (task, eta, _), jobs in groups.items():
        for first in range(0, len(jobs), LARGEST_BATCH):
            batch = jobs[first : first + LARGEST_BATCH]
            for job, result in zip(batch, _fit_group(task, eta, batch, options), strict=True):
                fits[job.at][job.channel] = result
    return [{name: fit[name] for name in piece.channels} for fit, piece in zip(fits, slices, strict=True)]


def fit_slice(piece: Slice, options: FitOptions = FitOptions()) -> dict[str, ChannelFit]:  # noqa: B008
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
        raise InputError(
            f"constraint {asked} needs total_r for channel {job.channel}; give it, or use --constraint none"
        )
    if asked == "soft" and not sd > 0:
        raise InputError(
            f"constraint soft needs total_r_sd > 0 for channel {job.channel}; give it, or use --constraint exact"
        )
    return asked or ("none" if not known else "soft" if sd > 0 else "exact")


def _fit_group(task: Task, eta: float, jobs: Sequence[Job], options: FitOptions) -> list[ChannelFit]:
    data = stack([(job.piece, job.channel) for job in jobs], window_mm=options.window_mm)
    data, common_sd = _padded(data, _common_errors(jobs))
    model = DipoleModel(jnp.asarray(eta))
    judged = jax.tree.map(np.asarray, fit_batch(task, model, data, common_sd))
    return [_channel_fit(task, job, jax.tree.map(lambda x, row=row: x[row], judged)) for row, job in enumerate(jobs)]


def _common_errors(jobs: Sequence[Job]) -> Nuisance:
    """Standard deviations of R (for `exact`), of ln scale and of ln mm; one row a job."""
    rows = [
        (
            job.piece.total_r_sd.get(job.channel, 0.0) / convention_of(job.piece).factor,
            job.piece.scale_rel_sd,
            job.piece.mm_rel_sd,
        )
        for job in jobs
    ]
    return Nuisance(*np.asarray(rows).T)


def _padded(data: Curves, common: Nuisance) -> tuple[Curves, Nuisance]:
    """Repeat the last curve until the batch has a power of two, so that few shapes are compiled."""
    size = len(data.n)
    extra = (1 << (size - 1).bit_length()) - size
    return jax.tree.map(lambda x: np.concatenate([x, np.repeat(x[-1:], extra, axis=0)]), (data, common))


def _channel_fit(task: Task, job: Job, judged: Judged) -> ChannelFit:
    inside = judged.solution.counts > 0
    flags = _flags(task, job, judged)
    status = _status(judged, flags)
    sigma_a = max(float(judged.sigma_a), 0.0)
    sigma_sp = float(judged.sigma_sp)
    total_r = job.piece.total_r.get(job.channel, float("nan"))
    return ChannelFit(
        model="dipole",
        sigma_a_per_mm=sigma_a,
        sigma_a_sd_per_mm=float(judged.sigma_a_sd),
        sigma_a_interval95_per_mm=_interval(float(judged.sigma_a), float(judged.sigma_a_sd)),
        sigma_sp_per_mm=sigma_sp,
        sigma_sp_sd_per_mm=float(judged.sigma_sp_sd),
        sigma_sp_interval95_per_mm=_interval(sigma_sp, float(judged.sigma_sp_sd)),
        correlation=float(judged.correlation),
        total_r_measured=total_r,
        total_r_model=float(judged.total_r),
        window_mm=_window(job, inside),
        n=int(inside.sum()),
        chi2_reduced=float(judged.chi2) if task.errors_known else float("nan"),
        status=status,
        flags=tuple(flags),
    )


def _interval(value: float, sd: float) -> tuple[float, float]:
    return max(value - Z95 * sd, 0.0), max(value, 0.0) + Z95 * sd


def _window(job: Job, inside: np.ndarray) -> tuple[float, float]:
    channel = job.piece.channels[job.channel]
    used = inside[: len(channel.r_mm)]
    if not used.any():
        return (float("nan"), float("nan"))
    lo = channel.r_mm if channel.r_lo_mm is None else channel.r_lo_mm
    hi = channel.r_mm if channel.r_hi_mm is None else channel.r_hi_mm
    return float(lo[used].min()), float(hi[used].max())


def _status(judged: Judged, flags: Sequence[str]) -> Status:
    if "few_radii" in flags:
        return "unidentifiable"
    if "not_converged" in flags:
        return "failed"
    return "upper_bound" if "albedo_one" in flags or "total_at_limit" in flags else "converged"


def _flags(task: Task, job: Job, judged: Judged) -> list[str]:
    """The names from `flags.MEANING` that hold for this fit, in the order of that list."""
    point = judged.solution.point
    sigma_tr = abs(float(point.q)) * float(np.exp(point.log_sigma_tp))
    total_r = job.piece.total_r.get(job.channel, np.nan) / convention_of(job.piece).factor
    inside = judged.solution.counts > 0
    reach = _window(job, inside)[1]
    held: Mapping[str, bool] = {
        "albedo_one": bool(judged.sigma_a - Z95 * judged.sigma_a_sd <= 0),
        "few_radii": int(inside.sum()) < FEWEST,
        "not_converged": not bool(judged.solution.converged) or not np.isfinite(judged.sigma_sp_sd),
        "poor_fit": task.errors_known and (float(judged.chi2) > 3 or float(judged.runs_z) > POOR_RUNS),
        "sd_unknown": not task.errors_known,
        "single_scattering": float(point.q) > np.sqrt(1.5),
        "total_at_limit": task.constraint != "none" and total_r >= 1,
        "total_unknown": job.channel not in job.piece.total_r,
        "window_short": reach * sigma_tr < 1,
    }
    return [name for name, holds in held.items() if holds]
