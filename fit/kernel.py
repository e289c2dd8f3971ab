"""The fit of one curve, as one function that JAX compiles and maps over a batch."""

from __future__ import annotations

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from bssrdf.fit import gauss_newton
from bssrdf.fit.curves import Curves
from bssrdf.fit.predict import (
    Parameters,
    Scalar,
    curve,
    curve_with_slopes,
    medium_of,
    q_of_total,
    total,
    total_slope,
)
from bssrdf.fit.scan import Q_GRID, spread, start
from bssrdf.fit.seen import Seen, as_it_is, exit_rel_sd, seen_at
from bssrdf.fit.window import counts
from bssrdf.transport.forward import DipoleModel, ForwardModel

Constraint = Literal["exact", "soft", "none"]
Vector = Float[Array, " p"]
PASSES = 3
"""The window is given in mean free paths, which the fit finds: so it is laid, fitted and laid again."""
ROBUST_PASSES = 12
GLANCE = 3
"""Steps in a pass whose window and weights are not the last."""
_VALLEYS = 4
"""Ranges of albedo in which a curve of unknown factor is looked for, each for itself."""
HUBER = 1.345
"""Standard deviations from which on a residual counts linearly: 95 % efficient on normal noise (Huber 1981)."""


class Task(NamedTuple):
    """What is compiled for: everything here is fixed within a batch."""

    constraint: Constraint
    scale_free: bool
    binned: bool
    errors_known: bool
    blurred: bool
    """Whether the spot is wide enough to matter."""
    camera: bool
    """Whether a camera at an angle saw the light, so that the model's own exit law counts."""
    robust: bool
    """Huber's loss in place of squares."""


class Common(NamedTuple):
    """Standard deviations of errors that a whole curve shares."""

    total_r: Scalar
    """Of R, where R is taken as exact."""
    log_scale: Scalar
    """Relative, of the curve and of R together, such as that of the reference's reflectance."""
    log_mm: Scalar
    """Relative, of all lengths."""


class Solution(NamedTuple):
    """The optimum of one curve and the radii it rests on."""

    point: Parameters
    counts: Float[Array, " n"]
    weight: Float[Array, " n"]
    seen: Seen
    total_seen: Scalar
    """The same of the total, which the spot does not change."""
    converged: Bool[Array, ""]


class Judged(NamedTuple):
    """A solution with its linear errors."""

    solution: Solution
    q_sd: Scalar
    sigma_a: Scalar
    sigma_sp: Scalar
    sigma_a_sd: Scalar
    sigma_sp_sd: Scalar
    correlation: Scalar
    chi2: Scalar
    total_r: Scalar
    runs_z: Scalar
    total_pull: Scalar
    """(R measured − R fitted)/sd where R is a datum, else 0."""


@partial(jax.jit, static_argnums=0)
def fit_batch(task: Task, model: ForwardModel, data: Curves, common: Common) -> Judged:
    """Fit and judge every curve of a batch; `common` holds one value a curve."""

    def one(data: Curves, common: Common) -> Judged:
        return judge(task, model, data, common, solve(task, model, data))

    return jax.vmap(one)(data, common)


def solve(task: Task, model: ForwardModel, data: Curves) -> Solution:
    """Least squares under the task's constraint; `data` holds one curve (no batch axis).

    A few radii are fitted first: whatever steps a poor start costs are cheap there.
    """
    known = jnp.where(jnp.isnan(data.weight), 1.0, data.weight)
    few = spread((known != 0) & (data.r_lo >= data.window[0]) & (data.r_hi <= data.window[1]))
    sparse = data._replace(r_lo=data.r_lo[few], r_hi=data.r_hi[few], rd=data.rd[few], arc=data.arc[few])
    plain = task._replace(blurred=False, camera=False, robust=False)

    def begin(q_grid: Vector) -> tuple[Parameters, Scalar]:
        point = start(model, (sparse.r_lo + sparse.r_hi) / 2, sparse.rd, q_grid, task.scale_free)
        begun = _relaid(plain, model, sparse, known[few], point)
        misfit = residual(plain, model, sparse, begun).value
        finite = jnp.isfinite(sum(begun.point))
        point = jax.tree.map(lambda found, scanned: jnp.where(finite, found, scanned), begun.point, point)
        return point, misfit @ misfit / jnp.maximum(begun.counts.sum(), 1)

    if task.constraint != "none":
        point, _ = begin(q_of_total(model, data.total_r)[None])
    elif not task.scale_free:
        point, _ = begin(jnp.asarray(Q_GRID, data.rd.dtype))
    else:  # shape alone may have a second minimum at another albedo
        points, misfits = jax.vmap(begin)(jnp.asarray(Q_GRID, data.rd.dtype).reshape(_VALLEYS, -1))
        best = jnp.argmin(jnp.where(jnp.isfinite(misfits), misfits, jnp.inf))
        point = jax.tree.map(lambda each: each[best], points)
    return _relaid(task, model, data, known, point)


