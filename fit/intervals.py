"""95 % intervals by profile likelihood, for where the cost is no parabola: σa near 0.

The profile holds q and lets everything else find its best again; a bound lies where the cost has risen by the quantile of
χ² with one degree of freedom: 2.71 for a one-sided bound, 3.84 for each end of an interval.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bssrdf.fit import gauss_newton
from bssrdf.fit.curves import Curves
from bssrdf.fit.kernel import Solution, Task, coefficients, residual
from bssrdf.fit.predict import Parameters, Scalar
from bssrdf.transport.forward import ForwardModel

ONE_SIDED = 2.706
TWO_SIDED = 3.841
HALVINGS = 30
FLOOR_Q = 1e-6


class Profile(NamedTuple):
    """σa and σs′ at the best q ≥ 0 and the σa at which the bounds lie; inf where the cost never rises enough."""

    sigma_a: Scalar
    sigma_sp: Scalar
    lower: Scalar
    upper: Scalar


def profile(task: Task, model: ForwardModel, data: Curves, solution: Solution, inflation: Scalar) -> Profile:
    """Bounds of σa for one curve; `inflation` multiplies the variances where the data's own errors are unknown."""

    def held(q: Scalar) -> tuple[Scalar, Float[Array, " 2"]]:
        """Cost and coefficients with this q and everything else at its best."""

        def misfit(free: Float[Array, " p"]) -> Float[Array, " m"]:
            scale = free[1] if task.scale_free else solution.point.log_scale
            return residual(task, model, data, solution.weight, Parameters(free[0], q, scale))

        start = [solution.point.log_sigma_tp] + ([solution.point.log_scale] if task.scale_free else [])
        free, _ = gauss_newton.minimise(misfit, jnp.stack(start))
        rest = misfit(free)
        return rest @ rest / inflation, coefficients(jnp.stack([free[0], q]))

    at_boundary = solution.point.q <= FLOOR_Q
    best_q = jnp.maximum(solution.point.q, FLOOR_Q)
    lowest, best = held(best_q)

    def crossing(limit: Scalar, inner: Scalar, outer: Scalar) -> Scalar:
        """σa where the cost passes `limit` between ln q = inner, below it, and ln q = outer, above it."""

        def halve(_: int, ends: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            below, above = ends
            middle = (below + above) / 2
            is_below = held(jnp.exp(middle))[0] < limit
            return jnp.where(is_below, middle, below), jnp.where(is_below, above, middle)

        below, above = jax.lax.fori_loop(0, HALVINGS, halve, (inner, outer))
        return held(jnp.exp(above))[1][0]

    def bound(rise: Scalar, edge: Scalar, never: float) -> Scalar:
        """The crossing towards `edge`, or `never` where the cost has not risen enough there."""
        risen = held(edge)[0] >= lowest + rise
        return jnp.where(risen, crossing(lowest + rise, jnp.log(best_q), jnp.log(edge)), never)

    floor = jnp.asarray(FLOOR_Q, best_q.dtype)
    lower = jnp.where(at_boundary, 0.0, bound(jnp.asarray(TWO_SIDED), floor, 0.0))
    one_sided = at_boundary | (lower <= 0)
    upper = bound(jnp.where(one_sided, ONE_SIDED, TWO_SIDED), jnp.asarray(model.q_max, best_q.dtype), jnp.inf)
    return Profile(jnp.where(at_boundary, 0.0, best[0]), best[1], lower, upper)


@partial(jax.jit, static_argnums=0)
def profile_batch(task: Task, model: ForwardModel, data: Curves, solution: Solution, inflation: Scalar) -> Profile:
    """`profile` of every curve of a batch."""
    return jax.vmap(partial(profile, task, model))(data, solution, inflation)
