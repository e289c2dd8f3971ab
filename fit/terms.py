"""The objective: a sum of terms over named parameters, and errors that data share, which are parameters with priors.

A term gives its value, its slopes by s = ln σt′, q and c = ln of an unknown factor, and its response to one standard
deviation of each shared error. The responses are the model's: taken from noisy data they would pull the scale down
(Peelle 1987). No term knows what else is in the sum. Shapes: b problems, u radii of a slice, P parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import Any, Literal, NamedTuple

import numpy as np

from bssrdf.fit.finite import Errors, curve_off, further, q_of_sample, sampled, total_look, total_off
from bssrdf.fit.layout import Curves, Sight, Total
from bssrdf.fit.observe import (
    NEAREST_MFP,
    QuadratureNodes,
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
from bssrdf.transport.light import KNOT_STEP, Light, q_of_total

Constraint = Literal["exact", "soft", "none"]
Source = Literal["scale", "length", "spot", "view", "exit", "table", "eta", "g", "thickness", "back", "ratio"]
HUBER = 1.345
"""Standard deviations from which on a residual counts linearly: 95 % efficient on normal noise (Huber 1981)."""
TABLE_MODES = 4
"""Cosines along ln r by which a table's own noise is shared: more are too fine to look like a change of σa or σs′."""
EXIT_MODES = 2
"""Amplitude, and slope in ln r."""
FADE = 0.1
"""In ln r: over this a radius passes out of a window that hangs on the fit itself, so that no result jumps there."""
OF_MEDIUM: tuple[Source, ...] = ("eta", "g")
OF_SAMPLE: tuple[Source, ...] = ("thickness", "back")
OF_CURVE: tuple[Source, ...] = ("length", *OF_MEDIUM)
"""Errors whose responses ask for the curve itself."""
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

    totals: tuple[int, ...]
    """The slice that each R belongs to; none where R does not count."""
    exact: bool
    """Whether R is a condition, which fixes q, and not a datum."""
    scale_free: bool
    robust: bool
    sights: tuple[Sight, ...]
    """One a slice."""
    shared: tuple[Shared, ...]

    @property
    def free(self) -> tuple[int, ...]:
        """Columns that move beside shared errors: s, q unless R fixes it, c where the scale is unknown."""
        return (0, *(() if self.exact else (1,)), *((2,) if self.scale_free else ()))

    @property
    def weighed(self) -> int:
        """How many R are data."""
        return 0 if self.exact else len(self.totals)

    @property
    def curve_alone(self) -> Plan:
        """The same without R, where R is a condition."""
        return self._replace(totals=(), exact=False) if self.exact else self


class Sds(NamedTuple):
    """Standard deviations that a slice states, (b, 1) each: scale, length and spot relative, view in rad."""

    scale: Any
    length: Any
    spot: Any
    view: Any
    eta: Any
    g: Any
    thickness: Any
    """Relative."""
    back: Any
    """Of its reflectance."""


class Problem(NamedTuple):
    """The data of a batch: by slice, and by total."""

    curves: tuple[Curves, ...]
    totals: tuple[Total, ...]
    sds: tuple[Sds, ...]
    factor_slopes: tuple[tuple[float, float], ...]
    """By slice, d ln of the slice's convention by view angle [1/rad] and by η."""
    samples: tuple[Any, ...]
    """By slice a `Sample`, empty for a half space."""


class Point(NamedTuple):
    """Parameters, (b, 1) each."""

    log_sigma: Any
    q: Any
    log_scale: Any


class Laid(NamedTuple):
    """What costs more than a look and moves little: worked out at a point, used near it. By slice."""

    nodes: tuple[QuadratureNodes, ...]
    seen: tuple[Seen, ...]
    responses: tuple[Any, ...]
    """(b, K, u): of ln of the curve to one sd of each shared error."""
    total_seen: tuple[Any, ...]
    total_responses: tuple[Any, ...]
    """By total, (b, K): of ln R."""
    samples: tuple[Any, ...]
    """By slice a `Sampled`, empty for a half space."""


