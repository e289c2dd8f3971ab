"""The forward model in the fit's own parameters: s = ln σt′ and q = √(3σa/σt′).

The total falls as 1 − cq for small q, so it is q, not σa, in which the total is linear near R = 1. There q may run
below 0 while a fit is under way: the curve is continued evenly and the total oddly about R = 1, which keeps both
smooth; a result with q < 0 is put back to σa = 0 by the caller and bounded from above.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bssrdf.transport.dipole import Medium
from bssrdf.transport.forward import ForwardModel

Scalar = Float[Array, ""]
SMALLEST_Q = 1e-12
"""In place of 0, where a model's derivative in σa may not exist; σa/σt′ is then 3e-25."""
SLOPE_Q = 1e-4
"""Where the slope of the total at R = 1 is taken."""


class Parameters(NamedTuple):
    """A point of the fit: ln σt′ [ln 1/mm], q, and ln of the curve's unknown factor (0 unless the scale is free)."""

    log_sigma_tp: Scalar
    q: Scalar
    log_scale: Scalar


def medium_of(model: ForwardModel, point: Parameters) -> Medium:
    """σa = q²σt′/3, σs′ = σt′ − σa, with |q| for q."""
    q = jnp.maximum(jnp.abs(point.q), SMALLEST_Q)
    sigma_tp = jnp.exp(point.log_sigma_tp)
    absorbed = q**2 / 3
    return Medium(absorbed * sigma_tp, (1 - absorbed) * sigma_tp, jnp.asarray(model.eta, q.dtype))


def curve(
    model: ForwardModel, point: Parameters, r_lo: Float[Array, " n"], r_hi: Float[Array, " n"], binned: bool
) -> Float[Array, " n"]:
    """R_d at the radii, or its mean over the annuli where `binned`."""
    medium = medium_of(model, point)
    values = model.bin_average(medium, r_lo, r_hi) if binned else model.rd(medium, r_lo)
    return values * jnp.exp(point.log_scale)


def curve_with_slopes(
    model: ForwardModel, point: Parameters, r_lo: Float[Array, " n"], r_hi: Float[Array, " n"], binned: bool
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """R_d and its derivatives by ln σt′ and by q.

    R_d = σt′² f(q, σt′ r), so the derivative by ln σt′ is 2 R_d plus that by ln r, which leaves the medium alone.
    """

    def stretched(log_factor: Scalar) -> Float[Array, " n"]:
        factor = jnp.exp(log_factor)
        return curve(model, point, r_lo * factor, r_hi * factor, binned)

    def absorbing(q: Scalar) -> Float[Array, " n"]:
        return curve(model, point._replace(q=q), r_lo, r_hi, binned)

    zero, one = jnp.zeros_like(point.q), jnp.ones_like(point.q)
    value, by_log_r = jax.jvp(stretched, (zero,), (one,))
    by_q = jax.jvp(absorbing, (point.q,), (one,))[1]
    return value, 2 * value + by_log_r, by_q


def total(model: ForwardModel, q: Scalar) -> Scalar:
    """Total reflectance; it depends on q alone."""
    inside = model.total(medium_of(model, Parameters(jnp.zeros_like(q), q, jnp.zeros_like(q))))
    return jnp.where(q >= 0, inside, 2 - inside)


def total_slope(model: ForwardModel, q: Scalar) -> Scalar:
    """dR/dq, taken beside 0 where a model's own derivative may not exist at 0."""
    return jax.grad(lambda q: total(model, q))(jnp.maximum(jnp.abs(q), SLOPE_Q))


def q_of_total(model: ForwardModel, total_r: Scalar) -> Scalar:
    """The q in the model's range whose total is nearest to R, by bisection; no derivative: see `total_slope`."""
    lo = jnp.zeros_like(total_r)
    hi = jnp.full_like(total_r, model.q_max)

    def halve(_: int, bracket: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        lo, hi = bracket
        mid = (lo + hi) / 2
        above = total(model, mid) > total_r
        return jnp.where(above, mid, lo), jnp.where(above, hi, mid)

    lo, hi = jax.lax.fori_loop(0, 52, halve, (lo, hi))
    return (lo + hi) / 2
