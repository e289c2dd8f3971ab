"""Where a fit starts: the best of a grid of shapes, compared in the logarithm so that no scale is too far off."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from bssrdf.fit.predict import Parameters, Scalar, curve
from bssrdf.transport.forward import ForwardModel

LOG_EXTENT = np.linspace(np.log(0.3), np.log(1000.0), 24)
"""ln of (largest radius in mean free paths), tried for each curve."""
Q_GRID = np.geomspace(0.03, 1.6, 16)
SAMPLES = 24
"""Radii that a start rests on."""


def start(
    model: ForwardModel,
    r: Float[Array, " n"],
    rd: Float[Array, " n"],
    q_grid: Float[Array, " k"],
    scale_free: bool,
) -> Parameters:
    """The grid point nearest to the curve, of these q."""
    positive = rd > 0
    log_rd = jnp.log(jnp.where(positive, rd, 1.0))
    weight = positive / jnp.maximum(positive.sum(), 1).astype(r.dtype)
    log_sigma = jnp.asarray(LOG_EXTENT, r.dtype) - jnp.log(jnp.max(r))

    def misfits(q: Scalar) -> tuple[Float[Array, " s"], Float[Array, " s"]]:
        """Of this q with every scale: R_d = σt′² f(q, σt′ r), so one medium is asked for all radii at once."""
        x = (jnp.exp(log_sigma)[:, None] * r[None, :]).ravel()
        unit = Parameters(jnp.zeros_like(q), q, jnp.zeros_like(q))
        shape = jnp.maximum(curve(model, unit, x, x, False), 1e-300 if r.dtype == jnp.float64 else 1e-37)
        difference = log_rd[None, :] - jnp.log(shape).reshape(-1, r.size) - 2 * log_sigma[:, None]
        offset = jnp.sum(weight[None, :] * difference, axis=1)
        misfit = jnp.abs(difference - (offset[:, None] if scale_free else 0))
        return jnp.sum(weight[None, :] * misfit, axis=1), offset

    cost, offset = jax.vmap(misfits)(q_grid)
    best = jnp.argmin(jnp.where(jnp.isfinite(cost), cost, jnp.inf))
    at_q, at_sigma = jnp.unravel_index(best, cost.shape)
    log_scale = offset[at_q, at_sigma]
    return Parameters(log_sigma[at_sigma], q_grid[at_q], log_scale if scale_free else jnp.zeros_like(log_scale))


def spread(counts: Bool[Array, " n"]) -> Int[Array, " SAMPLES"]:
    """Indices of `SAMPLES` radii spread evenly over those that count."""
    rank = jnp.cumsum(counts)
    wanted = jnp.linspace(1, jnp.maximum(rank[-1], 1), SAMPLES).astype(rank.dtype)
    return jnp.clip(jnp.searchsorted(rank, wanted), 0, counts.shape[0] - 1)