def _relaid(task: Task, model: ForwardModel, data: Curves, known: Float[Array, " n"], point: Parameters) -> Solution:
    """The optimum from `point` on, with window and weights laid anew for it each pass."""

    last = (ROBUST_PASSES if task.robust else PASSES) - 1

    def refit(number: Int[Array, ""], found: Solution) -> Solution:
        steps = jnp.where(number < last, GLANCE, gauss_newton.MAX_STEPS)
        return optimise(task, model, data, reweighted(task, model, data, known, found), steps)

    first = Solution(point, known, known, as_it_is(known, point), jnp.ones_like(data.total_r), jnp.asarray(True))
    return jax.lax.fori_loop(0, last + 1, refit, first)


def optimise(
    task: Task,
    model: ForwardModel,
    data: Curves,
    begin: Solution,
    most_steps: Int[Array, ""] | int = gauss_newton.MAX_STEPS,
) -> Solution:
    """The best point near that of `begin`, with its weights; q stays where the constraint is `exact`."""

    def linearise(free: Vector) -> tuple[Float[Array, " m"], Float[Array, "p m"]]:
        there = begin._replace(point=_unpack(task, free, begin.point.q))
        return residual(task, model, data, there)[:2]

    free, converged = gauss_newton.minimise(linearise, _pack(task, begin.point), most_steps)
    return begin._replace(point=_unpack(task, free, begin.point.q), converged=converged)


def reweighted(task: Task, model: ForwardModel, data: Curves, known: Float[Array, " n"], last: Solution) -> Solution:
    """Window, spot and weights as the last point has them."""
    inside = counts(model, last.point.log_sigma_tp, data.r_lo, data.r_hi, known, data.window)
    point = last.point
    total_seen = last.total_seen
    if task.camera:
        medium = medium_of(model, point)
        law = DipoleModel(model.eta).total_radiance_factor(medium, data.cos_view)
        total_seen = model.total_radiance_factor(medium, data.cos_view) / law
        if task.constraint == "exact":
            point = point._replace(q=q_of_total(model, data.total_r / total_seen))

    seen = last.seen
    if task.blurred or task.camera:
        seen = seen_at(model, data, point, blurred=task.blurred, camera=task.camera)
    expected = curve(model, point, data.r_lo, data.r_hi, task.binned) * seen.ratio(point)
    model_rel_sd = jnp.full_like(known, model.relative_error)
    if task.camera:
        model_rel_sd = jnp.hypot(model_rel_sd, exit_rel_sd(model, data, point))
    weight = inside * _weight(task, model_rel_sd, known, expected)
    if task.robust:
        distance = jnp.abs(data.rd - expected) * weight
        scatter = 1.0 if task.errors_known else _median(distance, inside) / 0.6745
        weight = weight * jnp.sqrt(jnp.minimum(1, HUBER * scatter / jnp.maximum(distance, 1e-12)))
    return last._replace(point=point, counts=inside, seen=seen, total_seen=total_seen, weight=weight)


def _median(values: Float[Array, " n"], inside: Float[Array, " n"]) -> Scalar:
    ordered = jnp.sort(jnp.where(inside > 0, values, jnp.inf))
    return ordered[jnp.clip((inside.sum() / 2).astype(int), 0, values.shape[0] - 1)]


