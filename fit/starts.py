"""Where a search begins: the nearest of a grid of media, by a few radii as of a narrow beam, and its rough optimum."""

from __future__ import annotations

from typing import Any

import numpy as np

from bssrdf.fit.laying import curve, lay_plainly
from bssrdf.fit.layout import Total
from bssrdf.fit.problem import Plan, Point, Problem, held_any
from bssrdf.fit.solve import ROUGH, TINY_MOVE, optimise
from bssrdf.transport import R_MAX
from bssrdf.transport.arrays import Engine
from bssrdf.transport.finite import Sample
from bssrdf.transport.light import Light
from bssrdf.transport.q_root import q_of_total
from bssrdf.transport.sample_light import q_of_sample, scanned

START_STEPS = 15
Q_GRID = np.geomspace(0.03, 1.6, 16)
VALLEYS = 4
"""Ranges of albedo in which a curve is looked for, each for itself: shape alone has a second minimum at another."""
ABOUT = np.array([1.0, 0.6, 1.5])
"""Factors on the q of R from which a fit with R starts: very dark media have two fixed points."""
LOG_EXTENT = np.linspace(np.log(0.3), np.log(1000.0), 24)
"""ln of (largest radius in mean free paths), tried for each curve."""
SCANNED = 3
"""Of the few radii of a start every third is scanned."""
LOST = 3.0
"""Misfit, in ln, of a radius that a start puts beyond the model's reach."""


def start(e: Engine, plan: Plan, model: Light, data: Problem, numbers: Any) -> Point:
    """The rough optimum from one of several places, by one number (b,) each or the same."""
    few, plain = _few_of(e, plan, data)
    if plan.totals:
        q = q_of_total(e, model, e.xp.minimum(data.totals[0].r, 1.0))  # of a sample for each scale, in `_scanned`
        qs = [e.xp.clip(q * ABOUT[numbers].reshape(-1, 1), 1e-6, model.q_max)]
    else:
        zero = 0 * data.curves[0].spot_radius
        qs = [zero + q.reshape(-1, 1) for q in Q_GRID.reshape(VALLEYS, -1).T[:, numbers]]
    begun = _scanned(e, plan, model, few, qs, numbers)
    laid = lay_plainly(e, plain, model, few, begun)
    ended = optimise(e, plain, model, few, laid, begun, ROUGH, relay=True, most=START_STEPS)
    finite = e.xp.isfinite(sum(ended.point))
    return Point(*(e.xp.where(finite, new, old) for new, old in zip(ended.point, begun, strict=True)))


