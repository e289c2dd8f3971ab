"""From an optimum to what is reported of a channel: intervals, budget, flags and status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.batch import Fitted
from bssrdf.fit.intervals import Profile
from bssrdf.fit.jobs import Job
from bssrdf.fit.layout import factor_of
from bssrdf.fit.models import OBLIQUE_DEG, is_clamped
from bssrdf.fit.neighbours import Bias, TableSays, to_log
from bssrdf.fit.outliers import has_outliers
from bssrdf.fit.sample_verdict import InSample, in_samples, thin_rows
from bssrdf.session.flags import Flag
from bssrdf.session.records import ChannelFit, Slice, Status
from bssrdf.transport.light import coefficients

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
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
LEAST_LIGHT = 1e-4
"""Of R; the light beyond the innermost radii of an opaque material may be this little."""
MOST_LIGHT = 2.0
MAX_LOST = 0.05
"""Share of the light that fell outside the frame, beyond which its estimate decides R."""
REJECTING = (Flag.TOTAL_INCONSISTENT, Flag.SHAPE_MISFIT, Flag.G_SUSPECT, Flag.ETA_SUSPECT, Flag.SPOT_SUSPECT)
UNTOLD = ("rejected", "unidentifiable", "failed")
"""No number of these can be trusted."""
OF_FEW = (Flag.FEW_RADII, Flag.G_ASSUMED, Flag.SCALE_SD_UNKNOWN, Flag.SD_UNKNOWN)
"""What is said of a fit with hardly a radius."""
_COEFFICIENTS = ("sigma_a", "sigma_sp")
NAMES = {"exit": "exit_law"}
"""Sources by the name that the budget has for them, where it differs."""
STATED = ("noise", "total", "scale", "length", "spot", "view", "g", "eta")
"""Errors that a slice may state."""
OF_SAMPLE = ("thickness", "back")
"""Sources by which σa hangs on how the sample is held."""


class Extra(NamedTuple):
    """What was found out about a batch by asking further models."""

    profiled: tuple[NDArray[np.int_], Profile] | None
    """Rows whose σa has a profile, and those."""
    sensitivity: Mapping[str, Floats]
    other_models: Sequence[tuple[str, ...]]
    """Flags of rows that another g, η or spot fits far better."""
    model_error: Floats | None = None
    """(b, 2), relative, of σa and σs′; None where no table tells."""
    bias: Bias | None = None
    """That of a model which a table tells."""
    checked: bool = True
    """False where no table of the medium itself was at hand."""
    of_table: TableSays | None = None


class _Stated(NamedTuple):
    """By row and coefficient, σa and σs′: values [1/mm] (b, 2) with their whole errors; and the data that counted."""

    value: Floats
    sd: Floats
    interval: Floats
    """(b, 2, 2): both ends, 95 %."""
    correlation: Floats
    shares: Mapping[str, Floats]
    """(b, 2) by source: of the variance of the logarithm; they add up to 1."""
    n: NDArray[np.int_]
    window: Floats
    """(b, 2): radii [mm], NaN where none counted."""


def needs_profile(fitted: Fitted) -> Bools:
    """Rows whose linear errors do not describe σa: at its boundary, or near it where R is not an exact condition."""
    return fitted.plan.bent(fitted.found.point.q[:, 0], np.sqrt(_covariance(fitted)[:, 1, 1]), PARABOLIC)


def relative_sds(fitted: Fitted) -> Floats:
    """(b, 2) of σa and σs′, all sources."""
    return np.sqrt(np.maximum(_variances(_of_logs(fitted, _covariance(fitted))), 0.0))


def channel_fits(fitted: Fitted, extra: Extra) -> list[ChannelFit]:
    """What is reported of every row."""
    stated = _stated(fitted, extra)
    of_sample = [stated.shares[name][:, 0] for name in OF_SAMPLE if name in stated.shares]
    rel_sd = np.where(stated.value[:, 0] > 0, stated.sd[:, 0] / stated.value[:, 0], np.inf)
    off = np.zeros(rel_sd.size) if extra.model_error is None else extra.model_error[:, 0]
    samples = in_samples(fitted, share=np.sum([0.0 * stated.n, *of_sample], axis=0), rel_sd=rel_sd, off=off)
    flags = _flags(fitted, extra, stated, samples)
    for row in np.flatnonzero(np.isfinite(np.concatenate(fitted.rival, axis=1)).all(axis=1)).tolist():
        if Flag.FEW_RADII not in flags[row]:
            _join_rival(fitted, stated.interval[row], flags[row], row)
    columns = _columns(fitted, extra, stated, samples, [tuple(each) for each in flags])
    return [ChannelFit(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)]


def _stated(fitted: Fitted, extra: Extra) -> _Stated:
    log_sigma, q = (each[:, 0] for each in fitted.found.point[:2])
    covariance, rel_sd = _covariance(fitted), relative_sds(fitted)
    value = np.stack(coefficients(log_sigma, q), axis=1)
    interval_a = _linear_interval(log_sigma, q, np.sqrt(covariance[:, 1, 1]), value[:, 0], rel_sd[:, 0])
    sd = value * rel_sd
    if extra.profiled is not None:
        rows, profile = extra.profiled
        value[rows] = np.stack([profile.sigma_a, profile.sigma_sp], axis=1)
        interval_a[rows] = np.stack([profile.lower, profile.upper], axis=1)
        sd[rows, 0] = (profile.upper - profile.lower) / (2 * Z95)
        sd[rows, 1] = profile.sigma_sp * rel_sd[rows, 1]
    of_logs = {NAMES.get(name, name): _of_logs(fitted, each) for name, each in fitted.judged.sources.items()}
    whole = np.maximum(_variances(sum(of_logs.values())), 1e-300)
    interval = np.stack([interval_a, spread_of(value[:, 1], sd[:, 1])], axis=1)
    correlation = _of_logs(fitted, covariance)[:, 0, 1] / rel_sd.prod(axis=1)
    shares = {name: _variances(each) / whole for name, each in of_logs.items()}
    return _Stated(value, sd, interval, correlation, shares, *_counted(fitted))


def _covariance(fitted: Fitted) -> Floats:
    """(b, 2, 2) of (s, q), all sources."""
    covariance: Floats = sum(fitted.judged.sources.values())
    return covariance


def _of_logs(fitted: Fitted, covariance: Floats) -> Floats:
    """The same of (ln σa, ln σs′)."""
    turn = to_log(fitted.found.point.q)
    return turn @ covariance @ turn.swapaxes(1, 2)


def _variances(covariance: Any) -> Floats:
    return np.diagonal(covariance, axis1=1, axis2=2)


def spread_of(value: Floats, sd: Floats) -> Floats:
    """(b, 2): 95 % of a quantity that cannot be negative: its logarithm is taken as normal."""
    spread = np.exp(np.minimum(Z95 * sd / value, 50.0))
    known = (value > 0) & np.isfinite(sd)
    return np.stack([np.where(known, value / spread, 0.0), np.where(known, value * spread, np.inf)], axis=1)


def _linear_interval(log_sigma: Floats, q: Floats, q_sd: Floats, sigma_a: Floats, rel_sd: Floats) -> Floats:
    """σa at q ± 1.96 sd; far from 0 that is the lognormal interval, and at 0 it stays one-sided."""
    scale = np.exp(log_sigma) / 3
    about = np.stack([scale * np.maximum(q + sign * Z95 * q_sd, 0.0) ** 2 for sign in (-1, 1)], axis=1)
    return np.where((q > PARABOLIC * q_sd)[:, None], spread_of(sigma_a, sigma_a * rel_sd), about)


def _counted(fitted: Fitted) -> tuple[NDArray[np.int_], Floats]:
    """How many data counted, and the window (b, 2) that they span [mm], NaN without any."""
    every = list(zip(fitted.data.curves, fitted.judged.used, strict=True))
    n = sum(((c.known != 0).sum(axis=2) * used).sum(axis=1) for c, used in every)
    lo = np.min([np.where(used, c.r_lo, np.inf).min(axis=1) for c, used in every], axis=0)
    hi = np.max([np.where(used, c.r_hi, -np.inf).max(axis=1) for c, used in every], axis=0)
    return n, np.where(np.isfinite(lo)[:, None], np.stack([lo, hi], axis=1), NAN)


def _columns(
    fitted: Fitted, extra: Extra, stated: _Stated, samples: Sequence[InSample], flags: Sequence[tuple[str, ...]]
) -> dict[str, Sequence[Any]]:
    """A value per row of each field of `ChannelFit`."""
    jobs, judged, known = fitted.jobs, fitted.judged, fitted.judged.errors_known
    statuses = [_status(names) for names in flags]
    told = np.array([status not in UNTOLD for status in statuses])
    told_a = told & [Flag.SIGMA_A_UNIDENTIFIABLE not in names for names in flags]
    bounded = told & [not sample.flags.get(Flag.SIGMA_A_UNIDENTIFIABLE) for sample in samples]
    balanced = told_a & [status == "converged" for status in statuses]
    model_error = {} if extra.model_error is None else dict(zip(_COEFFICIENTS, extra.model_error.T, strict=True))

    def numbers(values: Floats, counts: Bools = told) -> list[Any]:
        return np.where(counts, values, NAN).tolist()

    def pairs(values: Floats, counts: Bools = told) -> list[Any]:
        return list(zip(*(numbers(each, counts) for each in values.T), strict=True))

    return {
        "model": [fitted.model.name] * len(jobs),
        "sigma_a_per_mm": numbers(stated.value[:, 0], told_a),
        "sigma_a_sd_per_mm": numbers(stated.sd[:, 0], told_a),
        "sigma_a_interval95_per_mm": pairs(stated.interval[:, 0], bounded),
        "sigma_sp_per_mm": numbers(stated.value[:, 1]),
        "sigma_sp_sd_per_mm": numbers(stated.sd[:, 1]),
        "sigma_sp_interval95_per_mm": pairs(stated.interval[:, 1]),
        "correlation": numbers(stated.correlation),
        "total_r_measured": [_mean([p.total_r.get(job.channel, NAN) for p in job.pieces]) for job in jobs],
        "total_r_model": numbers(judged.seen.totals[0][0][:, 0]),
        "total_r_half_space": numbers(judged.seen.half[:, 0]),
        "tau_p": [sample.tau_p for sample in samples],
        "sample_effect": [(sample.log_total, sample.least_ratio) for sample in samples],
        "window_mm": pairs(stated.window, np.ones_like(told)),
        "n": stated.n.tolist(),
        "chi2_reduced": numbers(judged.chi2, known),
        "status": statuses,
        "flags": flags,
        "model_error": _named(model_error, told),
        "sensitivity": _named(extra.sensitivity, told),
        "budget": _budgets(stated.shares, balanced),
        "not_stated": [_not_stated(fitted, job, stated) for job, stated in zip(jobs, known.tolist(), strict=True)],
    }


def _named(values: Mapping[str, Floats], counts: Bools) -> list[dict[str, float]]:
    """A row's values by name; nothing where it does not count."""
    by_row = {name: each.tolist() for name, each in values.items()}
    return [{name: each[row] for name, each in by_row.items() if counted} for row, counted in enumerate(counts)]