class Looked(NamedTuple):
    """What the model has at a point."""

    curves: tuple[tuple[Any, Any, Any], ...]
    """By slice, (b, u) each: what is seen [1/mm²] and its slopes by ln σt′ and q."""
    totals: tuple[tuple[Any, Any, Any], ...]
    """By total: R and its slopes by ln σt′ and q, the latter taken beside q = 0."""
    half: Any
    """R of a half space."""


class Gaps(NamedTuple):
    """By total."""

    gaps: tuple[Any, ...]
    """(b, 1): R measured less that of the model."""
    rows: tuple[Any, ...]
    """(b, P): slopes of the model's by every parameter."""
    sds: tuple[Any, ...]
    """(b, 1): of R measured, and of what back and wall make of it."""


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
        errors = Errors(data.sds[k].thickness, data.sds[k].back)
        return sampled(e, model, kind == "dish", sample, errors, at.log_sigma, at.q, r, plain=plain)

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


def held_any(plan: Plan) -> bool:
    """Whether a slice is of a finite sample."""
    return any(s.held != "half" for s in plan.sights)


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


def totals_of(e: Engine, plan: Plan, data: Problem, laid: Laid, seen: Looked) -> Gaps:
    """R measured against that of the model."""
    xp = e.xp
    gaps, rows, sds = [], [], []
    for k, each, law, (value, by_s, by_q), response in zip(
        plan.totals, data.totals, laid.total_seen, seen.totals, laid.total_responses, strict=False
    ):
        gaps.append(each.r / law - value)
        rows.append(xp.concatenate([by_s, by_q, xp.zeros_like(value), value * response], axis=1))
        sds.append(xp.hypot(each.sd, total_off(laid.samples[k]) * each.r) if laid.samples[k] else each.sd)
    return Gaps(tuple(gaps), tuple(rows), tuple(sds))


def keeping(plan: Plan, totals: Gaps) -> tuple[Any, Any] | None:
    """Where R is a condition: (b, P) what q falls by as each other parameter grows, and (b, 1) what it lacks."""
    if not plan.exact:
        return None
    (gap,), (row,), _ = totals
    return row / row[:, 1:2], gap / row[:, 1:2]


def elimination(e: Engine, keeps: tuple[Any, Any]) -> tuple[Any, Any]:
    """(b, P, P) that lifts a move of all other parameters to one that keeps R, and the (b, P) move that meets R."""
    xp = e.xp
    falls, missing = keeps
    eye = np.eye(falls.shape[1])
    unit = xp.asarray(eye[1])
    return xp.asarray(eye) - unit[None, :, None] * falls[:, None, :], unit[None, :] * missing


def meeting(e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point) -> Point:
    """The point, where R is a condition with the q that meets it."""
    if not plan.exact:
        return at
    seen = data.totals[0].r / laid.total_seen[0]
    kind, least = plan.sights[plan.totals[0]].held, e.xp.minimum(seen, 1.0)
    if kind == "half":
        q = q_of_total(e, model, least)
    else:
        q = q_of_sample(e, model, kind == "dish", data.samples[plan.totals[0]], at.log_sigma, least)
    return at._replace(q=e.xp.where(seen < 1, q, at.q))


def weigh(
    e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, seen: Looked, shared: Any
) -> Weights:
    """Window and weights about the model's curve and not about the data; `shared`: fitted shared errors."""
    xp = e.xp
    masses, means = [], []
    for k, c in enumerate(data.curves):
        value = seen.curves[k][0]
        w2 = squares(e, plan, model, data, laid, at, value, k)
        if plan.robust:
            w2 = w2 * _huber(e, c, w2, value * (1 + answer_of(e, laid.responses[k], shared)))
        mass = over_data(w2)
        masses.append(mass)
        means.append(over_data(w2 * c.rd) / xp.where(mass > 0, mass, 1.0))
    return Weights(tuple(masses), tuple(means))


def over_data(each: Any) -> Any:
    """The sum over the few data of a radius, (b, u): faster than that of an array library over so short an axis."""
    return sum(each[..., k] for k in range(1, each.shape[-1])) + each[..., 0]