class Residual(NamedTuple):
    """Standardised differences and their derivatives."""

    value: Float[Array, " m"]
    by_free: Float[Array, "p m"]
    by_q: Float[Array, " m"]
    by_log_scale: Float[Array, " m"]
    by_log_mm: Float[Array, " m"]


def residual(task: Task, model: ForwardModel, data: Curves, at: Solution) -> Residual:
    """(measured − model)/sd of the curve and, with `soft`, of the total as one datum more.

    Lengths scale out of R_d = σt′² f(q, σt′r): an error of all lengths acts as ln σt′ does, less the 1/mm² of R_d.
    """
    point, used = at.point, at.weight > 0
    ratio = at.seen.ratio(point)
    narrow = curve_with_slopes(model, point, data.r_lo, data.r_hi, task.binned)
    expected, by_log_sigma, by_q = (each * ratio for each in narrow)
    by_log_sigma, by_q = by_log_sigma + expected * at.seen.slopes[0], by_q + expected * at.seen.slopes[1]
    by_log_mm = -2 * data.rd - (by_log_sigma - 2 * expected)
    columns = [data.rd - expected, -by_log_sigma, -by_q, -expected, data.rd, by_log_mm]
    value, by_log_sigma, by_q, by_factor, by_log_scale, by_log_mm = (
        jnp.where(used, column, 0) * at.weight for column in columns
    )
    rows = [by_log_sigma]
    if task.constraint != "exact":
        rows.append(by_q)
    if task.scale_free:
        rows.append(by_factor)
    all_columns = [value, *rows, by_q, by_log_scale, by_log_mm]
    if task.constraint == "soft":
        slope = -total_slope(model, point.q) / data.total_r_sd
        gap = (data.total_r / at.total_seen - total(model, point.q)) / data.total_r_sd
        common = data.total_r / data.total_r_sd
        zero = jnp.zeros_like(gap)
        last = [gap, zero, slope, *([zero] if task.scale_free else []), slope, common, zero]
        all_columns = [jnp.append(column, entry) for column, entry in zip(all_columns, last, strict=True)]
    return Residual(all_columns[0], jnp.stack(all_columns[1:-3]), *all_columns[-3:])


def judge(task: Task, model: ForwardModel, data: Curves, common: Common, solution: Solution) -> Judged:
    """Linear error propagation: the noise of the curve through the weights, then the errors of R, scale and length."""
    point = solution.point
    misfit = residual(task, model, data, solution)
    p = misfit.by_free.shape[0]
    dof = solution.counts.sum() + (task.constraint == "soft") - p
    chi2 = misfit.value @ misfit.value / jnp.maximum(dof, 1)

    inverse = _inverse(gauss_newton.gram(misfit.by_free, misfit.by_free))
    scatter = misfit.by_free * share_of_noise(task, data, solution, chi2)[None, :]
    covariance = _shape_of_free(task, inverse @ gauss_newton.gram(scatter, misfit.by_free) @ inverse)
    for response, q_shift, sd in _common_responses(task, model, data, point, misfit, common):
        free_shift = -inverse @ (misfit.by_free * response[None, :]).sum(axis=1)
        shift = jnp.stack([free_shift[0], q_shift if task.constraint == "exact" else free_shift[1]]) * sd
        covariance = covariance + shift[:, None] * shift[None, :]

    best = jnp.stack([point.log_sigma_tp, point.q])
    slope = jax.jacfwd(coefficients)(best)
    result = slope @ covariance @ slope.T
    sd = jnp.sqrt(jnp.diagonal(result))
    sigma_a, sigma_sp = coefficients(best)
    return Judged(
        solution=solution,
        q_sd=jnp.sqrt(covariance[1, 1]),
        sigma_a=sigma_a,
        sigma_sp=sigma_sp,
        sigma_a_sd=sd[0],
        sigma_sp_sd=sd[1],
        correlation=result[0, 1] / (sd[0] * sd[1]),
        chi2=chi2,
        total_r=total(model, point.q),
        runs_z=_runs(misfit.value[: data.rd.shape[0]], solution.counts),
        total_pull=misfit.value[-1] if task.constraint == "soft" else jnp.zeros_like(chi2),
    )