def _budgets(shares: Mapping[str, Floats], counts: Bools) -> list[dict[str, dict[str, float]]]:
    """By coefficient the shares that are not 0."""
    by_row = np.stack(list(shares.values()), axis=2).tolist()
    return [
        {key: {name: share for name, share in zip(shares, of, strict=True) if share > 0}
         for key, of in zip(_COEFFICIENTS, both, strict=True) if counted}
        for both, counted in zip(by_row, counts.tolist(), strict=True)
    ]  # fmt: skip


def _join_rival(fitted: Fitted, interval: Floats, flags: list[str], row: int) -> None:
    """One interval (2, 2) for two media that fit alike; where it would say nothing, that is said."""
    other = np.array(coefficients(*(float(each[row, 0]) for each in fitted.rival[:2])))
    interval[:] = np.stack([np.minimum(interval[:, 0], other), np.maximum(interval[:, 1], other)], axis=1)
    flags.append(Flag.TWO_MEDIA)
    (lowest_a, highest_a), (lowest_sp, highest_sp) = interval
    far = highest_sp > TWO_MEDIA * lowest_sp or highest_a > TWO_MEDIA**2 * max(lowest_a, 1e-300)
    if far and Flag.NOISE not in flags:
        flags.append(Flag.NOISE)


@lru_cache(maxsize=4096)
def _status(flags: tuple[str, ...]) -> Status:
    if {Flag.FEW_RADII, Flag.NOISE} & set(flags):
        return "unidentifiable"
    if Flag.NOT_CONVERGED in flags:
        return "failed"
    if set(REJECTING) & set(flags):
        return "rejected"
    return "upper_bound" if {Flag.ALBEDO_ONE, Flag.TOTAL_AT_LIMIT} & set(flags) else "converged"


