"""The diffusion term of the BSSRDF, Jensen et al. 2001, section 2.1. Lengths in mm, coefficients in 1/mm."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from bssrdf.transport.dipole import Medium, rd
from bssrdf.transport.fresnel import exit_norm, fresnel_t
from bssrdf.transport.precision import Real


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
