"""S_d and the BRDF of the whole model, Jensen et al. 2001, sections 2.1 and 2.4.

Directions are unit vectors away from the surface, whose normal is z, of shape (..., 3). Lengths in mm, coefficients in
1/mm. A BRDF depends only on the ratio of coefficients; its values are in 1/sr, and 0 for directions below the surface.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from bssrdf.transport.dipole import Medium, rd, total_r
from bssrdf.transport.fresnel import exit_norm, fresnel_t
from bssrdf.transport.precision import Real
from bssrdf.transport.single import outgoing_radiance


def s_d(medium: Medium, r: Real, cos_i: Real, cos_o: Real, *, paper: bool = False) -> Float[Array, "..."]:
    """S_d [1/(mm² sr)], eq. 5, between points r apart for outside directions of cosines cos_i, cos_o.

    The exit lobe is Ft/C, so that ∫ S_d cos_o dω_o is the Ft(cos_i) R_d(r) that energy asks for; `paper` omits
    1/C as printed.
    """
    return rd(medium, r) * lobe(medium.eta, cos_i, cos_o, paper=paper)


def lobe(eta: Real, cos_i: Real, cos_o: Real, *, paper: bool = False) -> Float[Array, "..."]:
    """The directional factor of S_d [1/sr]: Ft(cos_i) Ft(cos_o)/(π C), with C = 1 for `paper`."""
    norm = 1 if paper else exit_norm(eta)
    return fresnel_t(eta, cos_i) * fresnel_t(eta, cos_o) / (jnp.pi * norm)


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
