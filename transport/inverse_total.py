"""The inverse of the dipole's total diffuse reflectance: R → α′. Dimensionless.

The unknown of the root is the logit of σa/σt′: both it and α′ then come out with all the digits that R allows,
at R just below 1 as at R near 0.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from bssrdf.transport.fresnel import boundary_a
from bssrdf.transport.precision import Real

_ITERATIONS = 64
"""Enough for bisection alone; Newton's steps are there after about 10."""


def absorption_ratio(total_r: Real, eta: Real) -> Float[Array, "..."]:
    """σa/σt′ = 1 − α′ of the medium whose total is R; 0, with derivative 0, for R >= 1, and 1 for R <= 0."""
    total_r = _as_float(total_r, eta)
    return _by_range(total_r, 1, jax.nn.sigmoid(_logit(_inner(total_r), _as_float(eta, total_r))), 0)


def albedo_p(total_r: Real, eta: Real) -> Float[Array, "..."]:
    """α′ of the medium whose total is R; 1, with derivative 0, for R >= 1, and 0 for R <= 0."""
    total_r = _as_float(total_r, eta)
    return _by_range(total_r, 0, jax.nn.sigmoid(-_logit(_inner(total_r), _as_float(eta, total_r))), 1)


def _as_float(x: Real, other: Real) -> Array:
    return jnp.asarray(x, jnp.result_type(x, other, float))


def _inner(total_r: Array) -> Array:
    """R, or a harmless value where it is out of (0, 1)."""
    return jnp.where((total_r <= 0) | (total_r >= 1), 0.5, total_r)


def _by_range(total_r: Array, below: float, inside: Array, above: float) -> Array:
    return jnp.where(total_r <= 0, below, jnp.where(total_r >= 1, above, inside))


def _optical_loss(logit: Array, eta: Array) -> Array:
    """−ln R of section 2.1 as a function of logit(σa/σt′): a sum of positive terms, so nothing cancels."""
    q = jnp.sqrt(3 * jax.nn.sigmoid(logit))
    virtual_source = jnp.log1p(jnp.expm1(-4 / 3 * boundary_a(eta) * q) / 2)
    return jax.nn.softplus(logit) + q - virtual_source


@jax.custom_jvp
def _logit(total_r: Array, eta: Array) -> Array:
    """The root of ln(−ln R(logit)) = ln(−ln total_r), nearly a straight line: Newton, kept in a bracket."""
    target = jnp.log(-jnp.log(total_r))

    def step(logit: Array) -> tuple[Array, Array]:
        loss, slope = jax.jvp(lambda x: _optical_loss(x, eta), (logit,), (jnp.ones_like(logit),))
        excess = jnp.log(loss) - target
        return excess, logit - excess * loss / slope

    def narrow(_: int, bracket: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        low, high, logit = bracket
        excess, newton = step(logit)
        low = jnp.where(excess < 0, logit, low)
        high = jnp.where(excess > 0, logit, high)
        return low, high, jnp.where((newton >= low) & (newton <= high), newton, (low + high) / 2)

    start = jnp.zeros(jnp.broadcast_shapes(total_r.shape, eta.shape), total_r.dtype)
    limit = -jnp.log(jnp.finfo(total_r.dtype).tiny)
    return step(lax.fori_loop(0, _ITERATIONS, narrow, (start - limit, start + limit, start))[2])[1]


@_logit.defjvp
def _logit_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    """The implicit derivative, of −ln R(logit, eta) = −ln total_r."""
    total_r, eta = primals
    d_total_r, d_eta = tangents
    logit = _logit(total_r, eta)
    _, along_logit = jax.jvp(lambda x: _optical_loss(x, eta), (logit,), (jnp.ones_like(logit),))
    _, along_eta = jax.jvp(lambda x: _optical_loss(logit, x), (eta,), (d_eta,))
    return logit, -(d_total_r / total_r + along_eta) / along_logit
