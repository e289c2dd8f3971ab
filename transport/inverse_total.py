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


@jax.jit
def absorption_ratio(total_r: Real, eta: Real) -> Float[Array, "..."]:
    """σa/σt′ = 1 − α′ of the medium whose total is R; 0, with derivative 0, for R >= 1, and 1 for R <= 0."""
    return _by_range(total_r, 1, jax.nn.sigmoid(_logit(*_prepared(total_r, eta))), 0)


@jax.jit
def albedo_p(total_r: Real, eta: Real) -> Float[Array, "..."]:
    """α′ of the medium whose total is R; 1, with derivative 0, for R >= 1, and 0 for R <= 0."""
    return _by_range(total_r, 0, jax.nn.sigmoid(-_logit(*_prepared(total_r, eta))), 1)


def _prepared(total_r: Real, eta: Real) -> tuple[Array, Array]:
    """R, or a harmless value where it is out of (0, 1), and 4A/3, in one dtype."""
    dtype = jnp.result_type(total_r, eta, float)
    total_r = jnp.asarray(total_r, dtype)
    inner = jnp.where((total_r <= 0) | (total_r >= 1), 0.5, total_r)
    return inner, jnp.asarray(4 / 3 * boundary_a(eta), dtype)


def _by_range(total_r: Real, below: float, inside: Array, above: float) -> Array:
    total_r = jnp.asarray(total_r)
    return jnp.where(total_r <= 0, below, jnp.where(total_r >= 1, above, inside))


def _optical_loss(logit: Array, k: Array) -> Array:
    """−ln R of section 2.1 at logit(σa/σt′), with k = 4A/3: a sum of positive terms, so nothing cancels."""
    q = jnp.sqrt(3 * jax.nn.sigmoid(logit))
    return jax.nn.softplus(logit) + q - jnp.log1p(jnp.expm1(-k * q) / 2)


@jax.custom_jvp
def _logit(total_r: Array, k: Array) -> Array:
    """The root of ln(−ln R(logit)) = ln(−ln total_r), nearly a straight line: Newton, kept in a bracket."""
    target = jnp.log(-jnp.log(total_r))

    def newton(logit: Array) -> tuple[Array, Array]:
        loss, slope = _loss_and_slope(logit, k)
        excess = jnp.log(loss) - target
        return excess, logit - excess * loss / slope

    def narrow(_: int, bracket: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        low, high, logit = bracket
        excess, proposed = newton(logit)
        low = jnp.where(excess < 0, logit, low)
        high = jnp.where(excess > 0, logit, high)
        return low, high, jnp.where((proposed >= low) & (proposed <= high), proposed, (low + high) / 2)

    start = jnp.zeros(jnp.broadcast_shapes(total_r.shape, k.shape), total_r.dtype)
    limit = -jnp.log(jnp.finfo(total_r.dtype).tiny)
    _, _, logit = lax.fori_loop(0, _ITERATIONS, narrow, (start - limit, start + limit, start))
    return newton(logit)[1]


@_logit.defjvp
def _logit_jvp(primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    """The implicit derivative, of −ln R(logit, k) = −ln total_r."""
    total_r, k = primals
    d_total_r, d_k = tangents
    logit = _logit(total_r, k)
    _, along_logit = _loss_and_slope(logit, k)
    _, along_k = jax.jvp(lambda x: _optical_loss(logit, x), (k,), (d_k,))
    return logit, -(d_total_r / total_r + along_k) / along_logit


def _loss_and_slope(logit: Array, k: Array) -> tuple[Array, Array]:
    return jax.jvp(lambda x: _optical_loss(x, k), (logit,), (jnp.ones_like(logit),))
