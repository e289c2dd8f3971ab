"""From the kernel's numbers to a ChannelFit: intervals, flags and status."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bssrdf.fit.curves import convention_of
from bssrdf.fit.intervals import Profile
from bssrdf.fit.kernel import Judged, Task
from bssrdf.fit.window import FEWEST
from bssrdf.session.records import ChannelFit, Slice, Status

Z95 = 1.959964
PARABOLIC = 4.0
"""Standard deviations of q above 0 from which on the cost counts as a parabola."""
POOR_CHI2 = 3.0
POOR_RUNS = 4.0
VAGUE = 0.5
"""Relative sd of σs′ beyond which nothing was identified."""


class Job(NamedTuple):
    """One channel of one slice."""

    at: int
    piece: Slice
    channel: str


def factor_of(piece: Slice) -> float:
    """The slice's values over the models'."""
    return convention_of(piece).factor


def needs_profile(task: Task, judged: Judged) -> bool:
    """Whether linear errors do not describe σa: at its boundary, or near it where R is no exact condition."""
    q = float(judged.solution.point.q)
    if task.constraint == "exact":
        return q < 1e-6 and not judged.q_sd > 0
    return not q > PARABOLIC * float(judged.q_sd)


def channel_fit(task: Task, job: Job, judged: Judged, profile: Profile | None) -> ChannelFit:
    """What is reported of one channel."""
    flags = _flags(task, job, judged, profile)
    window_mm = _window(job, judged)
    inside = int(judged.solution.counts.sum())
    sigma_a = float(judged.sigma_a if profile is None else profile.sigma_a)
    sigma_sp = float(judged.sigma_sp if profile is None else profile.sigma_sp)
    interval = _linear_interval(judged) if profile is None else (float(profile.lower), float(profile.upper))
    return ChannelFit(
        model="dipole",
        sigma_a_per_mm=sigma_a,
        sigma_a_sd_per_mm=float(judged.sigma_a_sd) if profile is None else (interval[1] - interval[0]) / (2 * Z95),
        sigma_a_interval95_per_mm=interval,
        sigma_sp_per_mm=sigma_sp,
        sigma_sp_sd_per_mm=float(judged.sigma_sp_sd),
        sigma_sp_interval95_per_mm=_spread(sigma_sp, float(judged.sigma_sp_sd)),
        correlation=float(judged.correlation),
        total_r_measured=job.piece.total_r.get(job.channel, float("nan")),
        total_r_model=float(judged.total_r),
        window_mm=window_mm,
        n=inside,
        chi2_reduced=float(judged.chi2) if task.errors_known else float("nan"),
        status=_status(flags),
        flags=tuple(flags),
    )


def _spread(value: float, sd: float) -> tuple[float, float]:
    """95 % of a quantity that cannot be negative: its logarithm is taken as normal."""
    if not value > 0 or not np.isfinite(sd):
        return (0.0, float("inf"))
    spread = float(np.exp(min(Z95 * sd / value, 50.0)))
    return value / spread, value * spread


def _linear_interval(judged: Judged) -> tuple[float, float]:
    """σa at q ± 1.96 sd; far from 0 that is the lognormal interval, and at 0 it stays one-sided."""
    q, sd = float(judged.solution.point.q), float(judged.q_sd)
    if q > PARABOLIC * sd:
        return _spread(float(judged.sigma_a), float(judged.sigma_a_sd))
    scale = float(np.exp(judged.solution.point.log_sigma_tp)) / 3
    return scale * max(q - Z95 * sd, 0.0) ** 2, scale * max(q + Z95 * sd, 0.0) ** 2


def _window(job: Job, judged: Judged) -> tuple[float, float]:
    channel = job.piece.channels[job.channel]
    used = np.empty(len(channel.r_mm), bool)
    used[np.argsort(channel.r_mm, kind="stable")] = judged.solution.counts[: len(channel.r_mm)] > 0
    if not used.any():
        return (float("nan"), float("nan"))
    lo = channel.r_mm if channel.r_lo_mm is None else channel.r_lo_mm
    hi = channel.r_mm if channel.r_hi_mm is None else channel.r_hi_mm
    return float(lo[used].min()), float(hi[used].max())


def _status(flags: list[str]) -> Status:
    if {"few_radii", "noise"} & set(flags):
        return "unidentifiable"
    if "not_converged" in flags:
        return "failed"
    return "upper_bound" if {"albedo_one", "total_at_limit"} & set(flags) else "converged"


def _flags(task: Task, job: Job, judged: Judged, profile: Profile | None) -> list[str]:
    """The names from `flags.MEANING` that hold for this fit."""
    point = judged.solution.point
    sigma_tr = max(float(point.q), 0.0) * float(np.exp(point.log_sigma_tp))
    total_r = job.piece.total_r.get(job.channel, np.nan) / factor_of(job.piece)
    lower = _linear_interval(judged)[0] if profile is None else float(profile.lower)
    relative = float(judged.sigma_sp_sd / judged.sigma_sp)
    held: Mapping[str, bool] = {
        "albedo_one": lower <= 0,
        "few_radii": int(judged.solution.counts.sum()) < FEWEST,
        "noise": not relative < VAGUE,
        "not_converged": not bool(judged.solution.converged),
        "poor_fit": task.errors_known and (float(judged.chi2) > POOR_CHI2 or float(judged.runs_z) > POOR_RUNS),
        "sd_unknown": not task.errors_known,
        "single_scattering": float(point.q) > np.sqrt(1.5),
        "total_at_limit": task.constraint != "none" and total_r >= 1,
        "total_unknown": job.channel not in job.piece.total_r,
        "window_short": _window(job, judged)[1] * sigma_tr < 1,
    }
    return [name for name, holds in held.items() if holds]