def _flags(fitted: Fitted, extra: Extra, stated: _Stated, samples: Sequence[InSample]) -> list[list[str]]:
    """By row the names from `Flag` that hold for this fit, and those of its slices."""
    held = _held(fitted, extra, stated)
    for name in {name for sample in samples for name in sample.flags}:
        held[name] = held.get(name, False) | np.array([sample.flags.get(name, False) for sample in samples])
    few = held[Flag.FEW_RADII]
    raised: list[list[str]] = [[] for _ in samples]
    for name in sorted(held):
        for at in np.flatnonzero(held[name] & (~few | (name in OF_FEW))).tolist():
            raised[at].append(name)
    for at in np.flatnonzero(~few).tolist():
        measured = [flag for piece in fitted.jobs[at].pieces for flag in piece.flags]
        raised[at] = list(dict.fromkeys([*raised[at], *extra.other_models[at], *measured]))
    return raised


def _held(fitted: Fitted, extra: Extra, stated: _Stated) -> dict[str, Bools]:
    """Which rows each flag holds for, by the fit itself; one value where it holds for all or none."""
    jobs, plan, judged, first = fitted.jobs, fitted.plan, fitted.judged, fitted.jobs[0].pieces
    biased, known = fitted.model.biased, judged.errors_known
    q, sigma_tp = fitted.found.point.q[:, 0], np.exp(fitted.found.point.log_sigma[:, 0])
    factors = [factor_of(piece) for piece in first]
    totals = np.array(
        [[p.total_r.get(job.channel, NAN) / f for p, f in zip(job.pieces, factors, strict=True)] for job in jobs]
    )
    spots = np.array([max(p.spot_radius_mm or 0.0 for p in job.pieces) for job in jobs])
    pull, drift = (0.0, 0.0) if extra.bias is None else (BIAS_ROOM * extra.bias.pull, BIAS_ROOM * extra.bias.drift)
    table_pull, table_drift = (0.0, 0.0) if extra.of_table is None else extra.of_table
    found: dict[str, Any] = {
        Flag.ALBEDO_ONE: stated.interval[:, 0, 0] <= 0,
        Flag.DIPOLE_UNCHECKED: biased and not extra.checked,
        Flag.FEW_RADII: stated.n < FEWEST,
        Flag.G_ASSUMED: first[0].g is None and not biased,
        Flag.G_CLAMPED: is_clamped(first[0].g) and not biased,
        Flag.INCIDENCE_OBLIQUE: biased and any(p.incidence_deg >= OBLIQUE_DEG for p in first),
        Flag.JOINT: len(first) > 1,
        Flag.LIGHT_LOST: [
            any((p.lost_fraction or {}).get(job.channel, 0.0) > MAX_LOST for p in job.pieces) for job in jobs
        ],
        Flag.NOISE: ~(stated.sd[:, 1] / stated.value[:, 1] < MAX_REL_SD),
        Flag.NOT_CONVERGED: ~fitted.found.converged | (biased and extra.model_error is None),
        Flag.POOR_FIT: known & (judged.chi2 > POOR_CHI2),
        Flag.POOR_FIT_RUNS: known & (judged.runs_z > POOR_RUNS),
        Flag.ROBUST: plan.robust,
        Flag.ROBUST_ADVISED: known & (not plan.robust) & has_outliers(fitted, judged.chi2 > POOR_CHI2),
        Flag.SCALE_FREE: plan.scale_free,
        Flag.SCALE_SD_UNKNOWN: [any(p.scale_rel_sd is None for p in job.pieces) for job in jobs],
        Flag.SCALE_SUSPECT: (not plan.scale_free) & ~_within_reason(fitted, totals),
        Flag.SD_FILLED: np.any([c.filled[:, 0] for c in fitted.data.curves], axis=0),
        Flag.SD_UNKNOWN: ~known,
        Flag.SHAPE_MISFIT: known
        & ~thin_rows(fitted)
        & ((judged.drift > np.hypot(MOST_DRIFT, drift)) | (table_drift > MOST_DRIFT)),
        Flag.SIGMA_A_UNIDENTIFIABLE: ~np.isfinite(stated.interval[:, 0, 1]),
        Flag.SIDE_UNKNOWN: not biased and any(sight.slant > 0 for sight in plan.sights if sight.camera),
        Flag.SINGLE_SCATTERING: biased & (q > np.sqrt(1.5)),
        Flag.SPOT_WIDE: spots * sigma_tp > 1,
        Flag.TOTAL_AT_LIMIT: bool(plan.totals) & (totals >= 1).any(axis=1),
        Flag.TOTAL_INCONSISTENT: (np.abs(judged.pull) > MOST_PULL + pull) | (np.abs(table_pull) > MOST_PULL),
        Flag.TOTAL_UNKNOWN: np.isnan(totals).all(axis=1),
        Flag.WINDOW_SHORT: stated.window[:, 1] * np.maximum(q, 0.0) * sigma_tp < 1,
    }  # fmt: skip
    return {name: np.asarray(holds, bool) for name, holds in found.items()}


