"""Which radii a fit uses, in mean free paths 1/σt′ of the fit itself."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from bssrdf.fit.predict import Scalar
from bssrdf.transport.forward import ForwardModel

FEWEST = 5
"""Radii below which no fit is tried."""


def counts(
    model: ForwardModel,
    log_sigma_tp: Scalar,
    r_lo: Float[Array, " n"],
    r_hi: Float[Array, " n"],
    weight: Float[Array, " n"],
    window_mm: Float[Array, " 2"],
) -> Float[Array, " n"]:
    """1 for a radius inside both the model's window and the caller's, else 0."""
    mfp = jnp.exp(-log_sigma_tp)
    lo = jnp.maximum(window_mm[0], model.window_mfp[0] * mfp)
    hi = jnp.minimum(window_mm[1], model.window_mfp[1] * mfp)
    inside = (r_lo >= lo) & (r_hi <= hi) & (weight != 0)
    return inside.astype(r_lo.dtype)
