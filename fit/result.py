"""From the kernel's numbers to a ChannelFit: intervals, flags and status."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

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


FAR_OFF = 4.0
"""Standard deviations between the measured R and the fitted one."""
LEAST_LIGHT = 1e-4
"""Of R; the light beyond the innermost radii of an opaque material may be this little."""
MOST_LIGHT = 2.0
MUCH_LOST = 0.05
"""Share of the light that fell outside the frame, beyond which its estimate decides R."""


class Setting(Protocol):
    """What a batch's results need to know of how it was fitted."""

    @property
    def task(self) -> Task: ...
    @property
    def model(self) -> str: ...


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


def channel_fit(
    setting: Setting,
    job: Job,
    judged: Judged,
    profile: Profile | None,
    model_error: dict[str, float],
    sensitivity: dict[str, float],
) -> ChannelFit:
    """What is reported of one channel."""
    task = setting.task
    flags = _flags(setting, job, judged, profile, model_error)
    sigma_a = float(judged.sigma_a if profile is None else profile.sigma_a)
    sigma_sp = float(judged.sigma_sp if profile is None else profile.sigma_sp)
    interval = _linear_interval(judged) if profile is None else (float(profile.lower), float(profile.upper))
    return ChannelFit(
        model=setting.model,
        sigma_a_per_mm=sigma_a,
        sigma_a_sd_per_mm=float(judged.sigma_a_sd) if profile is None else (interval[1] - interval[0]) / (2 * Z95),
        sigma_a_interval95_per_mm=interval,
        sigma_sp_per_mm=sigma_sp,
        sigma_sp_sd_per_mm=float(judged.sigma_sp_sd),
        sigma_sp_interval95_per_mm=spread_of(sigma_sp, float(judged.sigma_sp_sd)),
        correlation=float(judged.correlation),
        total_r_measured=job.piece.total_r.get(job.channel, float("nan")),
        total_r_model=float(judged.total_r),
        window_mm=_window(job, judged),
        n=int(judged.solution.counts.sum()),
        chi2_reduced=float(judged.chi2) if task.errors_known else float("nan"),
        status=_status(flags),
        flags=tuple(flags),
        model_error=model_error,
        sensitivity=sensitivity,
    )


def spread_of(value: float, sd: float) -> tuple[float, float]:
    """95 % of a quantity that cannot be negative: its logarithm is taken as normal."""
    if not value > 0 or not np.isfinite(sd):
        return (0.0, float("inf"))
    spread = float(np.exp(min(Z95 * sd / value, 50.0)))
    return value / spread, value * spread


def _linear_interval(judged: Judged) -> tuple[float, float]:
    """σa at q ± 1.96 sd; far from 0 that is the lognormal interval, and at 0 it stays one-sided."""
    q, sd = float(judged.solution.point.q), float(judged.q_sd)
    if q > PARABOLIC * sd:
        return spread_of(float(judged.sigma_a), float(judged.sigma_a_sd))
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


def _flags(
    setting: Setting, job: Job, judged: Judged, profile: Profile | None, model_error: dict[str, float]
) -> list[str]:
    """The names from `flags.MEANING` that hold for this fit."""
    task, point = setting.task, judged.solution.point
    sigma_tr = max(float(point.q), 0.0) * float(np.exp(point.log_sigma_tp))
    total_r = job.piece.total_r.get(job.channel, np.nan) / factor_of(job.piece)
    lower = _linear_interval(judged)[0] if profile is None else float(profile.lower)
    relative = float(judged.sigma_sp_sd / judged.sigma_sp)
    dipole = setting.model == "dipole"
    held: Mapping[str, bool] = {
        "albedo_one": lower <= 0,
        "dipole_unchecked": dipole and not model_error,
        "few_radii": int(judged.solution.counts.sum()) < FEWEST,
        "g_assumed": job.piece.g is None and not dipole,
        "light_lost": (job.piece.lost_fraction or {}).get(job.channel, 0.0) > MUCH_LOST,
        "noise": not relative < VAGUE,
        "not_converged": not bool(judged.solution.converged),
        "poor_fit": task.errors_known and (float(judged.chi2) > POOR_CHI2 or float(judged.runs_z) > POOR_RUNS),
        "robust": task.robust,
        "scale_free": task.scale_free,
        "scale_suspect": not task.scale_free and not _within_reason(job, total_r),
        "sd_unknown": not task.errors_known,
        "single_scattering": dipole and float(point.q) > np.sqrt(1.5),
        "spot_wide": (job.piece.spot_radius_mm or 0.0) * float(np.exp(point.log_sigma_tp)) > 1,
        "total_at_limit": task.constraint != "none" and total_r >= 1,
        "total_inconsistent": abs(float(judged.total_pull)) > FAR_OFF,
        "total_unknown": job.channel not in job.piece.total_r,
        "window_short": _window(job, judged)[1] * sigma_tr < 1,
    }
    return [name for name, holds in held.items() if holds]


def _within_reason(job: Job, total_r: float) -> bool:
    """Whether the light under the curve is of the order of R: radii or values in another unit are off by far more."""
    channel = job.piece.channels[job.channel]
    order = np.argsort(channel.r_mm, kind="stable")
    r_mm, rd = channel.r_mm[order], channel.rd_per_mm2[order] / factor_of(job.piece)
    light = float(np.trapezoid(2 * np.pi * r_mm * rd, r_mm))
    return LEAST_LIGHT * (total_r if total_r > 0 else 0.0) <= light <= MOST_LIGHT
