"""Damped Gauss–Newton (Levenberg–Marquardt) for a few unknowns and many data, made to be mapped over a batch.

Why it stands beside jaxopt's: docs/decisions/0001-own-least-squares.md. The tests hold its optima against SciPy's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

Vector = Float[Array, " p"]
Matrix = Float[Array, "p p"]
MAX_STEPS = 60
LONGEST_STEP = 1.0
"""The unknowns are logarithms or of order 1: no step changes a scale by more than a factor e."""


class _State(NamedTuple):
    trial: Vector
    best: Vector
    cost: Float[Array, ""]
    gradient: Vector
    curvature: Matrix
    damping: Float[Array, ""]
    steps: Int[Array, ""]
    done: Bool[Array, ""]


def minimise(
    linearise: Callable[[Vector], tuple[Float[Array, " n"], Float[Array, "p n"]]],
    x: Vector,
    most_steps: Int[Array, ""] | int = MAX_STEPS,
) -> tuple[Vector, Bool[Array, ""]]:
    """The x nearby that makes Σ residual² least, and whether the search came to rest.

    `linearise` gives the residual and its derivatives. The last move is made without another look: it is too small.
    """
    p = x.shape[0]
    settled_at = 100 * jnp.sqrt(jnp.finfo(x.dtype).eps)

    def step(state: _State) -> _State:
        value, slopes = linearise(state.trial)
        cost, gradient, curvature = value @ value, (slopes * value[None, :]).sum(axis=1), gram(slopes, slopes)
        better = cost <= state.cost
        best, cost, gradient, curvature = jax.tree.map(
            lambda new, old: jnp.where(better, new, old),
            (state.trial, cost, gradient, curvature),
            (state.best, state.cost, state.gradient, state.curvature),
        )
        damping = jnp.where(better, state.damping * 0.1, jnp.maximum(state.damping, 1e-3) * 10)
        move = -solve_damped(curvature, gradient, damping)
        move = move * jnp.minimum(1, LONGEST_STEP / jnp.maximum(jnp.max(jnp.abs(move)), LONGEST_STEP))
        settled = (better & (jnp.max(jnp.abs(move)) < settled_at)) | (damping > 1e12)
        return _State(best + move, best, cost, gradient, curvature, damping, state.steps + 1, settled)

    zeros = jnp.zeros_like(x)
    infinite = jnp.asarray(jnp.inf, x.dtype)
    first = _State(x, x, infinite, zeros, jnp.eye(p, dtype=x.dtype), zeros[0], jnp.asarray(0), jnp.asarray(False))
    last = jax.lax.while_loop(lambda state: ~state.done & (state.steps < most_steps), step, first)
    x = jnp.where(last.damping < 1, last.trial, last.best)
    return x, last.done & jnp.isfinite(last.cost)


def gram(a: Float[Array, "p n"], b: Float[Array, "k n"]) -> Float[Array, "p k"]:
    """a bᵀ for few, long rows: mapped over a batch, a product and a sum are faster than a library's matrix product."""
    return (a[:, None, :] * b[None, :, :]).sum(axis=2)


def solve_damped(curvature: Matrix, gradient: Vector, damping: Float[Array, ""]) -> Vector:
    """(H + λ diag H)⁻¹ g by Cholesky, written out: p is at most 4, and a library call for each would cost more."""
    p = gradient.shape[0]
    floor = jnp.finfo(gradient.dtype).tiny
    scale = [jnp.sqrt(jnp.maximum(curvature[i, i], floor)) for i in range(p)]
    lower: list[list[Float[Array, ""]]] = []
    for i in range(p):
        row: list[Float[Array, ""]] = []
        for j in range(i):
            row.append(
                (curvature[i, j] / (scale[i] * scale[j]) - sum(a * b for a, b in zip(row, lower[j], strict=False)))
                / lower[j][j]
            )
        row.append(jnp.sqrt(jnp.maximum(1 + damping - sum(a * a for a in row), jnp.finfo(gradient.dtype).eps)))
        lower.append(row)
    forward: list[Float[Array, ""]] = []
    for i in range(p):
        forward.append(
            (gradient[i] / scale[i] - sum(a * b for a, b in zip(lower[i], forward, strict=False))) / lower[i][i]
        )
    back: list[Float[Array, ""]] = [forward[-1]] * p
    for i in reversed(range(p)):
        back[i] = (forward[i] - sum(lower[k][i] * back[k] for k in range(i + 1, p))) / lower[i][i]
    return jnp.stack([x / s for x, s in zip(back, scale, strict=True)])
