"""The objective: a sum of terms over named parameters, and errors that data share, which are parameters with priors.

A term gives its value, its slopes by s = ln σt′, q and c = ln of an unknown factor, and its response to one standard
deviation of each shared error. The responses are the model's: taken from noisy data they would pull the scale down
(Peelle 1987). No term knows what else is in the sum. Shapes: b problems, u radii of a slice, P parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from bssrdf.fit.layout import Curves, Sight, Total
from bssrdf.fit.observe import (
    NEAREST_MFP,
    Nodes,
    Seen,
    averaged,
    exit_modes,
    exit_rel_sd,
    nodes,
    plain,
    seen_at,
    total_seen,
)
from bssrdf.transport import R_ZERO
from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import KNOT_STEP, Light

Constraint = Literal["exact", "soft", "none"]
Source = Literal["scale", "length", "spot", "view", "exit", "table", "eta", "g"]
HUBER = 1.345
"""Standard deviations from which on a residual counts linearly: 95 % efficient on normal noise (Huber 1981)."""
TABLE_MODES = 4
"""Cosines along ln r by which a table's own noise is shared: more are too fine to look like a change of σa or σs′."""
EXIT_MODES = 2
"""Amplitude, and slope in ln r."""
FADE = 0.1
"""In ln r: over this a radius passes out of a window that hangs on the fit itself, so that no result jumps there."""
SLOPE_Q = 1e-4
"""Where the slope of the total at R = 1 is taken."""
SPOT_STEP = 0.02
TINY = 1e-300


class Shared(NamedTuple):
    """One error that several data share, as a column of the normal equations."""

    source: Source
    slices: tuple[int, ...]
    """Those that it touches, by their place in the problem."""
    mode: int = 0


class Plan(NamedTuple):
    """What is fixed within a batch, and compiled for."""

    constraint: Constraint
    scale_free: bool
    robust: bool
    sights: tuple[Sight, ...]
    """One a slice."""
    totals: tuple[int, ...]
    """The slice that each total belongs to."""
    shared: tuple[Shared, ...]


class Sds(NamedTuple):
    """Standard deviations that a slice states, (b, 1) each: scale, length and spot relative, view in rad."""

    scale: Any
    length: Any
    spot: Any
    view: Any
    eta: Any
    g: Any


class Problem(NamedTuple):
    """The data of a batch: by slice, and by total."""

    curves: tuple[Curves, ...]
    totals: tuple[Total, ...]
    sds: tuple[Sds, ...]
    factor_slopes: tuple[tuple[float, float], ...]
    """By slice, d ln of the slice's convention by view angle [1/rad] and by η."""


class Point(NamedTuple):
    """Parameters, (b, 1) each."""

    log_sigma: Any
    q: Any
    log_scale: Any


class Laid(NamedTuple):
    """What costs more than a look and moves little: worked out at a point, used near it. By slice."""

    nodes: tuple[Nodes, ...]
    seen: tuple[Seen, ...]
    responses: tuple[Any, ...]
    """(b, K, u): of ln of the curve to one sd of each shared error."""
    total_seen: tuple[Any, ...]
    total_responses: tuple[Any, ...]
    """By total, (b, K): of ln R."""


class Weights(NamedTuple):
    """Weights in force. By slice: (b, u) Σ w² over the data of a radius, and their weighted mean."""

    mass: tuple[Any, ...]
    mean: tuple[Any, ...]


class System(NamedTuple):
    """Normal equations in all parameters (s, q, c, then shared errors), with priors; and the totals' rows."""

    cost: Any
    gradient: Any
    """(b, P): Xᵀ W (data − model)."""
    matrix: Any
    """(b, P, P)."""


Neighbours = Mapping[str, tuple[Light, float]]
"""By `eta` and `g`: a model a little aside, and how far."""