def _within_reason(fitted: Fitted, totals: Floats) -> Bools:
    """Whether the light under each curve is of the order of R: radii or values in another unit are off by far more."""
    good = np.ones(len(fitted.jobs), bool)
    for c, total_r in zip(fitted.data.curves, totals.T, strict=True):
        data = c.known != 0
        r, rd = (c.r_lo + c.r_hi) / 2, (c.rd * data).sum(axis=2) / np.maximum(data.sum(axis=2), 1)
        light = np.trapezoid(2 * np.pi * r * rd, r, axis=1)
        good &= (LEAST_LIGHT * np.where(total_r > 0, total_r, 0.0) <= light) & (light <= MOST_LIGHT)
    return good


def _not_stated(fitted: Fitted, job: Job, known: bool) -> tuple[str, ...]:
    """Errors that count as 0 because no slice states them."""
    silent = [_silent(fitted, piece, job.channel) for piece in job.pieces]
    absent = (not known, *(any(each) for each in zip(*silent, strict=True)))
    return tuple(compress(STATED, absent))


def _silent(fitted: Fitted, piece: Slice, channel: str) -> tuple[bool, ...]:
    """Of STATED beside noise."""
    return (
        channel in piece.total_r and not piece.total_r_sd.get(channel),
        piece.scale_rel_sd is None,
        piece.mm_rel_sd is None,
        piece.spot_radius_mm is not None and piece.spot_radius_sd_mm is None,
        piece.exit == "fresnel" and piece.view_angle_sd_deg is None,
        piece.g_sd is None or (piece.g_sd > 0 and "g" not in fitted.beside),
        piece.eta_sd is None or (piece.eta_sd > 0 and "eta" not in fitted.beside),
    )


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if value == value]
    return sum(known) / len(known) if known else NAN
