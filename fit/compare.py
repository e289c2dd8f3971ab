"""The same data and weights under another model: what a wrong model, g or η does to the coefficients."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bssrdf.fit.curves import Curves
from bssrdf.fit.kernel import Solution, Task, coefficients, optimise, residual
from bssrdf.fit.predict import Parameters, curve, q_of_total, total
from bssrdf.transport.forward import ForwardModel


class Refit(NamedTuple):
    """Coefficients under the other model, and how well it fits."""

    sigma_a: Float[Array, " b"]
    sigma_sp: Float[Array, " b"]
    chi2: Float[Array, " b"]
    """Sum, not reduced."""


@partial(jax.jit, static_argnums=0)
def refit_batch(task: Task, model: ForwardModel, data: Curves, solution: Solution) -> Refit:
    """Fit every curve again by `model`, with the window and the weights of its `solution`."""
    return jax.vmap(partial(_refit, task, model))(data, solution)


@partial(jax.jit, static_argnums=0)
def bias_batch(task: Task, fitted: ForwardModel, truth: ForwardModel, data: Curves, solution: Solution) -> Refit:
    """What fitting by `fitted` would give if `truth` had made the light of the coefficients that `solution` found."""

    def one(data: Curves, solution: Solution) -> Refit:
        point = solution.point._replace(q=jnp.clip(solution.point.q, 0, truth.q_max))
        made = curve(truth, point, data.r_lo, data.r_hi, task.binned) * solution.seen.ratio(solution.point)
        light = data._replace(rd=made, total_r=total(truth, point.q) * solution.total_seen)
        return _refit(task, fitted, light, solution)

    return jax.vmap(one)(data, solution)


def _refit(task: Task, model: ForwardModel, data: Curves, solution: Solution) -> Refit:
    point: Parameters = solution.point
    if task.constraint == "exact":
        point = point._replace(q=q_of_total(model, data.total_r / solution.total_seen))
    found = optimise(task, model, data, solution._replace(point=point))
    misfit = residual(task, model, data, found).value
    sigma_a, sigma_sp = coefficients(jnp.stack([found.point.log_sigma_tp, found.point.q]))
    return Refit(sigma_a, sigma_sp, misfit @ misfit)
