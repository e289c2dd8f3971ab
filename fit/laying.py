"""What the objective asks of the model at a point: curves, totals, and the response to one standard deviation of each
shared error.

The responses are the model's: taken from noisy data they would pull the scale down (Peelle 1987). What costs more than
a look and moves little is laid at a point and used near it. Shapes as in `problem`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np

from bssrdf.fit.problem import OF_CURVE, OF_MEDIUM, Laid, Looked, Neighbours, Plan, Point, Problem, Source
from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import NEAREST_MFP, Light
from bssrdf.transport.light_errors import exit_modes, side_modes, side_of_total, table_modes
from bssrdf.transport.observed import QuadratureNodes, averaged, middles, nodes, plain, seen_at, total_seen
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
    c, sds, sight, sample = data.curves[k], data.sds[k], plan.sights[k], laid.samples[k]
    by_view, by_eta = data.factor_slopes[k]
    tilt = float(np.sqrt(1 - sight.cos_view**2)) / sight.cos_view

    def lengths() -> Any:
        response = _relative(e, looks[k][1], looks[k][0])
        # the scale of the picture is not that of the sample's depth
        return sds.length * (response - sample.by_lengths if sample else response)

    def spot() -> Any:
        wider = c._replace(spot_radius=c.spot_radius * (1 + SPOT_STEP))
        moved = seen_at(e, sight, model, wider, at.log_sigma, at.q).log_ratio - laid.seen[k].log_ratio
        return sds.spot * moved / SPOT_STEP

    def aside(source: str) -> Any:
        made, step = beside[source]
        there = curve(e, plan, made(), laid, at, k)[0]
        return e.xp.log(e.xp.maximum(_relative(e, there, looks[k][0]), TINY)) / step

    def table() -> tuple[Any, ...]:
        inner = reduce(e.xp.minimum, [each.reach[:, :1] for each in data.curves])
        outer = reduce(e.xp.maximum, [each.reach[:, 1:] for each in data.curves])
        first, last = (e.xp.exp(at.log_sigma) * e.xp.where(outer > 0, each, 0.0) for each in (inner, outer))
        return table_modes(e, model, at.q, middles(e, c, at.log_sigma), first, last)

    modes: _Modes = {
        "scale": lambda: (sds.scale,),
        "length": lambda: (lengths(),),
        "spot": lambda: (spot(),),
        "view": lambda: (sds.view * (tilt + by_view),),
        "exit": lambda: exit_modes(e, model, sight.cos_view, middles(e, c, at.log_sigma), c.arc),
        "side": lambda: side_modes(e, model, sight.cos_view, sight.slant, at.q, middles(e, c, at.log_sigma), c.arc),
        "table": table,
        "eta": lambda: (sds.eta * (aside("eta") + by_eta),),
        "g": lambda: (sds.g * aside("g"),),
        "thickness": lambda: (sample.by_thickness,),
        "back": lambda: (sample.by_back,),
        "ratio": lambda: (curve_off(sample),),
    }
    columns = _columns(plan, modes, e.xp.zeros_like(c.r_lo), k)
    return e.xp.stack(columns, axis=1) if columns else e.xp.zeros((c.r_lo.shape[0], 0, c.r_lo.shape[1]))


def _total_responses(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, beside: Neighbours, k: int
) -> Any:
    """(b, K) of ln R of slice k."""
    sds, sample = data.sds[k], laid.samples[k]
    by_view, by_eta = data.factor_slopes[k]

    def aside(source: str) -> Any:
        made, step = beside[source]
        return e.xp.log(made().total(e, at.q)[0] / model.total(e, at.q)[0]) / step

    modes: _Modes = {
        "scale": lambda: (sds.scale,),
        "view": lambda: (sds.view * by_view,),
        "side": lambda: side_of_total(model, plan.sights[k].slant, at.q),
        "eta": lambda: (sds.eta * (aside("eta") + by_eta),),
        "g": lambda: (sds.g * aside("g"),),
        "thickness": lambda: (sample.total_by_thickness,),
        "back": lambda: (sample.total_by_back,),
    }
    columns = _columns(plan, modes, 0.0 * at.q, k)
    return e.xp.concatenate(columns, axis=1) if columns else e.xp.zeros((at.q.shape[0], 0))


_Modes = dict[Source, Callable[[], tuple[Any, ...]]]
"""By source what one sd of each mode does."""


def _columns(plan: Plan, modes: _Modes, zero: Any, k: int) -> list[Any]:
    """A column for each shared error: 0 where slice k, or this datum of it, has none of it."""
    touching = {each.source for each in plan.shared if k in each.slices and each.source in modes}
    made = {source: modes[source]() for source in touching}
    return [
        zero + made[each.source][each.mode] if each.source in made and k in each.slices else zero
        for each in plan.shared
    ]


def _relative(e: Engine, part: Any, value: Any) -> Any:
    """part/value; 1 where the curve has sunk to 0."""
    return e.xp.where(value > 0, part, 1.0) / e.xp.where(value > 0, value, 1.0)
