"""Fresnel reflection at a smooth dielectric surface and its hemispherical averages; angles enter as cosines.

`eta` is the index inside over the index outside. Everything is dimensionless.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bssrdf.transport.precision import Real

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
_U = (1 + _NODES) / 2
_DU = _WEIGHTS / 2


def fresnel_r(eta: Real, cos_i: Real) -> Float[Array, "..."]:
    """Fr: reflectance for unpolarised light that arrives from outside; `cos_i` is outside."""
    return _reflectance(eta, cos_i)


def fresnel_r_inside(eta: Real, cos_i: Real) -> Float[Array, "..."]:
    """Fr for light that arrives from inside, 1 beyond the critical angle; `cos_i` is inside."""
    return _reflectance(1 / eta, cos_i)


def fresnel_t(eta: Real, cos_i: Real) -> Float[Array, "..."]:
    """Ft = 1 − Fr for light that arrives from, or leaves to, the outside direction `cos_i`."""
    return 1 - fresnel_r(eta, cos_i)


@jax.jit
def fdr(eta: Real) -> Float[Array, "..."]:
    """Fdr, Jensen et al. 2001 section 2.1: the polynomial where it holds, 1 < eta <= 2, and exact elsewhere."""
    polynomial = -1.440 / jnp.square(eta) + 0.710 / eta + 0.668 + 0.0636 * eta
    in_range = (jnp.asarray(eta) > 1) & (jnp.asarray(eta) <= 2)
    return jnp.where(in_range, polynomial, fdr_exact(eta))


@jax.jit
def fdr_exact(eta: Real) -> Float[Array, "..."]:
    """Average Fr of Lambertian light that arrives from inside, 2∫Fr μ dμ, to 1e-10."""
    denser, reflected = _denser_side(eta)
    from_denser = ((denser - 1) * (denser + 1) + reflected) / jnp.square(denser)
    return jnp.where(jnp.asarray(eta) >= 1, from_denser, reflected)


@jax.jit
def exit_norm(eta: Real) -> Float[Array, "..."]:
    """C = 2∫₀¹ Ft(eta, μ) μ dμ over outside directions: keeps the hemispherical total of an exit lobe Ft/C."""
    denser, reflected = _denser_side(eta)
    return jnp.where(jnp.asarray(eta) >= 1, 1 - reflected, (1 - reflected) / jnp.square(denser))


def boundary_a(eta: Real, exact: bool = False) -> Float[Array, "..."]:
    """A = (1 + Fdr)/(1 − Fdr); `exact` takes Fdr by quadrature at every eta."""
    reflected = fdr_exact(eta) if exact else fdr(eta)
    return (1 + reflected) / (1 - reflected)


def _reflectance(index: Real, cos_i: Real) -> Float[Array, "..."]:
    """Fresnel's equations for light that meets a medium of relative index `index`; derivatives finite everywhere."""
    refracted2 = (index - 1) * (index + 1) + jnp.square(cos_i)  # (index cos_t)², below 0 in total reflection
    oblique = refracted2 > 0
    cos_r = jnp.where(oblique, jnp.sqrt(jnp.where(oblique, refracted2, 1)), 0)
    r_s = _contrast(cos_i, cos_r)
    r_p = _contrast(index * index * cos_i, cos_r)
    return jnp.where(refracted2 < 0, 1, (r_s * r_s + r_p * r_p) / 2)


def _contrast(a: Real, b: Float[Array, "..."]) -> Float[Array, "..."]:
    """(a − b)/(a + b), and 0 where both are 0: no surface, seen edge on."""
    total = a + b
    return jnp.where(total > 0, (a - b) / jnp.where(total > 0, total, 1), 0)


def _denser_side(eta: Real) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """The index above 1, max(eta, 1/eta), and the average Fr of Lambertian light that meets it from the rarer side.

    Reciprocity turns this into either average from either side, so that the critical angle is a limit of the
    integral instead of a kink in it. With μ = u³ the nodes crowd where eta near 1 puts a boundary layer.
    """
    eta = jnp.asarray(eta, dtype=jnp.result_type(eta, float))
    denser = jnp.where(eta >= 1, eta, 1 / eta)
    shape = (-1,) + (1,) * eta.ndim
    u = jnp.asarray(_U, eta.dtype).reshape(shape)
    weight = jnp.asarray(6 * _U**5 * _DU, eta.dtype).reshape(shape)
    return denser, jnp.sum(weight * _reflectance(denser[None], u**3), axis=0)
