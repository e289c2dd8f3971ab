"""From an optimum to what is reported of a channel: intervals, budget, flags and status."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.batch import Fitted
from bssrdf.fit.intervals import Profile
from bssrdf.fit.jobs import Job
from bssrdf.fit.layout import camera_factor
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
REJECTING = (Flag.TOTAL_INCONSISTENT, Flag.SHAPE_MISFIT, Flag.G_SUSPECT, Flag.ETA_SUSPECT)
UNTOLD = ("rejected", "unidentifiable", "failed")
"""No number of these can be trusted."""
OF_FEW = (Flag.FEW_RADII, Flag.G_ASSUMED, Flag.SCALE_SD_UNKNOWN, Flag.SD_UNKNOWN)
"""What is said of a fit with hardly a radius."""
_COEFFICIENTS = ("sigma_a", "sigma_sp")
NAMES = {"exit": "exit_law"}
"""Sources by the name that the budget has for them, where it differs."""
STATED = ("noise", "total", "scale", "length", "spot", "view", "g", "eta")
"""Errors that a slice may state."""


class Extra(NamedTuple):
    """What was found out about a batch by asking further models."""

    profiled: tuple[NDArray[np.int_], Profile] | None
    """Rows whose σa has a profile, and those."""
    model_error: Floats | None
    """(b, 2), relative, of σa and σs′; None where no table tells."""
    sensitivity: Mapping[str, Floats]
    other_models: Sequence[tuple[str, ...]]
    """Flags of rows that another g or η fits far better."""
    bias: Bias | None
    """That of a model which a table tells."""
    checked: bool
    """False where no table of the medium itself was at hand."""
    of_table: TableSays | None = None


class _Answer(NamedTuple):
    """By row: coefficients [1/mm] with their sd (b,) and 95 % intervals (b, 2)."""

    sigma_a: Floats
    sd_a: Floats
    interval_a: Floats
    sigma_sp: Floats
    sd_sp: Floats
    interval_sp: Floats
    correlation: Floats


class _Used(NamedTuple):
    """By row: data that counted, and the window that they span [mm], NaN without any."""

    n: NDArray[np.int_]
    window: Floats


def needs_profile(fitted: Fitted) -> Bools:
    """Rows whose linear errors do not describe σa: at its boundary, or near it where R is not an exact condition."""
    return fitted.plan.bent(fitted.found.point.q[:, 0], np.sqrt(covariances(fitted)[:, 1, 1]), PARABOLIC)


def covariances(fitted: Fitted) -> Floats:
    """(b, 2, 2) of (s, q), all sources."""
    covariance: Floats = sum(fitted.judged.sources.values())
    return covariance


def relative_sds(fitted: Fitted) -> Floats:
    """(b, 2) of σa and σs′, all sources."""
    turn = to_log(fitted.found.point.q)
    return np.sqrt(np.maximum(np.einsum("bij,bjk,bik->bi", turn, covariances(fitted), turn), 0.0))


def _shares(fitted: Fitted) -> dict[str, Floats]:
    """(b, 2) by source: shares of the variances of ln σa and ln σs′; they add up to 1."""
    turn = to_log(fitted.found.point.q)
    parts = {
        NAMES.get(name, name): np.einsum("bij,bjk,bik->bi", turn, each, turn)
        for name, each in fitted.judged.sources.items()
    }
    whole = np.maximum(sum(parts.values()), 1e-300)
    return {name: part / whole for name, part in parts.items()}


def channel_fits(fitted: Fitted, extra: Extra) -> list[ChannelFit]:
    """What is reported of every row."""
    answer, shares, used = _answers(fitted, extra), _shares(fitted), _used(fitted)
    off = np.zeros(len(fitted.jobs)) if extra.model_error is None else extra.model_error[:, 0]
    rel_sd = np.where(answer.sigma_a > 0, answer.sd_a / answer.sigma_a, np.inf)
    samples = in_samples(fitted, {name: each[:, 0] for name, each in shares.items()}, rel_sd, off)
    flags = _flags(fitted, extra, answer, used, samples)
    for row in np.flatnonzero(np.isfinite(np.concatenate(fitted.rival, axis=1)).all(axis=1)):
        if Flag.FEW_RADII not in flags[row]:
            _join_rival(fitted, answer, flags, int(row))
    columns = _columns(fitted, extra, answer, shares, used, samples, [tuple(each) for each in flags])
    return [ChannelFit(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)]


def _answers(fitted: Fitted, extra: Extra) -> _Answer:
    log_sigma, q = (each[:, 0] for each in fitted.found.point[:2])
    covariance, turn, sds = covariances(fitted), to_log(fitted.found.point.q), relative_sds(fitted)
    cross = np.einsum("bj,bjk,bk->b", turn[:, 0], covariance, turn[:, 1])
    sigma_a, sigma_sp = coefficients(log_sigma, q)
    interval = _linear_interval(log_sigma, q, np.sqrt(covariance[:, 1, 1]), sigma_a, sds[:, 0])
    sd_a = sigma_a * sds[:, 0]
    if extra.profiled is not None:
        rows, profile = extra.profiled
        sigma_a[rows], sigma_sp[rows] = profile.sigma_a, profile.sigma_sp
        interval[rows] = np.stack([profile.lower, profile.upper], axis=1)
        sd_a[rows] = (profile.upper - profile.lower) / (2 * Z95)
    sd_sp = sigma_sp * sds[:, 1]
    return _Answer(
        sigma_a, sd_a, interval, sigma_sp, sd_sp, spread_of(sigma_sp, sd_sp), cross / (sds[:, 0] * sds[:, 1])
    )


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


def _used(fitted: Fitted) -> _Used:
    b = len(fitted.jobs)
    count, lo, hi = np.zeros(b, int), np.full(b, np.inf), np.full(b, -np.inf)
    for c, used in zip(fitted.data.curves, fitted.judged.used, strict=True):
        count += ((c.known != 0).sum(axis=2) * used).sum(axis=1)
        lo = np.minimum(lo, np.where(used, c.r_lo, np.inf).min(axis=1))
        hi = np.maximum(hi, np.where(used, c.r_hi, -np.inf).max(axis=1))
    return _Used(count, np.where(np.isfinite(lo)[:, None], np.stack([lo, hi], axis=1), NAN))


def _columns(
    fitted: Fitted,
    extra: Extra,
    answer: _Answer,
    shares: Mapping[str, Floats],
    used: _Used,
    samples: Sequence[InSample],
    flags: Sequence[tuple[str, ...]],
) -> dict[str, Sequence[Any]]:
    """A value per row of each field of `ChannelFit`."""
    jobs, judged, known = fitted.jobs, fitted.judged, fitted.judged.errors_known
    statuses = [_status(names) for names in flags]
    told = np.array([status not in UNTOLD for status in statuses])
    told_a = told & [Flag.SIGMA_A_UNIDENTIFIABLE not in names for names in flags]
    bounded = told & [not sample.flags.get(Flag.SIGMA_A_UNIDENTIFIABLE) for sample in samples]
    shared = told_a & [status == "converged" for status in statuses]
    none = np.zeros((len(jobs), 0))

    def numbers(values: Floats, counts: Bools = told) -> list[float]:
        return np.where(counts, values, NAN).tolist()

    def pairs(values: Floats, counts: Bools = told) -> list[Any]:
        return list(zip(*(numbers(each, counts) for each in values.T), strict=True))

    return {
        "model": [fitted.model.name] * len(jobs),
        "sigma_a_per_mm": numbers(answer.sigma_a, told_a),
        "sigma_a_sd_per_mm": numbers(answer.sd_a, told_a),
        "sigma_a_interval95_per_mm": pairs(answer.interval_a, bounded),
        "sigma_sp_per_mm": numbers(answer.sigma_sp),
        "sigma_sp_sd_per_mm": numbers(answer.sd_sp),
        "sigma_sp_interval95_per_mm": pairs(answer.interval_sp),
        "correlation": numbers(answer.correlation),
        "total_r_measured": [_mean([p.total_r.get(job.channel, NAN) for p in job.pieces]) for job in jobs],
        "total_r_model": numbers(judged.seen.totals[0][0][:, 0]),
        "total_r_half_space": numbers(judged.seen.half[:, 0]),
        "tau_p": [sample.tau_p for sample in samples],
        "sample_effect": [(sample.log_total, sample.least_ratio) for sample in samples],
        "window_mm": pairs(used.window, np.ones_like(told)),
        "n": used.n.tolist(),
        "chi2_reduced": numbers(judged.chi2, known),
        "status": statuses,
        "flags": flags,
        "model_error": _named(_COEFFICIENTS, none if extra.model_error is None else extra.model_error, told),
        "sensitivity": _named(extra.sensitivity, np.stack([none.sum(1), *extra.sensitivity.values()], 1)[:, 1:], told),
        "budget": _budgets(shares, shared),
        "not_stated": [_not_stated(fitted, job, stated) for job, stated in zip(jobs, known.tolist(), strict=True)],
    }


def _named(names: Iterable[str], values: Floats, counts: Bools) -> list[dict[str, float]]:
    """A row's values (b, k) by name; nothing where it does not count."""
    names = tuple(names)
    return [
        dict(zip(names, row, strict=False)) if counted else {}
        for row, counted in zip(values.tolist(), counts.tolist(), strict=True)
    ]


