"""The BRDF of the whole model, Jensen et al. 2001, section 2.4: the BSSRDF where the mean free path is out of sight.

Directions are unit vectors away from the surface, whose normal is z, of shape (..., 3). Coefficients in 1/mm; the BRDF
depends only on their ratio. Values are in 1/sr, and 0 for directions below the surface.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from bssrdf.transport.bssrdf import lobe
from bssrdf.transport.dipole import Medium, total_r
from bssrdf.transport.precision import Real
from bssrdf.transport.single import outgoing_radiance


def brdf(
    medium: Medium, g: Real, w_i: Float[Array, "... 3"], w_o: Float[Array, "... 3"], *, paper: bool = False
) -> Float[Array, "..."]:
    """f_r = f_r⁽¹⁾ + F R/π, with the sum's known excess: the dipole already holds much of the single scattering.

    `paper` is the printed form: without 1/η² in the first term and without the 1/C of the exit lobe in the second.
    """
    return brdf_single(medium, g, w_i, w_o, paper=paper) + brdf_diffuse(medium, w_i, w_o, paper=paper)


def brdf_single(
    medium: Medium, g: Real, w_i: Float[Array, "... 3"], w_o: Float[Array, "... 3"], *, paper: bool = False
) -> Float[Array, "..."]:
    """f_r⁽¹⁾ = α F p(ω_i′·ω_o′) / (η² (|n·ω_i′| + |n·ω_o′|)), with σs = σs′/(1 − g)."""
    sigma_s = medium.sigma_sp / (1 - g)
    value = outgoing_radiance(sigma_s, medium.sigma_a, g, medium.eta, w_i, w_o, paper=paper)
    return jnp.where(_above(w_i, w_o), value, 0)


def brdf_diffuse(
    medium: Medium, w_i: Float[Array, "... 3"], w_o: Float[Array, "... 3"], *, paper: bool = False
) -> Float[Array, "..."]:
    """F R/(π C): the integral of S_d over the surface."""
    value = total_r(medium) * lobe(medium.eta, w_i[..., 2], w_o[..., 2], paper=paper)
    return jnp.where(_above(w_i, w_o), value, 0)


def _above(w_i: Float[Array, "... 3"], w_o: Float[Array, "... 3"]) -> Array:
    return (w_i[..., 2] > 0) & (w_o[..., 2] > 0)
