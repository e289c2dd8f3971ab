"""95 % intervals by profile likelihood, for where the cost is no parabola: σa near 0.

The profile holds q and lets everything else find its best again. A bound lies where the cost has risen by the quantile
of χ² with one degree of freedom: 2.71 for a one-sided bound, 3.84 for each end of an interval.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

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

        def linearise(free: Float[Array, " p"]) -> tuple[Float[Array, " m"], Float[Array, "p m"]]:
            scale = free[1] if task.scale_free else solution.point.log_scale
            there = residual(task, model, data, solution._replace(point=Parameters(free[0], q, scale)))
            others = [row for row in range(there.by_free.shape[0]) if row != 1]
            return there.value, there.by_free[jnp.asarray(others)]

        start = [solution.point.log_sigma_tp] + ([solution.point.log_scale] if task.scale_free else [])
        free, _ = gauss_newton.minimise(linearise, jnp.stack(start))
        rest = linearise(free)[0]
        return rest @ rest / inflation, coefficients(jnp.stack([free[0], q]))

    best_q = jnp.maximum(solution.point.q, FLOOR_Q)
    lowest, best = held(best_q)

    def bound(rise: Scalar, edge: Scalar) -> tuple[Scalar, Bool[Array, ""]]:
        """σa where the cost has risen by `rise` on the way to q = `edge`, and whether it has risen so much there."""

        def halve(_: int, ends: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            below, above = ends
            middle = (below + above) / 2
            is_below = held(jnp.exp(middle))[0] < lowest + rise
            return jnp.where(is_below, middle, below), jnp.where(is_below, above, middle)

        _, above = jax.lax.fori_loop(0, HALVINGS, halve, (jnp.log(best_q), jnp.log(edge)))
        cost, (sigma_a, _) = held(jnp.exp(above))
        return sigma_a, cost >= lowest + rise

    rises = jnp.asarray([TWO_SIDED, TWO_SIDED, ONE_SIDED], best_q.dtype)
    edges = jnp.asarray([FLOOR_Q, model.q_max, model.q_max], best_q.dtype)
    crossed_at, crossed = jax.vmap(bound)(rises, edges)
    above_zero = crossed[0] & (solution.point.q > FLOOR_Q)
    end = jnp.where(above_zero, 1, 2)
    return Profile(
        sigma_a=jnp.where(solution.point.q > FLOOR_Q, best[0], 0),
        sigma_sp=best[1],
        lower=jnp.where(above_zero, crossed_at[0], 0),
        upper=jnp.where(crossed[end], crossed_at[end], jnp.inf),
    )


@partial(jax.jit, static_argnums=0)
def profile_batch(task: Task, model: ForwardModel, data: Curves, solution: Solution, inflation: Scalar) -> Profile:
    """`profile` of every curve of a batch."""
    return jax.vmap(partial(profile, task, model))(data, solution, inflation)