def starts_of(plan: Plan) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Numbers of the starts that every problem takes, and of those for the doubtful."""
    if not plan.totals:
        return tuple(range(VALLEYS)), ()
    return (0,), tuple(range(1, len(ABOUT))) if plan.weighed else ()  # a condition leaves no choice of q


def _few_of(e: Engine, plan: Plan, data: Problem) -> tuple[Problem, Plan]:
    """A sample of the radii of every slice as plain curves of a narrow beam."""
    curves = tuple(
        c._replace(
            r_lo=c.few_r,
            r_hi=c.few_r,
            arc=0 * c.few_r,
            rd=c.few_rd[..., None],
            known=c.few_known[..., None],
            log_r=e.xp.log(c.few_r),
            within=c.few_known > 0,
        )
        for c in data.curves
    )
    plain = tuple(s._replace(camera=False, binned=False, inner=0, blurred=False, blur_inner=0) for s in plan.sights)
    totals = tuple(Total(e.xp.minimum(each.r, 1.0), each.sd) for each in data.totals)
    return data._replace(curves=curves, totals=totals), plan._replace(sights=plain, shared=(), robust=False)


def _scanned(e: Engine, plan: Plan, model: Light, few: Problem, qs: list[Any], numbers: Any) -> Point:
    """The scale of a grid whose curve of one of these q is nearest, in the logarithm."""
    xp = e.xp
    r = xp.concatenate([c.few_r[:, ::SCANNED] for c in few.curves], axis=1)
    rd = xp.concatenate([c.few_rd[:, ::SCANNED] for c in few.curves], axis=1)
    good = xp.concatenate([c.few_known[:, ::SCANNED] for c in few.curves], axis=1) * (rd > 0) > 0
    weight = good / xp.maximum(good.sum(1, keepdims=True), 1)
    log_rd = xp.log(xp.where(good, rd, 1.0))
    b, n = r.shape
    log_sigma = xp.asarray(LOG_EXTENT)[None, :] - xp.log(xp.max(xp.where(good, r, TINY_MOVE), axis=1, keepdims=True))
    log_sigma = xp.where(good.any(1)[:, None], log_sigma, 0.0)
    x = xp.maximum((xp.exp(log_sigma)[:, :, None] * r[:, None, :]).reshape(b, -1), 1e-3)
    costs, offsets, every_q = [], [], []
    for q in qs:
        at = _q_in_sample(e, plan, model, few, log_sigma, q, numbers)
        by_x = (xp.zeros((b, 1, n)) + at[:, :, None]).reshape(b, -1) if held_any(plan) else q
        shape = xp.log(xp.maximum(model.look(e, by_x, x)[0], 1e-300)).reshape(b, -1, n)
        shape = shape + _of_samples(e, plan, model, few, log_sigma, at)
        difference = log_rd[:, None, :] - shape - 2 * log_sigma[:, :, None]
        offset = (weight[:, None, :] * difference).sum(2)
        misfit = (weight[:, None, :] * xp.abs(difference - (offset[..., None] if plan.scale_free else 0.0))).sum(2)
        costs.append(misfit)
        offsets.append(offset)
        every_q.append(at)
    cost, offset, all_q = (xp.stack(each, 1).reshape(b, -1) for each in (costs, offsets, every_q))
    best = xp.argmin(xp.where(xp.isfinite(cost), cost, np.inf), axis=1)[:, None]
    q = xp.take_along_axis(all_q, best, axis=1)
    found = xp.take_along_axis(log_sigma, best % LOG_EXTENT.size, axis=1)
    c = xp.take_along_axis(offset, best, axis=1)
    return Point(found, q, c if plan.scale_free else 0 * c)


def _q_in_sample(e: Engine, plan: Plan, model: Light, few: Problem, log_sigma: Any, q: Any, numbers: Any) -> Any:
    """(b, s): q at each scale; in a sample whose R is known that hangs on the scale."""
    xp = e.xp
    if not plan.totals or plan.sights[plan.totals[0]].held == "half":
        return q + 0 * log_sigma
    b, s = log_sigma.shape
    sample = Sample(*((each + 0 * log_sigma).reshape(-1, 1) for each in few.samples[plan.totals[0]]))
    total_r = (few.totals[0].r + 0 * log_sigma).reshape(-1, 1)
    found = q_of_sample(e, model, False, sample, log_sigma.reshape(-1, 1), total_r)  # the wall is left for later
    return xp.clip(found.reshape(b, s) * ABOUT[numbers].reshape(-1, 1), 1e-3, model.q_max)


def _of_samples(e: Engine, plan: Plan, model: Light, few: Problem, log_sigma: Any, q: Any) -> Any:
    """ln of what the samples make of the scanned radii, (b, s, n)."""
    if not held_any(plan):
        return 0.0
    parts = [
        scanned(e, model, sample, log_sigma, q, c.few_r[:, ::SCANNED]) if sample
        else 0 * (log_sigma[:, :, None] + c.few_r[:, None, ::SCANNED])
        for sample, c in zip(few.samples, few.curves, strict=True)
    ]  # fmt: skip
    return e.xp.concatenate(parts, axis=2)


def misfit(e: Engine, plan: Plan, model: Light, data: Problem, at: Point) -> Any:
    """(b,): mean square of a start's relative misfit, cut at LOST for radii that the model does not reach or misses
    altogether."""
    xp = e.xp
    few, plain = _few_of(e, plan, data)
    laid = lay_plainly(e, plain, model, few, at)
    squares, count = 0.0, 0.0
    for k, c in enumerate(few.curves):
        value = curve(e, plain, model, laid, at, k)[0]
        x = xp.exp(at.log_sigma) * c.few_r
        off = xp.abs(xp.log(xp.maximum(c.few_rd, 1e-300) / xp.maximum(value, 1e-300)))
        off = xp.where((x > R_MAX) | ~xp.isfinite(off), LOST, xp.minimum(off, LOST))
        noise = 1 / xp.maximum(xp.abs(c.few_known * c.few_rd), 1e-6)
        good = (c.few_known > 0) & (c.few_rd > 0)
        squares = squares + (good * off * off / (1e-6 + xp.square(xp.minimum(noise, 1.0)))).sum(1)
        count = count + good.sum(1)
    return squares / xp.maximum(count, 1)