def lay(e: Engine, plan: Plan, model: Light, data: Problem, at: Point, beside: Neighbours) -> Laid:
    """Nodes, exit law, spot and shared responses at a point."""
    sights = list(zip(plan.sights, data.curves, strict=True))
    grid = tuple(nodes(e, sight, c) for sight, c in sights)
    seen = tuple(seen_at(e, sight, model, c, at.log_sigma, at.q) for sight, c in sights)
    light = [total_seen(e, plan.sights[k], model, at.q) for k in plan.totals]
    begun = Laid(grid, seen, (), tuple(light), ())
    return begun._replace(
        responses=tuple(_responses(e, plan, model, data, begun, at, beside, k) for k in range(len(sights))),
        total_responses=tuple(_total_responses(e, plan, model, data, at, beside, k) for k in plan.totals),
    )


def lay_plainly(e: Engine, plan: Plan, data: Problem, at: Point) -> Laid:
    """A narrow beam, seen over all directions, and no shared error: for a start."""
    grid = tuple(nodes(e, sight, c) for sight, c in zip(plan.sights, data.curves, strict=True))
    seen = tuple(plain(e, c.r_lo, at.log_sigma, at.q) for c in data.curves)
    none = tuple(e.xp.zeros((c.r_lo.shape[0], 0, c.r_lo.shape[1])) for c in data.curves)
    ones = tuple(e.xp.ones_like(at.q) for _ in plan.totals)
    return Laid(grid, seen, none, ones, tuple(e.xp.zeros((at.q.shape[0], 0)) for _ in plan.totals))


def curve(e: Engine, plan: Plan, model: Light, laid: Laid, at: Point, k: int) -> tuple[Any, Any, Any]:
    """What is seen of slice k, [1/mm²], and its slopes by ln σt′ and q."""
    xp = e.xp
    sigma = xp.exp(at.log_sigma)
    x = xp.maximum(sigma * laid.nodes[k].r, NEAREST_MFP)
    narrow = averaged(e, plan.sights[k], laid.nodes[k], model.look(e, at.q, x))
    seen = laid.seen[k]
    ahead = seen.by_log_sigma * (at.log_sigma - seen.log_sigma) + seen.by_q * (at.q - seen.q)
    ratio = sigma * sigma * xp.exp(seen.log_ratio + xp.clip(ahead, -1, 1) + at.log_scale)
    value, by_x, by_q = (ratio * each for each in narrow)
    return value, value * (2 + seen.by_log_sigma) + by_x, by_q + value * seen.by_q


def total(e: Engine, model: Light, q: Any) -> tuple[Any, Any]:
    """R, with its slope taken beside q = 0."""
    return model.total(e, q)[0], model.total(e, e.xp.maximum(e.xp.abs(q), SLOPE_Q))[1]


def weigh(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, values: tuple[Any, ...], shared: Any
) -> Weights:
    """Window and weights about the model's curve `values` and not about the data; `shared`: fitted shared errors."""
    xp = e.xp
    masses, means = [], []
    for k, c in enumerate(data.curves):
        w2 = squares(e, plan, model, data, at, values[k], k)
        if plan.robust:
            fitted = values[k] * (1 + (laid.responses[k] * shared[:, :, None]).sum(1))
            w2 = w2 * _huber(e, c, w2, fitted)
        mass = w2.sum(2)
        masses.append(mass)
        means.append((w2 * c.rd).sum(2) / xp.where(mass > 0, mass, 1.0))
    return Weights(tuple(masses), tuple(means))


def squares(e: Engine, plan: Plan, model: Light, data: Problem, at: Point, value: Any, k: int) -> Any:
    """w² of each datum (b, u, m): 1/(sd² + what the model may be off by²), or 1/value² where no error is known."""
    xp = e.xp
    c = data.curves[k]
    value = xp.maximum(value, TINY**0.25)
    inside = window(e, model, c, at.log_sigma)[..., None] * (c.known != 0)
    allowed = xp.square(model_sd(e, plan, model, data, at, value, k))[..., None]
    known2 = c.known * c.known
    relative = 1 / xp.square(value)[..., None] + 0 * known2
    return inside * xp.where(c.errors_known[..., None], known2 / (1 + known2 * allowed), relative)


