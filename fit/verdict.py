"""From an optimum to what is reported of a channel: intervals, budget, flags and status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.batch import Fitted
from bssrdf.fit.intervals import Profile
from bssrdf.fit.layout import camera_factor
from bssrdf.fit.models import OBLIQUE_DEG, is_clamped
from bssrdf.fit.neighbours import Bias, to_log
from bssrdf.fit.sample_verdict import in_sample, is_thin
from bssrdf.session.flags import Flag
from bssrdf.session.records import ChannelFit, Slice, Status
from bssrdf.transport.light import coefficients

Floats = NDArray[np.float64]
NAN = float("nan")
Z95 = 1.959964
PARABOLIC = 4.0
"""Standard deviations of q above 0 from which on the cost counts as a parabola."""
FEWEST = 5
"""Radii below which nothing was fitted."""
POOR_CHI2 = 3.0
"""Of 1,056 trials of the bench none came above 1.6: twice that is not an accident."""
POOR_RUNS = 4.0
"""Standard deviations: one honest curve in 30,000."""
MAX_REL_SD = 0.5
"""Relative sd of σs′ beyond which nothing was identified."""
MOST_PULL = 4.0
"""Standard deviations between the measured R and that of the curve."""
MOST_DRIFT = 0.15
"""Of the curve: a running mean of the residual beyond it is neither noise nor a small error of the model."""
TWO_MEDIA = 2.0
"""Ratio of σs′ or σa between two optima that fit alike, beyond which one interval for both would say nothing."""
BIAS_ROOM = 1.5
"""The dipole's bias is known at the biased medium: it may be this much larger at the true one."""
NEIGHBOURS = 5
OUTLIER = 6.0
"""Standard deviations from the median of NEIGHBOURS radii."""
FEW_OUTLIERS = 0.2
LEAST_LIGHT = 1e-4
"""Of R; the light beyond the innermost radii of an opaque material may be this little."""
MOST_LIGHT = 2.0
MAX_LOST = 0.05
"""Share of the light that fell outside the frame, beyond which its estimate decides R."""
REJECTING = (Flag.TOTAL_INCONSISTENT, Flag.SHAPE_MISFIT, Flag.G_SUSPECT, Flag.ETA_SUSPECT)
NAMES = {"exit": "exit_law"}
"""Sources by the name that the budget has for them, where it differs."""


class Extra(NamedTuple):
    """What was found out about a batch by asking further models."""

    profiles: Mapping[int, Profile]
    model_error: Sequence[dict[str, float]]
    sensitivity: Sequence[dict[str, float]]
    other_models: Sequence[tuple[str, ...]]
    """Flags of rows that another g or η fits far better."""
    bias: Bias | None
    """The dipole's own, where a table tells it."""
    checked: bool
    """False where no table of the medium itself was at hand."""


def needs_profile(fitted: Fitted) -> NDArray[np.bool_]:
    """Rows whose linear errors do not describe σa: at its boundary, or near it where R is not an exact condition."""
    q = fitted.found.point.q[:, 0]
    q_sd = np.sqrt(covariances(fitted)[:, 1, 1])
    if fitted.plan.exact:
        return (q < 1e-6) & ~(q_sd > 0)
    return ~(q > PARABOLIC * q_sd)


def covariances(fitted: Fitted) -> Floats:
    """(b, 2, 2) of (s, q), all sources."""
    covariance: Floats = sum(fitted.judged.sources.values())
    return covariance


def budgets(fitted: Fitted) -> list[dict[str, dict[str, float]]]:
    """Shares of the variances of ln σa and ln σs′ by source, by row; each adds up to 1."""
    turn = to_log(fitted.found.point.q)
    parts = {
        NAMES.get(name, name): np.einsum("bij,bjk,bik->bi", turn, each, turn)
        for name, each in fitted.judged.sources.items()
    }
    whole = np.maximum(sum(parts.values()), 1e-300)
    shares = {name: part / whole for name, part in parts.items()}
    return [
        {
            key: {name: float(share[row, column]) for name, share in shares.items() if share[row, column] > 0}
            for column, key in enumerate(("sigma_a", "sigma_sp"))
        }
        for row in range(len(fitted.jobs))
    ]


