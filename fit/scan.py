"""Where a fit starts: the best of a grid of shapes, compared in the logarithm so that no scale is too far off."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bssrdf.fit.predict import Parameters, Scalar, curve
from bssrdf.transport.forward import ForwardModel

LOG_EXTENT = np.linspace(np.log(0.3), np.log(1000.0), 24)
"""ln of (largest radius in mean free paths), tried for each curve."""
Q_GRID = np.geomspace(0.02, 1.5, 7)
SAMPLES = 16


def start(
    model: ForwardModel,
    r_lo: Float[Array, " n"],
    r_hi: Float[Array, " n"],
    rd: Float[Array, " n"],
    counts: Float[Array, " n"],
    q: Scalar | None,
    scale_free: bool,
) -> Parameters:
    """The grid point nearest to the curve; `counts` is 1 for a radius that counts, `q` is given where R is."""
    pick = _spread(counts)
    r = (r_lo[pick] + r_hi[pick]) / 2
    positive = counts[pick] * (rd[pick] > 0)
    log_rd = jnp.log(jnp.where(rd[pick] > 0, rd[pick], 1.0))
    weight = positive / jnp.maximum(positive.sum(), 1)
    extent = jnp.max(jnp.where(counts > 0, r_hi, 0))
    log_sigma = jnp.asarray(LOG_EXTENT, r.dtype) - jnp.log(extent)
    q_grid = jnp.asarray(Q_GRID, r.dtype) if q is None else q[None]
    s, qs = (grid.ravel() for grid in jnp.meshgrid(log_sigma, q_grid))

    def misfit(log_sigma_tp: Scalar, q: Scalar) -> tuple[Scalar, Scalar]:
        point = Parameters(log_sigma_tp, q, jnp.zeros_like(q))
        model_rd = jnp.maximum(curve(model, point, r, r, False), 1e-300 if r.dtype == jnp.float64 else 1e-37)
        difference = log_rd - jnp.log(model_rd)
        offset = jnp.sum(weight * difference)
        return jnp.sum(weight * jnp.abs(difference - (offset if scale_free else 0))), offset

    cost, offset = jax.vmap(misfit)(s, qs)
    best = jnp.argmin(jnp.where(jnp.isfinite(cost), cost, jnp.inf))
    return Parameters(s[best], qs[best], offset[best] if scale_free else jnp.zeros_like(offset[best]))


def _spread(counts: Float[Array, " n"]) -> Float[Array, " SAMPLES"]:
    """Indices of `SAMPLES` radii spread evenly over those that count."""
    rank = jnp.cumsum(counts)
    wanted = jnp.linspace(1, jnp.maximum(rank[-1], 1), SAMPLES, dtype=rank.dtype)
    return jnp.clip(jnp.searchsorted(rank, jnp.floor(wanted)), 0, counts.shape[0] - 1)