def answer_of(e: Engine, responses: Any, shared: Any) -> Any:
    """What shared errors of this size do to ln of a curve, (b, u)."""
    return e.xp.matmul(shared[:, None, :], responses)[:, 0]


def squares(e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, value: Any, k: int) -> Any:
    """w² of each datum (b, u, m): 1/(sd² + what the model may be off by²), or 1/value² where no error is known."""
    xp = e.xp
    c = data.curves[k]
    value = xp.maximum(value, TINY**0.25)
    allowed = xp.square(model_sd(e, plan, model, data, laid, at, value, k))[..., None]
    known2 = c.known * c.known
    relative = (known2 != 0) / xp.square(value)[..., None]
    w2 = xp.where(c.errors_known[..., None], known2 / (1 + known2 * allowed), relative)
    return window(e, model, c, at.log_sigma)[..., None] * w2


def model_sd(e: Engine, plan: Plan, model: Light, data: Problem, laid: Laid, at: Point, value: Any, k: int) -> Any:
    """What the model may be off by at each radius for itself."""
    relative: Any = model.relative_error
    if laid.samples[k]:
        relative = e.xp.hypot(relative, 2 * curve_off(laid.samples[k]))
    if plan.sights[k].camera:
        relative = e.xp.hypot(relative, exit_rel_sd(e, model, data.curves[k], e.xp.exp(at.log_sigma)))
    return value * relative


def window(e: Engine, model: Light, c: Curves, log_sigma: Any) -> Any:
    """1 within the caller's window and the model's, which fades out, else 0."""
    xp = e.xp
    log_x = c.log_r + log_sigma
    lo, hi = model.window_mfp
    inside = c.within * xp.clip((np.log(hi) - log_x) / FADE + 0.5, 0, 1)
    return inside * xp.clip((log_x - np.log(lo)) / FADE + 0.5, 0, 1) if lo > 0 else inside


