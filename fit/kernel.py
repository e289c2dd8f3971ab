"""The fit of one curve, as one function that JAX compiles and maps over a batch."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from bssrdf.fit import gauss_newton
from bssrdf.fit.curves import Curves
from bssrdf.fit.predict import Parameters, Scalar, curve, q_of_total, total
from bssrdf.fit.scan import start
from bssrdf.fit.window import counts
from bssrdf.transport.forward import ForwardModel

Constraint = Literal["exact", "soft", "none"]
PASSES = 3
"""The window is given in mean free paths, which the fit finds: so it is laid, fitted and laid again."""


class Task(NamedTuple):
    """What is compiled for: everything here is fixed within a batch."""

    constraint: Constraint
    scale_free: bool
    binned: bool
    errors_known: bool


class Nuisance(NamedTuple):
    """Errors that are common to a whole curve, as offsets around 0."""

    total_r: Scalar
    """Added to R; matters where R is taken as exact."""
    log_scale: Scalar
    """Of the curve and of R, for example the reference's reflectance."""
    log_mm: Scalar
    """Of all lengths."""


NO_NUISANCE = Nuisance(0.0, 0.0, 0.0)


class Solution(NamedTuple):
    """The optimum of one curve and what is needed to judge it."""

    point: Parameters
    counts: Float[Array, " n"]
    weight: Float[Array, " n"]
    converged: Bool[Array, ""]


def solve(task: Task, model: ForwardModel, data: Curves) -> Solution:
    """Least squares under the task's constraint; `data` holds one curve (no batch axis)."""
    known = jnp.where(jnp.isnan(data.weight), 1.0, data.weight)
    q_of_r = None if task.constraint == "none" else q_of_total(model, data.total_r)
    everywhere = (known != 0) & (data.r_lo >= data.window[0]) & (data.r_hi <= data.window[1])
    point = start(model, data.r_lo, data.r_hi, data.rd, everywhere.astype(data.rd.dtype), q_of_r, task.scale_free)

    def refit(_: int, last: Solution) -> Solution:
        inside = counts(model, last.point.log_sigma_tp, data.r_lo, data.r_hi, known, data.window)
        weight = inside * (known if task.errors_known else _relative(task, model, data, last.point))
        point, converged = _optimise(task, model, data, last.point, weight)
        return Solution(point, inside, weight, converged)

    return jax.lax.fori_loop(0, PASSES, refit, Solution(point, known, known, jnp.asarray(True)))


def _relative(task: Task, model: ForwardModel, data: Curves, point: Parameters) -> Float[Array, " n"]:
    """Equal relative errors, about the model and not about the noisy data, which would bias the far end."""
    expected = curve(model, point, data.r_lo, data.r_hi, task.binned)
    return 1 / jnp.maximum(expected, jnp.finfo(expected.dtype).tiny ** 0.5)


def residual(
    task: Task,
    model: ForwardModel,
    data: Curves,
    weight: Float[Array, " n"],
    point: Parameters,
    nuisance: Nuisance = NO_NUISANCE,
) -> Float[Array, " m"]:
    """Standardised differences of the curve at `point`, and with `soft` of the total as one datum more."""
    stretch = jnp.exp(nuisance.log_mm)
    expected = curve(model, point, data.r_lo * stretch, data.r_hi * stretch, task.binned)
    measured = data.rd * jnp.exp(nuisance.log_scale) / stretch**2
    difference = jnp.where(weight > 0, measured - expected, 0) * weight
    if task.constraint != "soft":
        return difference
    gap = (data.total_r * jnp.exp(nuisance.log_scale) - total(model, point.q)) / data.total_r_sd
    return jnp.concatenate([difference, gap[None]])


def pack(task: Task, point: Parameters) -> Float[Array, " p"]:
    """The free parameters of the task, as a vector."""
    shape = [] if task.constraint == "exact" else [point.q]
    scale = [point.log_scale] if task.scale_free else []
    return jnp.stack([point.log_sigma_tp, *shape, *scale])


def unpack(task: Task, free: Float[Array, " p"], q_of_r: Scalar) -> Parameters:
    """The point that the free parameters stand for; with `exact` R alone gives q."""
    q = q_of_r if task.constraint == "exact" else free[1]
    return Parameters(free[0], q, free[-1] if task.scale_free else jnp.zeros_like(free[0]))