def coefficients(shape: Float[Array, " 2"]) -> Float[Array, " 2"]:
    """(σa, σs′) of (ln σt′, q); σa is 0 where q is below 0."""
    absorbed = jnp.maximum(shape[1], 0) ** 2 / 3
    return jnp.exp(shape[0]) * jnp.stack([absorbed, 1 - absorbed])


def _common_responses(
    task: Task, model: ForwardModel, data: Curves, point: Parameters, misfit: Residual, common: Common
) -> list[tuple[Float[Array, " m"], Scalar, Scalar]]:
    """For each common error: what it does to the residual, what to q where R fixes q, and its sd."""
    zero = jnp.zeros_like(point.q)
    if task.constraint != "exact":
        return [(misfit.by_log_scale, zero, common.log_scale), (misfit.by_log_mm, zero, common.log_mm)]
    q_by_r = 1 / total_slope(model, point.q)
    q_by_scale = data.total_r * q_by_r
    return [
        (misfit.by_q * q_by_r, q_by_r, common.total_r),
        (misfit.by_log_scale + misfit.by_q * q_by_scale, q_by_scale, common.log_scale),
        (misfit.by_log_mm, zero, common.log_mm),
    ]


def share_of_noise(task: Task, data: Curves, solution: Solution, chi2: Scalar) -> Float[Array, " m"]:
    """Variance of the standardised residuals that is noise of the data and not allowance for the model."""
    known = jnp.where(data.weight > 0, data.weight, 1)
    share = jnp.square(solution.weight / known) if task.errors_known else jnp.full_like(known, chi2)
    return jnp.append(share, 1) if task.constraint == "soft" else share


def _shape_of_free(task: Task, inverse: Float[Array, "p p"]) -> Float[Array, "2 2"]:
    """Covariance of (ln σt′, q) from that of the free parameters."""
    if task.constraint == "exact":
        return jnp.zeros((2, 2), inverse.dtype).at[0, 0].set(inverse[0, 0])
    return inverse[:2, :2]


def _pack(task: Task, point: Parameters) -> Vector:
    shape = [] if task.constraint == "exact" else [point.q]
    scale = [point.log_scale] if task.scale_free else []
    return jnp.stack([point.log_sigma_tp, *shape, *scale])


def _unpack(task: Task, free: Vector, q_of_r: Scalar) -> Parameters:
    q = q_of_r if task.constraint == "exact" else free[1]
    return Parameters(free[0], q, free[-1] if task.scale_free else jnp.zeros_like(free[0]))


def _weight(
    task: Task, model_rel_sd: Float[Array, " n"], known: Float[Array, " n"], expected: Float[Array, " n"]
) -> Float[Array, " n"]:
    """1/√(sd² + what the model may be off by²), or equal relative errors where the data have none.

    Both are taken about the model and not about the noisy data, which would bias the far end.
    """
    expected = jnp.maximum(expected, jnp.finfo(expected.dtype).tiny ** 0.25)
    if not task.errors_known:
        return 1 / expected
    return known / jnp.sqrt(1 + jnp.square(known * model_rel_sd * expected))


def _inverse(information: Float[Array, "p p"]) -> Float[Array, "p p"]:
    """Inverse of a normal matrix, a column at a time."""
    return jax.vmap(lambda unit: gauss_newton.solve_damped(information, unit, jnp.zeros_like(unit[0])))(
        jnp.eye(information.shape[0], dtype=information.dtype)
    )


def _runs(misfit: Float[Array, " n"], inside: Float[Array, " n"]) -> Scalar:
    """Wald–Wolfowitz: how many standard deviations the number of runs of one sign lies below chance."""
    valid = inside > 0
    plus = (valid & (misfit > 0)).sum()
    minus = valid.sum() - plus
    runs = 1 + (valid[1:] & valid[:-1] & ((misfit[1:] > 0) != (misfit[:-1] > 0))).sum()
    n = jnp.maximum(plus + minus, 2)
    expected = 1 + 2 * plus * minus / n
    variance = (expected - 1) * (expected - 2) / (n - 1)
    return (expected - runs) / jnp.sqrt(jnp.maximum(variance, 1e-9))
