"""What the objective asks of the model at a point: curves, totals, and the response to one standard deviation of each
shared error.

The responses are the model's: taken from noisy data they would pull the scale down (Peelle 1987). What costs more than
a look and moves little is laid at a point and used near it. Shapes as in `problem`.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np

from bssrdf.fit.observe import (
    QuadratureNodes,
    averaged,
    exit_modes,
    nodes,
    plain,
    seen_at,
    side_modes,
    side_of_total,
    total_seen,
)
from bssrdf.fit.problem import (
    OF_CURVE,
    OF_MEDIUM,
    OF_SAMPLE,
    TABLE_MODES,
    TABLE_SHARED,
    Laid,
    Looked,
    Neighbours,
    Plan,
    Point,
    Problem,
)
from bssrdf.transport import R_ZERO
from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import KNOT_STEP, NEAREST_MFP, Light
from bssrdf.transport.sample_light import curve_off, further, sampled, total_look

SLOPE_Q = 1e-4
"""Where the slope of the total at R = 1 is taken."""
SPOT_STEP = 0.02
TINY = 1e-300


def lay(
    e: Engine,
    plan: Plan,
    model: Light,
    data: Problem,
    at: Point,
    beside: Neighbours,
    grid: tuple[QuadratureNodes, ...] = (),
) -> Laid:
    """Exit law, spot and shared responses at a point; `grid` where it was made before, since no point moves it."""
    sights = list(zip(plan.sights, data.curves, strict=True))
    grid = grid or tuple(nodes(e, sight, c) for sight, c in sights)
    seen = tuple(seen_at(e, sight, model, c, at.log_sigma, at.q) for sight, c in sights)
    light = tuple(total_seen(e, plan.sights[k], model, at.q) for k in plan.totals)
    samples = _samples(e, plan, model, data, at, plain=False)
    return answering(e, plan, model, data, Laid(grid, seen, (), light, (), samples), at, beside)


def _samples(e: Engine, plan: Plan, model: Light, data: Problem, at: Point, *, plain: bool) -> tuple[Any, ...]:
    """Of each slice, at the root mean square radius of its annuli."""

    def of(k: int) -> Any:
        c, sample, kind = data.curves[k], data.samples[k], plan.sights[k].held
        if kind == "half":
            return ()
        r = e.xp.sqrt((c.r_lo * c.r_lo + c.r_hi * c.r_hi) / 2)
        errors = {"thickness_rel_sd": data.sds[k].thickness, "back_sd": data.sds[k].back}
        return sampled(e, model, kind == "dish", sample, at.log_sigma, at.q, r, plain=plain, **errors)

    return tuple(of(k) for k in range(len(plan.sights)))


def answering(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, beside: Neighbours, looks: Any = ()
) -> Laid:
    """With the shared responses of a point; `looks` where the curves there are known."""
    if not looks and any(each.source in OF_CURVE for each in plan.shared):
        looks = tuple(curve(e, plan, model, laid, at, k) for k in range(len(plan.sights)))
    return laid._replace(
        responses=tuple(_responses(e, plan, model, data, laid, at, looks, beside, k) for k in range(len(plan.sights))),
        total_responses=tuple(_total_responses(e, plan, model, data, laid, at, beside, k) for k in plan.totals),
    )


def costly(plan: Plan) -> bool:
    """Whether laying anew costs more than a step of the search: spot, camera, sample, or a model a little aside."""
    return any(s.blurred or s.camera or s.held != "half" for s in plan.sights) or any(
        each.source in OF_MEDIUM for each in plan.shared
    )


def lay_plainly(e: Engine, plan: Plan, model: Light, data: Problem, at: Point) -> Laid:
    """A narrow beam, seen over all directions, and no shared error: for a start."""
    grid = tuple(nodes(e, sight, c) for sight, c in zip(plan.sights, data.curves, strict=True))
    seen = tuple(plain(e, at.log_sigma, at.q) for _ in data.curves)
    none = tuple(e.xp.zeros((c.r_lo.shape[0], 0, c.r_lo.shape[1])) for c in data.curves)
    ones = tuple(e.xp.ones_like(at.q) for _ in plan.totals)
    samples = _samples(e, plan, model, data, at, plain=True)
    return Laid(grid, seen, none, ones, tuple(e.xp.zeros((at.q.shape[0], 0)) for _ in plan.totals), samples)


def curve(e: Engine, plan: Plan, model: Light, laid: Laid, at: Point, k: int) -> tuple[Any, Any, Any]:
    """What is seen of slice k, [1/mm²], and its slopes by ln σt′ and q."""
    xp = e.xp
    sigma = xp.exp(at.log_sigma)
    x = xp.maximum(sigma * laid.nodes[k].r, NEAREST_MFP)
    narrow = averaged(e, plan.sights[k], laid.nodes[k], model.look(e, at.q, x))
    seen = laid.seen[k]
    ahead = seen.by_log_sigma * (at.log_sigma - seen.log_sigma) + seen.by_q * (at.q - seen.q)
    ratio = sigma * sigma * xp.exp(seen.log_ratio + xp.clip(ahead, -1, 1) + at.log_scale)
    sample_s, sample_q = 0.0, 0.0
    if laid.samples[k]:
        of_sample, sample_s, sample_q = further(e, laid.samples[k], at.log_sigma, at.q)
        ratio = ratio * xp.exp(of_sample)
    value, by_x, by_q = (ratio * each for each in narrow)
    return value, value * (2 + seen.by_log_sigma + sample_s) + by_x, by_q + value * (seen.by_q + sample_q)


def look(e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point) -> Looked:
    """All that the objective asks of the model at a point."""
    curves = tuple(curve(e, plan, model, laid, at, k) for k in range(len(plan.sights)))
    beside_0 = e.xp.maximum(e.xp.abs(at.q), SLOPE_Q)
    value, slope = model.total(e, e.xp.concatenate([at.q, beside_0], axis=1))
    half = value[:, :1], 0.0 * at.q, slope[:, 1:]

    def of(k: int) -> tuple[Any, Any, Any]:
        kind = plan.sights[k].held
        if kind == "half":
            return half
        return total_look(e, model, kind == "dish", data.samples[k], at.log_sigma, beside_0)

    return Looked(curves, tuple(of(k) for k in plan.totals or (0,)), half[0])


def _responses(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, looks: Any, beside: Neighbours, k: int
) -> Any:
    """(b, K, u) of ln of slice k's curve."""
    xp = e.xp
    c, sds, sight = data.curves[k], data.sds[k], plan.sights[k]
    sigma = xp.exp(at.log_sigma)
    one = xp.ones_like(c.r_lo)
    view, by_eta = data.factor_slopes[k]
    tilt = float(np.sqrt(1 - sight.cos_view**2)) / sight.cos_view
    waves = exits = sides = None
    columns = []
    for error in plan.shared:
        if k not in error.slices:
            response = 0 * one
        elif error.source == "scale":
            response = sds.scale * one
        elif error.source == "length":
            response = _relative(xp, looks[k][1], looks[k][0])
            if laid.samples[k]:  # the scale of the picture is not that of the sample's depth
                response = response - laid.samples[k].by_lengths
            response = sds.length * response
        elif error.source == "view":
            response = sds.view * (tilt + view) * one
        elif error.source in OF_SAMPLE:
            response = getattr(laid.samples[k], f"by_{error.source}")
        elif error.source == "ratio":
            response = curve_off(laid.samples[k])
        elif error.source == "exit":
            exits = exits or exit_modes(e, sight, model, c, sigma)
            response = exits[error.mode]
        elif error.source == "side":
            sides = sides or side_modes(e, sight, model, c, sigma, at.q)
            response = sides[error.mode]
        elif error.source == "table":
            waves = waves or _waves(e, model, data, sigma, at.q, k)
            response = waves[error.mode]
        elif error.source == "spot":
            wider = seen_at(
                e, sight, model, c._replace(spot_radius=c.spot_radius * (1 + SPOT_STEP)), at.log_sigma, at.q
            )
            response = sds.spot * (wider.log_ratio - laid.seen[k].log_ratio) / SPOT_STEP
        else:
            other, step = beside[error.source]
            aside = curve(e, plan, other(), laid, at, k)[0]
            aside = xp.log(xp.maximum(_relative(xp, aside, looks[k][0]), TINY)) / step
            response = getattr(sds, error.source) * (aside + (by_eta if error.source == "eta" else 0.0))
        columns.append(response)
    return xp.stack(columns, axis=1) if columns else xp.zeros((one.shape[0], 0, one.shape[1]))