def channel_fits(fitted: Fitted, extra: Extra) -> list[ChannelFit]:
    """What is reported of every row."""
    covariance = covariances(fitted)
    turn = to_log(fitted.found.point.q)
    sds = np.sqrt(np.maximum(np.einsum("bij,bjk,bik->bi", turn, covariance, turn), 0.0))
    cross = np.einsum("bj,bjk,bk->b", turn[:, 0], covariance, turn[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = cross / (sds[:, 0] * sds[:, 1])
    shares = budgets(fitted)
    return [
        _channel_fit(fitted, extra, row, covariance[row], sds[row], float(correlation[row]), shares[row])
        for row in range(len(fitted.jobs))
    ]


def _channel_fit(
    fitted: Fitted,
    extra: Extra,
    row: int,
    covariance: Floats,
    rel_sd: Floats,
    correlation: float,
    shares: dict[str, dict[str, float]],
) -> ChannelFit:
    job, profile = fitted.jobs[row], extra.profiles.get(row)
    q, log_sigma = float(fitted.found.point.q[row, 0]), float(fitted.found.point.log_sigma[row, 0])
    sigma_a, sigma_sp = (float(each) for each in coefficients(log_sigma, q))
    interval = _linear_interval(log_sigma, q, float(np.sqrt(covariance[1, 1])), sigma_a, float(rel_sd[0]))
    sd_a = sigma_a * float(rel_sd[0])
    if profile is not None:
        sigma_a, sigma_sp = float(profile.sigma_a[0]), float(profile.sigma_sp[0])
        interval = (float(profile.lower[0]), float(profile.upper[0]))
        sd_a = (interval[1] - interval[0]) / (2 * Z95)
    sp_interval = spread_of(sigma_sp, sigma_sp * float(rel_sd[1]))
    off = extra.model_error[row].get("sigma_a", 0.0)
    sample = in_sample(fitted, row, shares["sigma_a"], sd_a / sigma_a if sigma_a > 0 else np.inf, off)
    flags = list(_flags(fitted, extra, row, interval, float(rel_sd[1]), sample.flags))
    interval, sp_interval, flags = _with_rival(fitted, row, interval, sp_interval, flags)
    status = _status(flags)
    no_sigma_a = Flag.SIGMA_A_UNIDENTIFIABLE in flags
    if sample.flags[Flag.SIGMA_A_UNIDENTIFIABLE]:
        interval = (NAN, NAN)
    result = ChannelFit(
        model=fitted.model.name,
        sigma_a_per_mm=NAN if no_sigma_a else sigma_a,
        sigma_a_sd_per_mm=NAN if no_sigma_a else sd_a,
        sigma_a_interval95_per_mm=interval,
        sigma_sp_per_mm=sigma_sp,
        sigma_sp_sd_per_mm=sigma_sp * float(rel_sd[1]),
        sigma_sp_interval95_per_mm=sp_interval,
        correlation=correlation,
        total_r_measured=_mean([p.total_r.get(job.channel, NAN) for p in job.pieces]),
        total_r_model=float(fitted.judged.total_r[row]),
        total_r_half_space=float(fitted.judged.total_r_half_space[row]),
        tau_p=sample.tau_p,
        sample_effect=(sample.log_total, sample.least_ratio),
        window_mm=_window(fitted, row),
        n=_count(fitted, row),
        chi2_reduced=float(fitted.judged.chi2[row]) if _errors_known(fitted, row) else NAN,
        status=status,
        flags=tuple(flags),
        model_error=extra.model_error[row],
        sensitivity=extra.sensitivity[row],
        budget=shares if status == "converged" and not no_sigma_a else {},
        not_stated=_not_stated(fitted, row),
    )
    return _untold(result) if status in ("rejected", "unidentifiable", "failed") else result


def _untold(result: ChannelFit) -> ChannelFit:
    """The fit without its numbers: none of them can be trusted."""
    none = (NAN, NAN)
    return replace(
        result,
        sigma_a_per_mm=NAN,
        sigma_a_sd_per_mm=NAN,
        sigma_a_interval95_per_mm=none,
        sigma_sp_per_mm=NAN,
        sigma_sp_sd_per_mm=NAN,
        sigma_sp_interval95_per_mm=none,
        correlation=NAN,
        total_r_model=NAN,
        total_r_half_space=NAN,
        model_error={},
        sensitivity={},
        budget={},
    )


def spread_of(value: float, sd: float) -> tuple[float, float]:
    """95 % of a quantity that cannot be negative: its logarithm is taken as normal."""
    if not value > 0 or not np.isfinite(sd):
        return (0.0, float("inf"))
    spread = float(np.exp(min(Z95 * sd / value, 50.0)))
    return value / spread, value * spread


def _linear_interval(log_sigma: float, q: float, q_sd: float, sigma_a: float, rel_sd: float) -> tuple[float, float]:
    """σa at q ± 1.96 sd; far from 0 that is the lognormal interval, and at 0 it stays one-sided."""
    if q > PARABOLIC * q_sd:
        return spread_of(sigma_a, sigma_a * rel_sd)
    scale = float(np.exp(log_sigma)) / 3
    return scale * max(q - Z95 * q_sd, 0.0) ** 2, scale * max(q + Z95 * q_sd, 0.0) ** 2


Interval = tuple[float, float]


def _with_rival(
    fitted: Fitted, row: int, interval: Interval, sp_interval: Interval, flags: list[str]
) -> tuple[Interval, Interval, list[str]]:
    """One interval for two media that fit alike; where it would say nothing, that is said."""
    other = [float(each[row, 0]) for each in fitted.rival]
    if not np.isfinite(other).all() or Flag.FEW_RADII in flags:
        return interval, sp_interval, flags
    sigma_a, sigma_sp = (float(each) for each in coefficients(other[0], other[1]))
    a = (min(interval[0], sigma_a), max(interval[1], sigma_a))
    sp = (min(sp_interval[0], sigma_sp), max(sp_interval[1], sigma_sp))
    far = sp[1] > TWO_MEDIA * sp[0] or a[1] > TWO_MEDIA**2 * max(a[0], 1e-300)
    return a, sp, [*flags, Flag.TWO_MEDIA, *([Flag.NOISE] if far and Flag.NOISE not in flags else [])]


def _status(flags: Sequence[str]) -> Status:
    if {Flag.FEW_RADII, Flag.NOISE} & set(flags):
        return "unidentifiable"
    if Flag.NOT_CONVERGED in flags:
        return "failed"
    if set(REJECTING) & set(flags):
        return "rejected"
    return "upper_bound" if {Flag.ALBEDO_ONE, Flag.TOTAL_AT_LIMIT} & set(flags) else "converged"


def _flags(
    fitted: Fitted, extra: Extra, row: int, interval: Interval, rel_sd: float, of_sample: Mapping[str, bool]
) -> list[str]:
    """The names from `Flag` that hold for this fit."""
    job, plan, judged = fitted.jobs[row], fitted.plan, fitted.judged
    pieces = job.pieces
    q, sigma_tp = float(fitted.found.point.q[row, 0]), float(np.exp(fitted.found.point.log_sigma[row, 0]))
    totals = [p.total_r.get(job.channel, NAN) / camera_factor(p) for p in pieces]
    known = _errors_known(fitted, row)
    dipole = fitted.model.name == "dipole"
    own_pull, own_drift = (0.0, 0.0) if extra.bias is None else _allowed(extra.bias, row)
    own_drift += np.inf if is_thin(fitted, row) else 0.0
    untested = dipole and not extra.model_error[row]
    count = _count(fitted, row)
    end = _window(fitted, row)[1]
    held: dict[str, bool] = {
        Flag.ALBEDO_ONE: interval[0] <= 0,
        Flag.DIPOLE_UNCHECKED: dipole and not extra.checked,
        Flag.FEW_RADII: count < FEWEST,
        Flag.G_ASSUMED: pieces[0].g is None and not dipole,
        Flag.G_CLAMPED: is_clamped(pieces[0].g) and not dipole,
        Flag.INCIDENCE_OBLIQUE: dipole and any(p.incidence_deg >= OBLIQUE_DEG for p in pieces),
        Flag.JOINT: len(pieces) > 1,
        Flag.LIGHT_LOST: any((p.lost_fraction or {}).get(job.channel, 0.0) > MAX_LOST for p in pieces),
        Flag.NOISE: not rel_sd < MAX_REL_SD,
        Flag.NOT_CONVERGED: not bool(fitted.found.converged[row]) or untested,
        Flag.POOR_FIT: known and float(judged.chi2[row]) > POOR_CHI2,
        Flag.POOR_FIT_RUNS: known and float(judged.runs_z[row]) > POOR_RUNS,
        Flag.ROBUST: plan.robust,
        Flag.ROBUST_ADVISED: known and not plan.robust and _outliers(fitted, row),
        Flag.SCALE_FREE: plan.scale_free,
        Flag.SCALE_SD_UNKNOWN: any(p.scale_rel_sd is None for p in pieces),
        Flag.SCALE_SUSPECT: not plan.scale_free and not all(
            _within_reason(p, job.channel, r) for p, r in zip(pieces, totals, strict=True)
        ),
        Flag.SD_FILLED: any(bool(c.filled[row, 0]) for c in fitted.data.curves),
        Flag.SD_UNKNOWN: not known,
        Flag.SHAPE_MISFIT: known and float(judged.drift[row]) > MOST_DRIFT + own_drift,
        Flag.SIGMA_A_UNIDENTIFIABLE: not np.isfinite(interval[1]),
        Flag.SINGLE_SCATTERING: dipole and q > np.sqrt(1.5),
        Flag.SPOT_WIDE: any((p.spot_radius_mm or 0.0) * sigma_tp > 1 for p in pieces),
        Flag.TOTAL_AT_LIMIT: bool(plan.totals) and any(r >= 1 for r in totals),
        Flag.TOTAL_INCONSISTENT: abs(float(judged.pull[row])) > MOST_PULL + own_pull,
        Flag.TOTAL_UNKNOWN: all(np.isnan(totals)),
        Flag.WINDOW_SHORT: end * max(q, 0.0) * sigma_tp < 1,
    }  # fmt: skip
    held = {name: held.get(name, False) or of_sample.get(name, False) for name in sorted({*held, *of_sample})}
    if held[Flag.FEW_RADII]:
        return [name for name in (Flag.FEW_RADII, Flag.G_ASSUMED, Flag.SCALE_SD_UNKNOWN, Flag.SD_UNKNOWN) if held[name]]
    measured = [flag for p in pieces for flag in p.flags]
    return list(dict.fromkeys([*(n for n, holds in held.items() if holds), *extra.other_models[row], *measured]))


def _allowed(own: Bias, row: int) -> tuple[float, float]:
    """What the dipole's own error makes of R and curve on exact light, with room."""
    return BIAS_ROOM * float(own.pull[row]), BIAS_ROOM * float(own.drift[row])


def _outliers(fitted: Fitted, row: int) -> bool:
    """Whether a few radii lie far from their neighbours, which all follow one another."""
    if not float(fitted.judged.chi2[row]) > POOR_CHI2:
        return False
    off = []
    for k in range(len(fitted.plan.sights)):
        mass, mean = fitted.found.weights.mass[k][row], fitted.found.weights.mean[k][row]
        value = fitted.judged.values[k][row]
        misses = ((mean - value) * np.sqrt(mass * fitted.found.ease[row]))[mass > 0]
        if misses.size > NEIGHBOURS:
            about = np.lib.stride_tricks.sliding_window_view(
                np.pad(misses, NEIGHBOURS // 2, mode="reflect"), NEIGHBOURS
            )
            off.append(np.abs(misses - np.median(about, axis=1)))
    away = np.concatenate(off) if off else np.zeros(1)
    return bool((away > OUTLIER).any() and (away > OUTLIER).mean() < FEW_OUTLIERS and np.median(away) < OUTLIER / 3)


def _within_reason(piece: Slice, name: str, total_r: float) -> bool:
    """Whether the light under the curve is of the order of R: radii or values in another unit are off by far more."""
    channel = piece.channels[name]
    order = np.argsort(channel.r_mm, kind="stable")
    r_mm, rd = channel.r_mm[order], channel.rd_per_mm2[order] / camera_factor(piece)
    light = float(np.trapezoid(2 * np.pi * r_mm * rd, r_mm))
    return LEAST_LIGHT * (total_r if total_r > 0 else 0.0) <= light <= MOST_LIGHT


def _errors_known(fitted: Fitted, row: int) -> bool:
    return all(bool(c.errors_known[row, 0]) for c in fitted.data.curves)


def _count(fitted: Fitted, row: int) -> int:
    """Data that counted."""
    return sum(
        int(((c.known[row] != 0) & used[row][:, None]).sum())
        for c, used in zip(fitted.data.curves, fitted.judged.used, strict=True)
    )


def _window(fitted: Fitted, row: int) -> Interval:
    ends = [
        (float(c.r_lo[row][used[row]].min()), float(c.r_hi[row][used[row]].max()))
        for c, used in zip(fitted.data.curves, fitted.judged.used, strict=True)
        if used[row].any()
    ]
    if not ends:
        return (NAN, NAN)
    return min(lo for lo, _ in ends), max(hi for _, hi in ends)


def _not_stated(fitted: Fitted, row: int) -> tuple[str, ...]:
    """Errors that count as 0 because no slice states them."""
    job = fitted.jobs[row]
    pieces = job.pieces
    missing = {
        "noise": not _errors_known(fitted, row),
        "total": any(job.channel in p.total_r and not p.total_r_sd.get(job.channel) for p in pieces),
        "scale": any(p.scale_rel_sd is None for p in pieces),
        "length": any(p.mm_rel_sd is None for p in pieces),
        "spot": any(p.spot_radius_mm is not None and p.spot_radius_sd_mm is None for p in pieces),
        "view": any(p.exit == "fresnel" and p.view_angle_sd_deg is None for p in pieces),
        "g": any(p.g_sd is None for p in pieces) or ("g" not in fitted.beside and any(p.g_sd for p in pieces)),
        "eta": any(p.eta_sd is None for p in pieces) or ("eta" not in fitted.beside and any(p.eta_sd for p in pieces)),
    }
    return tuple(name for name, absent in missing.items() if absent)


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if value == value]
    return sum(known) / len(known) if known else NAN