def _budgets(shares: Mapping[str, Floats], counts: Bools) -> list[dict[str, dict[str, float]]]:
    """By coefficient the shares that are not 0."""
    by_row = np.stack(list(shares.values()), axis=2).tolist()
    return [
        {key: {name: share for name, share in zip(shares, of, strict=True) if share > 0}
         for key, of in zip(_COEFFICIENTS, both, strict=True)} if counted else {}
        for both, counted in zip(by_row, counts.tolist(), strict=True)
    ]  # fmt: skip


def _join_rival(fitted: Fitted, answer: _Answer, flags: list[list[str]], row: int) -> None:
    """One interval for two media that fit alike; where it would say nothing, that is said."""
    sigma_a, sigma_sp = (float(each) for each in coefficients(*(float(each[row, 0]) for each in fitted.rival[:2])))
    for interval, other in ((answer.interval_a, sigma_a), (answer.interval_sp, sigma_sp)):
        interval[row] = min(interval[row, 0], other), max(interval[row, 1], other)
    a, sp = answer.interval_a[row], answer.interval_sp[row]
    flags[row].append(Flag.TWO_MEDIA)
    far = sp[1] > TWO_MEDIA * sp[0] or a[1] > TWO_MEDIA**2 * max(a[0], 1e-300)
    if far and Flag.NOISE not in flags[row]:
        flags[row].append(Flag.NOISE)