def _optimise(
    task: Task, model: ForwardModel, data: Curves, point: Parameters, weight: Float[Array, " n"]
) -> tuple[Parameters, Bool[Array, ""]]:
    def misfit(free: Float[Array, " p"]) -> Float[Array, " m"]:
        return residual(task, model, data, weight, unpack(task, free, point.q))

    free, converged = gauss_newton.minimise(misfit, pack(task, point))
    return unpack(task, free, point.q), converged


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


def coefficients(shape: Float[Array, " 2"]) -> Float[Array, " 2"]:
    """(σa, σs′) of (ln σt′, q); σa is 0 where q is below 0."""
    absorbed = jnp.maximum(shape[1], 0) ** 2 / 3
    return jnp.exp(shape[0]) * jnp.stack([absorbed, 1 - absorbed])


def judge(task: Task, model: ForwardModel, data: Curves, common_sd: Nuisance, solution: Solution) -> Judged:
    """Linear error propagation: the scatter of the curve, then the common errors of R, scale and length."""
    free = pack(task, solution.point)
    zero = Nuisance(*jnp.zeros(3, free.dtype))

    def at(free: Float[Array, " p"], nuisance: Nuisance) -> Parameters:
        total_r = data.total_r * jnp.exp(nuisance.log_scale) + nuisance.total_r
        return unpack(task, free, q_of_total(model, total_r) if task.constraint == "exact" else free[0])

    def rest(free: Float[Array, " p"], nuisance: Nuisance) -> Float[Array, " m"]:
        return residual(task, model, data, solution.weight, at(free, nuisance), nuisance)

    def shape(free: Float[Array, " p"], nuisance: Nuisance) -> Float[Array, " 2"]:
        return jnp.stack(at(free, nuisance)[:2])

    misfit = residual(task, model, data, solution.weight, solution.point)
    dof = solution.counts.sum() + (task.constraint == "soft") - free.shape[0]
    chi2 = misfit @ misfit / jnp.maximum(dof, 1)

    by_free, by_nuisance = jax.jacfwd(rest, argnums=(0, 1))(free, zero)
    inverse = _inverse(by_free.T @ by_free)
    along, direct = jax.jacfwd(shape, argnums=(0, 1))(free, zero)
    covariance = along @ inverse @ along.T * (1.0 if task.errors_known else chi2)
    for response, straight, common in zip(by_nuisance, direct, common_sd, strict=True):
        shift = (straight - along @ (inverse @ (by_free.T @ response))) * common
        covariance = covariance + jnp.outer(shift, shift)

    best = jnp.stack(solution.point[:2])
    slope = jax.jacfwd(coefficients)(best)
    result = slope @ covariance @ slope.T
    sd = jnp.sqrt(jnp.diagonal(result))
    return Judged(
        solution,
        jnp.sqrt(covariance[1, 1]),
        *coefficients(best),
        *sd,
        result[0, 1] / (sd[0] * sd[1]),
        chi2,
        total(model, solution.point.q),
        _runs(misfit[: data.rd.shape[0]], solution.counts),
    )


def _inverse(information: Float[Array, "p p"]) -> Float[Array, "p p"]:
    """Inverse with the diagonal scaled to 1 first; infinite errors come out as NaN or inf, not as an exception."""
    scale = jnp.sqrt(jnp.maximum(jnp.diagonal(information), jnp.finfo(information.dtype).tiny))
    return jnp.linalg.inv(information / jnp.outer(scale, scale)) / jnp.outer(scale, scale)


def _runs(misfit: Float[Array, " n"], inside: Float[Array, " n"]) -> Scalar:
    """Wald–Wolfowitz: how many standard deviations the number of runs of one sign lies below chance."""
    order = jnp.argsort(1 - inside, stable=True)
    sign = misfit[order] > 0
    valid = inside[order] > 0
    n = valid.sum()
    plus = (sign & valid).sum()
    minus = n - plus
    runs = 1 + ((sign[1:] != sign[:-1]) & valid[1:]).sum()
    mean = 1 + 2 * plus * minus / jnp.maximum(n, 1)
    variance = (mean - 1) * (mean - 2) / jnp.maximum(n - 1, 1)
    return (mean - runs) / jnp.sqrt(jnp.maximum(variance, 1e-9))


@partial(jax.jit, static_argnums=0)
def fit_batch(task: Task, model: ForwardModel, data: Curves, common_sd: Nuisance) -> Judged:
    """Fit every curve of a batch; `common_sd` holds one value a curve."""
    one: Callable[[Curves, Nuisance], Judged] = lambda curve, common: judge(  # noqa: E731
        task, model, curve, common, solve(task, model, curve)
    )
    return jax.vmap(one)(data, common_sd)