def _relative(xp: Any, part: Any, value: Any) -> Any:
    """part/value; 1 where the curve has sunk to 0."""
    return xp.where(value > 0, part, 1.0) / xp.where(value > 0, value, 1.0)


def _waves(e: Engine, model: Light, data: Problem, sigma: Any, q: Any, k: int) -> list[Any]:
    """The table's noise along slice k: cosines over the extent of all data, as the table counts radii."""
    xp = e.xp
    inner = reduce(xp.minimum, [c.reach[:, :1] for c in data.curves])
    outer = reduce(xp.maximum, [c.reach[:, 1:] for c in data.curves])
    lo, hi = (xp.log1p(sigma * xp.where(outer > 0, each, 0.0) / R_ZERO) for each in (inner, outer))
    span = xp.maximum(hi - lo, KNOT_STEP)
    x = xp.maximum(sigma * (data.curves[k].r_lo + data.curves[k].r_hi) / 2, NEAREST_MFP)
    first = xp.cos(np.pi * xp.clip((xp.log1p(x / R_ZERO) - lo) / span, 0, 1))
    level = TABLE_SHARED * model.shape_sd(e, q, x)
    cosines = [1 + 0 * first, first]
    while len(cosines) < TABLE_MODES:
        cosines.append(2 * first * cosines[-1] - cosines[-2])
    return [level * (cosine if j == 0 else np.sqrt(2) * cosine) for j, cosine in enumerate(cosines)]


def _total_responses(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, beside: Neighbours, k: int
) -> Any:
    """(b, K) of ln R of slice k."""
    xp = e.xp
    sds = data.sds[k]
    view, by_eta = data.factor_slopes[k]
    columns = []
    for error in plan.shared:
        response = 0.0 * at.q
        if k in error.slices and error.source == "scale":
            response = sds.scale + 0 * at.q
        elif k in error.slices and error.source == "view":
            response = sds.view * view + 0 * at.q
        elif k in error.slices and error.source == "side":
            response = side_of_total(plan.sights[k], model, at.q)[error.mode]
        elif k in error.slices and error.source in OF_SAMPLE:
            response = getattr(laid.samples[k], f"total_by_{error.source}")
        elif k in error.slices and error.source in ("eta", "g"):
            other, step = beside[error.source]
            aside = xp.log(other().total(e, at.q)[0] / model.total(e, at.q)[0]) / step
            response = getattr(sds, error.source) * (aside + (by_eta if error.source == "eta" else 0.0))
        columns.append(response)
    return xp.concatenate(columns, axis=1) if columns else xp.zeros((at.q.shape[0], 0))