def model_sd(e: Engine, plan: Plan, model: Light, data: Problem, at: Point, value: Any, k: int) -> Any:
    """What the model may be off by at each radius for itself."""
    relative = e.xp.zeros_like(value) + model.relative_error
    if plan.sights[k].camera:
        relative = e.xp.hypot(relative, exit_rel_sd(e, model, data.curves[k], e.xp.exp(at.log_sigma)))
    return relative * value


def window(e: Engine, model: Light, c: Curves, log_sigma: Any) -> Any:
    """1 within the caller's window and the model's, which fades out, else 0."""
    xp = e.xp
    given = (c.r_lo >= c.window[:, :1]) & (c.r_hi <= c.window[:, 1:])
    log_x = xp.log(xp.maximum(c.r_lo + c.r_hi, TINY) / 2) + log_sigma
    lo, hi = model.window_mfp
    inside = xp.clip((np.log(hi) - log_x) / FADE + 0.5, 0, 1)
    if lo > 0:
        inside = inside * xp.clip((log_x - np.log(lo)) / FADE + 0.5, 0, 1)
    return given * inside


def _huber(e: Engine, c: Curves, w2: Any, fitted: Any) -> Any:
    xp = e.xp
    distance = xp.abs(c.rd - fitted[..., None]) * xp.sqrt(w2)
    b = distance.shape[0]
    ordered = xp.sort(xp.where(w2 > 0, distance, np.inf).reshape(b, -1), axis=1)
    middle = xp.clip((w2 > 0).reshape(b, -1).sum(1) // 2, 0, ordered.shape[1] - 1)
    median = xp.take_along_axis(ordered, middle[:, None], axis=1)
    scatter = xp.where(c.errors_known, 1.0, median / 0.6745)[..., None]
    return xp.minimum(1.0, HUBER * scatter / xp.maximum(distance, 1e-12))


def system(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, looks: Any, by: Weights
) -> System:
    """The sum over curves, soft totals and priors."""
    xp = e.xp
    cost = gradient = matrix = 0.0
    for k, look in enumerate(looks):
        x = rows_of(e, laid, look, k)
        weighed = x * by.mass[k][:, None, :]
        miss = by.mean[k] - look[0]
        cost = cost + (by.mass[k] * miss * miss).sum(1)
        gradient = gradient + (weighed * miss[:, None, :]).sum(2)
        matrix = matrix + xp.matmul(weighed, xp.swapaxes(x, 1, 2))
    if plan.constraint == "soft":
        for k in range(len(plan.totals)):
            gap, row = total_row(e, model, data, laid, at, k)
            w = (1 / data.totals[k].sd) ** 2
            cost = cost + (w * gap * gap)[:, 0]
            gradient = gradient + w * gap * row
            matrix = matrix + (w * row)[:, :, None] * row[:, None, :]
    return System(cost, gradient, matrix + prior(e, plan))


def rows_of(e: Engine, laid: Laid, look: tuple[Any, Any, Any], k: int) -> Any:
    """(b, P, u): slopes of slice k by every parameter."""
    value, by_s, by_q = look
    free = e.xp.stack([by_s, by_q, value], axis=1)
    return e.xp.concatenate([free, value[:, None, :] * laid.responses[k]], axis=1)


def total_row(e: Engine, model: Light, data: Problem, laid: Laid, at: Point, k: int) -> tuple[Any, Any]:
    """R measured less that of the model (b, 1), and its slopes by every parameter (b, P)."""
    xp = e.xp
    value, by_q = total(e, model, at.q)
    zero = xp.zeros_like(value)
    row = xp.concatenate([zero, by_q, zero, value * laid.total_responses[k]], axis=1)
    return data.totals[k].r / laid.total_seen[k] - value, row


def prior(e: Engine, plan: Plan) -> Any:
    """Unit information on each shared error; none on s, q and c."""
    return e.xp.asarray(np.diag([0.0, 0.0, 0.0] + [1.0] * len(plan.shared)))


def _responses(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, beside: Neighbours, k: int
) -> Any:
    """(b, K, u) of ln of slice k's curve."""
    xp = e.xp
    c, sds, sight = data.curves[k], data.sds[k], plan.sights[k]
    value, by_s, _ = curve(e, plan, model, laid, at, k)
    sigma = xp.exp(at.log_sigma)
    x = xp.maximum(sigma * (c.r_lo + c.r_hi) / 2, NEAREST_MFP)
    one = xp.ones_like(value)
    modes = _cosines(xp, x, _extent(xp, data, sigma))
    view, by_eta = data.factor_slopes[k]
    tilt = float(np.sqrt(1 - sight.cos_view**2)) / sight.cos_view
    columns = []
    for error in plan.shared:
        if k not in error.slices:
            response = 0 * one
        elif error.source == "scale":
            response = sds.scale * one
        elif error.source == "length":
            response = sds.length * by_s / value
        elif error.source == "view":
            response = sds.view * (tilt + view) * one
        elif error.source == "exit":
            response = exit_modes(e, model, c, sigma)[error.mode]
        elif error.source == "table":
            response = model.shape_sd(e, at.q, x) * modes[error.mode]
        elif error.source == "spot":
            wider = seen_at(
                e, sight, model, c._replace(spot_radius=c.spot_radius * (1 + SPOT_STEP)), at.log_sigma, at.q
            )
            response = sds.spot * (wider.log_ratio - laid.seen[k].log_ratio) / SPOT_STEP
        else:
            other, step = beside[error.source]
            aside = xp.log(xp.maximum(curve(e, plan, other, laid, at, k)[0], TINY) / xp.maximum(value, TINY)) / step
            response = getattr(sds, error.source) * (aside + (by_eta if error.source == "eta" else 0.0))
        columns.append(xp.where(value > 0, response, 0.0))
    return xp.stack(columns, axis=1) if columns else xp.zeros((value.shape[0], 0, value.shape[1]))


def _extent(xp: Any, data: Problem, sigma: Any) -> tuple[Any, Any]:
    """Innermost and outermost of all radii that count, (b, 1) each, as the table counts them."""
    lo, hi = np.inf + 0 * sigma, -np.inf + 0 * sigma
    for c in data.curves:
        used = (c.known != 0).any(2) & (c.r_lo >= c.window[:, :1]) & (c.r_hi <= c.window[:, 1:])
        v = xp.log1p(sigma * (c.r_lo + c.r_hi) / 2 / R_ZERO)
        lo = xp.minimum(lo, xp.where(used, v, np.inf).min(1, keepdims=True))
        hi = xp.maximum(hi, xp.where(used, v, -np.inf).max(1, keepdims=True))
    some = hi > lo
    return xp.where(some, lo, 0.0), xp.where(some, hi, 1.0)


def _cosines(xp: Any, x: Any, extent: tuple[Any, Any]) -> list[Any]:
    """Cosines over the data's extent, of the size that noise independent by knot has along them."""
    lo, hi = extent
    span = xp.maximum(hi - lo, KNOT_STEP)
    t = xp.clip((xp.log1p(x / R_ZERO) - lo) / span, 0, 1)
    share = xp.sqrt(KNOT_STEP / span)
    return [share * xp.ones_like(t)] + [np.sqrt(2) * share * xp.cos(np.pi * j * t) for j in range(1, TABLE_MODES)]


def _total_responses(e: Engine, plan: Plan, model: Light, data: Problem, at: Point, beside: Neighbours, k: int) -> Any:
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
        elif k in error.slices and error.source in ("eta", "g"):
            other, step = beside[error.source]
            aside = xp.log(other.total(e, at.q)[0] / model.total(e, at.q)[0]) / step
            response = getattr(sds, error.source) * (aside + (by_eta if error.source == "eta" else 0.0))
        columns.append(response)
    return xp.concatenate(columns, axis=1) if columns else xp.zeros((at.q.shape[0], 0))