@lru_cache(maxsize=4096)
def _status(flags: tuple[str, ...]) -> Status:
    if {Flag.FEW_RADII, Flag.NOISE} & set(flags):
        return "unidentifiable"
    if Flag.NOT_CONVERGED in flags:
        return "failed"
    if set(REJECTING) & set(flags):
        return "rejected"
    return "upper_bound" if {Flag.ALBEDO_ONE, Flag.TOTAL_AT_LIMIT} & set(flags) else "converged"


def _flags(fitted: Fitted, extra: Extra, answer: _Answer, used: _Used, samples: Sequence[InSample]) -> list[list[str]]:
    """By row the names from `Flag` that hold for this fit, and those of its slices."""
    held = _held(fitted, extra, answer, used)
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


def _held(fitted: Fitted, extra: Extra, answer: _Answer, used: _Used) -> dict[str, Bools]:
    """Which rows each flag holds for, by the fit itself; one value where it holds for all or none."""
    jobs, plan, judged, first = fitted.jobs, fitted.plan, fitted.judged, fitted.jobs[0].pieces
    biased, known = fitted.model.biased, judged.errors_known
    q, sigma_tp = fitted.found.point.q[:, 0], np.exp(fitted.found.point.log_sigma[:, 0])
    factors = [camera_factor(piece) for piece in first]
    totals = np.array(
        [[p.total_r.get(job.channel, NAN) / f for p, f in zip(job.pieces, factors, strict=True)] for job in jobs]
    )
    spots = np.array([max(p.spot_radius_mm or 0.0 for p in job.pieces) for job in jobs])
    pull, drift = (0.0, 0.0) if extra.bias is None else (BIAS_ROOM * extra.bias.pull, BIAS_ROOM * extra.bias.drift)
    table_pull, table_drift = (0.0, 0.0) if extra.of_table is None else extra.of_table
    found: dict[str, Any] = {
        Flag.ALBEDO_ONE: answer.interval_a[:, 0] <= 0,
        Flag.DIPOLE_UNCHECKED: biased and not extra.checked,
        Flag.FEW_RADII: used.n < FEWEST,
        Flag.G_ASSUMED: first[0].g is None and not biased,
        Flag.G_CLAMPED: is_clamped(first[0].g) and not biased,
        Flag.INCIDENCE_OBLIQUE: biased and any(p.incidence_deg >= OBLIQUE_DEG for p in first),
        Flag.JOINT: len(first) > 1,
        Flag.LIGHT_LOST: [
            any((p.lost_fraction or {}).get(job.channel, 0.0) > MAX_LOST for p in job.pieces) for job in jobs
        ],
        Flag.NOISE: ~(answer.sd_sp / answer.sigma_sp < MAX_REL_SD),
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
        Flag.SIGMA_A_UNIDENTIFIABLE: ~np.isfinite(answer.interval_a[:, 1]),
        Flag.SIDE_UNKNOWN: not biased and any(sight.slant > 0 for sight in plan.sights if sight.camera),
        Flag.SINGLE_SCATTERING: biased & (q > np.sqrt(1.5)),
        Flag.SPOT_WIDE: spots * sigma_tp > 1,
        Flag.TOTAL_AT_LIMIT: bool(plan.totals) & (totals >= 1).any(axis=1),
        Flag.TOTAL_INCONSISTENT: (np.abs(judged.pull) > MOST_PULL + pull) | (np.abs(table_pull) > MOST_PULL),
        Flag.TOTAL_UNKNOWN: np.isnan(totals).all(axis=1),
        Flag.WINDOW_SHORT: used.window[:, 1] * np.maximum(q, 0.0) * sigma_tp < 1,
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