def _huber(e: Engine, c: Curves, w2: Any, fitted: Any) -> Any:
    xp = e.xp
    distance = xp.abs(c.rd - fitted[..., None]) * xp.sqrt(w2)
    b = distance.shape[0]
    ordered = xp.sort(xp.where(w2 > 0, distance, np.inf).reshape(b, -1), axis=1)
    middle = xp.clip((w2 > 0).reshape(b, -1).sum(1) // 2, 0, ordered.shape[1] - 1)
    median = xp.take_along_axis(ordered, middle[:, None], axis=1)
    scatter = xp.where(c.errors_known, 1.0, median / 0.6745)[..., None]
    return xp.minimum(1.0, HUBER * scatter / xp.maximum(distance, 1e-12))


def system(e: Engine, plan: Plan, data: Problem, laid: Laid, seen: Looked, totals: Gaps, by: Weights) -> System:
    """The sum over curves, soft totals and priors."""
    xp = e.xp
    size = 3 + len(plan.shared)
    whole: Any = 0.0
    for k, each in enumerate(seen.curves):
        root = xp.sqrt(by.mass[k])
        rows = rows_of(e, laid, tuple(root * part for part in each), k, root * (by.mean[k] - each[0]))
        whole = whole + xp.matmul(rows, xp.swapaxes(rows, 1, 2))
    for gap, row, sd in list(zip(*totals, strict=True))[: plan.weighed]:
        one = xp.concatenate([row, gap], axis=1) / sd
        whole = whole + one[:, :, None] * one[:, None, :]
    return System(whole[:, size, size], whole[:, :size, size], whole[:, :size, :size] + prior(e, plan))


def cost_at(e: Engine, plan: Plan, data: Problem, laid: Laid, seen: Looked, by: Weights) -> Any:
    """The objective (b,) with shared errors at their best; where R is exact, at the q near by that meets it."""
    xp = e.xp
    gaps, rows, sds = totals = totals_of(e, plan, data, laid, seen)
    keeps = keeping(plan, totals)
    whole: Any = 0.0
    for k, (value, _, by_q) in enumerate(seen.curves):
        parts = [*(value * each for each in _by_error(laid.responses[k])), by.mean[k] - value]
        if keeps is not None:
            away = xp.concatenate([keeps[0][:, 3:], keeps[1]], axis=1)
            parts = [part - by_q * away[:, j : j + 1] for j, part in enumerate(parts)]
        stacked = xp.stack(parts, axis=1) * xp.sqrt(by.mass[k])[:, None, :]
        whole = whole + xp.matmul(stacked, xp.swapaxes(stacked, 1, 2))
    for gap, row, sd in list(zip(gaps, rows, sds, strict=True))[: plan.weighed]:
        one = xp.concatenate([row[:, 3:], gap], axis=1) / sd
        whole = whole + one[:, :, None] * one[:, None, :]
    if not plan.shared:
        return whole[:, 0, 0]
    fall = whole[:, :-1, -1]
    best = xp.linalg.solve(whole[:, :-1, :-1] + xp.eye(fall.shape[1]), fall[:, :, None])[:, :, 0]
    return whole[:, -1, -1] - (fall * best).sum(1)


def rows_of(e: Engine, laid: Laid, seen: tuple[Any, Any, Any], k: int, miss: Any = None) -> Any:
    """(b, P, u): slopes of slice k by every parameter, as large as what is `seen`; and `miss` as a last row."""
    value, by_s, by_q = seen
    rows = [by_s, by_q, value, *(value * each for each in _by_error(laid.responses[k]))]
    return e.xp.stack(rows if miss is None else [*rows, miss], axis=1)


def _by_error(responses: Any) -> list[Any]:
    return [responses[:, j] for j in range(responses.shape[1])]


def prior(e: Engine, plan: Plan) -> Any:
    """Unit information on each shared error; none on s, q and c."""
    return e.xp.asarray(np.diag([0.0, 0.0, 0.0] + [1.0] * len(plan.shared)))


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
    waves = None
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
            response = exit_modes(e, model, c, sigma)[error.mode]
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
            aside = curve(e, plan, other, laid, at, k)[0]
            aside = xp.log(xp.maximum(_relative(xp, aside, looks[k][0]), TINY)) / step
            response = getattr(sds, error.source) * (aside + (by_eta if error.source == "eta" else 0.0))
        columns.append(response)
    return xp.stack(columns, axis=1) if columns else xp.zeros((one.shape[0], 0, one.shape[1]))


def _relative(xp: Any, part: Any, value: Any) -> Any:
    """part/value; 1 where the curve has sunk to 0."""
    return xp.where(value > 0, part, 1.0) / xp.where(value > 0, value, 1.0)


def _waves(e: Engine, model: Light, data: Problem, sigma: Any, q: Any, k: int) -> list[Any]:
    """The table's noise along slice k: cosines over the extent of all data, as the table counts radii, of the size that
    noise independent by knot has along them."""
    xp = e.xp
    inner = reduce(xp.minimum, [c.reach[:, :1] for c in data.curves])
    outer = reduce(xp.maximum, [c.reach[:, 1:] for c in data.curves])
    lo, hi = (xp.log1p(sigma * xp.where(outer > 0, each, 0.0) / R_ZERO) for each in (inner, outer))
    span = xp.maximum(hi - lo, KNOT_STEP)
    x = xp.maximum(sigma * (data.curves[k].r_lo + data.curves[k].r_hi) / 2, NEAREST_MFP)
    first = xp.cos(np.pi * xp.clip((xp.log1p(x / R_ZERO) - lo) / span, 0, 1))
    level = model.shape_sd(e, q, x) * xp.sqrt(KNOT_STEP / span)
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
        elif k in error.slices and error.source in OF_SAMPLE:
            response = getattr(laid.samples[k], f"total_by_{error.source}")
        elif k in error.slices and error.source in ("eta", "g"):
            other, step = beside[error.source]
            aside = xp.log(other.total(e, at.q)[0] / model.total(e, at.q)[0]) / step
            response = getattr(sds, error.source) * (aside + (by_eta if error.source == "eta" else 0.0))
        columns.append(response)
    return xp.concatenate(columns, axis=1) if columns else xp.zeros((at.q.shape[0], 0))
