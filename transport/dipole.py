"""The dipole diffusion model of Jensen et al. 2001, section 2.1. Lengths in mm, coefficients in 1/mm.

Values are per unit flux that entered the medium and hemispherical over exit directions. All functions are
elementwise in their arguments and finite, with finite derivatives, at r = 0, sigma_a = 0, albedo_p = 1 and far out.
Where the true derivative is infinite, that of the tail and the total in sigma_a = 0, it is given without that part.
Arrays of the medium and of r broadcast by equal rank. The dtype is that of the medium and r together: in an x64 scope
Python floats count as float64.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from bssrdf.transport.fresnel import boundary_a
from bssrdf.transport.precision import Real


class Medium(NamedTuple):
    """A semi-infinite homogeneous medium, by what the dipole can tell apart."""

    sigma_a: Real
    sigma_sp: Real
    eta: Real

    @property
    def sigma_tp(self) -> Real:
        """Reduced extinction coefficient σt′; 1/σt′ is the reduced mean free path."""
        return self.sigma_a + self.sigma_sp

    @property
    def albedo_p(self) -> Real:
        """Reduced albedo α′."""
        return self.sigma_sp / self.sigma_tp

    @property
    def diffusion(self) -> Real:
        """Diffusion constant D [mm]."""
        return 1 / (3 * self.sigma_tp)

    @property
    def sigma_tr(self) -> Float[Array, "..."]:
        """Effective transport coefficient σtr."""
        return safe_sqrt(_square(self))

    @property
    def z_r(self) -> Real:
        """Depth of the real source."""
        return 1 / self.sigma_tp

    @property
    def z_v(self) -> Float[Array, "..."]:
        """Height of the virtual source."""
        return self.z_r + 4 * boundary_a(self.eta) * self.diffusion


@jax.jit
def fluence(medium: Medium, r: Real, z: Real) -> Float[Array, "..."]:
    """φ(r, z) [1/mm²] at depth z, section 2.1, for a source of power albedo_p; infinite at the source itself."""

    def source(d: Float[Array, "..."]) -> Float[Array, "..."]:
        return jnp.exp(-medium.sigma_tr * d) / d

    d_r = _distance(r, z - medium.z_r)
    d_v = _distance(r, z + medium.z_v)
    return medium.albedo_p / (4 * jnp.pi * medium.diffusion) * (source(d_r) - source(d_v))


@jax.jit
def rd(medium: Medium, r: Real) -> Float[Array, "..."]:
    """R_d(r) [1/mm²], eq. 4, without the factor 1/σt′ misprinted in its second term."""

    def source(z: Real) -> Float[Array, "..."]:
        d = _distance(r, z)
        return z * diffuse_decay(_square(medium) * d * d) / d**3

    return medium.albedo_p / (4 * jnp.pi) * (source(medium.z_r) + source(medium.z_v))


@jax.jit
def log_rd(medium: Medium, r: Real) -> Float[Array, "..."]:
    """ln R_d(r), eq. 4, finite where R_d itself underflows."""

    def source(z: Real) -> Float[Array, "..."]:
        d = _distance(r, z)
        return jnp.log(z) + _log_decay(_square(medium) * d * d) - 3 * jnp.log(d)

    return jnp.log(medium.albedo_p / (4 * jnp.pi)) + jnp.logaddexp(source(medium.z_r), source(medium.z_v))


@jax.jit
def tail(medium: Medium, r: Real) -> Float[Array, "..."]:
    """∫_r^∞ 2πs R_d(s) ds, in closed form."""

    def source(z: Real) -> Float[Array, "..."]:
        d = _distance(r, z)
        return z * jnp.exp(-medium.sigma_tr * d) / d

    return medium.albedo_p / 2 * (source(medium.z_r) + source(medium.z_v))


@jax.jit
def log_tail(medium: Medium, r: Real) -> Float[Array, "..."]:
    """ln of the tail, finite where the tail itself underflows."""

    def source(z: Real) -> Float[Array, "..."]:
        d = _distance(r, z)
        return jnp.log(z) - medium.sigma_tr * d - jnp.log(d)

    return jnp.log(medium.albedo_p / 2) + jnp.logaddexp(source(medium.z_r), source(medium.z_v))


@jax.jit
def bin_average(medium: Medium, r_lo: Real, r_hi: Real) -> Float[Array, "..."]:
    """Mean of R_d over the annulus [r_lo, r_hi], weighted by r dr: the difference of its tails over its area.

    The difference is taken analytically, so thin and far bins lose no digits; at r_lo = r_hi this is R_d.
    """

    def source(z: Real) -> Float[Array, "..."]:
        d_lo = _distance(r_lo, z)
        d_hi = _distance(r_hi, z)
        width = (r_hi - r_lo) * (r_hi + r_lo) / (d_lo + d_hi)  # d_hi − d_lo
        return z * _annulus(_square(medium), d_lo, d_hi, width)

    return medium.albedo_p / (2 * jnp.pi) * (source(medium.z_r) + source(medium.z_v))


@jax.jit
def total_r(medium: Medium) -> Float[Array, "..."]:
    """Total diffuse reflectance R, the integral of eq. 4 over the surface."""
    return total_r_of_ratio(medium.sigma_a / medium.sigma_tp, medium.eta)


@jax.jit
def total_r_of_ratio(absorption_ratio: Real, eta: Real) -> Float[Array, "..."]:
    """R from absorption_ratio = σa/σt′ = 1 − albedo_p, which alone keeps its digits near albedo 1."""
    q = safe_sqrt(3 * absorption_ratio)
    return (1 - absorption_ratio) / 2 * (1 + jnp.exp(-4 / 3 * boundary_a(eta) * q)) * jnp.exp(-q)


def safe_sqrt(x: Real) -> Float[Array, "..."]:
    """√x with derivative 0 instead of infinity at 0."""
    positive = jnp.asarray(x) > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1)), 0)


def mean_decay(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """(1 − e^−x)/x: the mean of e^−t over 0 ≤ t ≤ x, 1 at x = 0."""
    positive = x > 0
    safe = jnp.where(positive, x, 1)
    return jnp.where(positive, -jnp.expm1(-safe) / safe, 1)


def _square(medium: Medium) -> Real:
    """σtr²: R_d is smooth in it at sigma_a = 0, but not in σtr."""
    return 3 * medium.sigma_a * medium.sigma_tp


def _distance(r: Real, z: Real) -> Float[Array, "..."]:
    return jnp.sqrt(jnp.square(r) + jnp.square(z))


@jax.custom_jvp
def diffuse_decay(x2: Float[Array, "..."]) -> Float[Array, "..."]:
    """(1 + x) e^−x as a function of x², in which its derivative is finite at 0."""
    x = safe_sqrt(x2)
    return (1 + x) * jnp.exp(-x)


@diffuse_decay.defjvp
def _decay_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (x2,), (d_x2,) = primals, tangents
    return diffuse_decay(x2), -jnp.exp(-safe_sqrt(x2)) / 2 * d_x2


@jax.custom_jvp
def _log_decay(x2: Float[Array, "..."]) -> Float[Array, "..."]:
    """ln((1 + x) e^−x) as a function of x²."""
    x = safe_sqrt(x2)
    return jnp.log1p(x) - x


@_log_decay.defjvp
def _log_decay_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (x2,), (d_x2,) = primals, tangents
    return _log_decay(x2), -1 / (2 * (1 + safe_sqrt(x2))) * d_x2


def _annulus_value(s2: Array, d_lo: Array, d_hi: Array, width: Array) -> Float[Array, "..."]:
    """(e^(−s d_lo)/d_lo − e^(−s d_hi)/d_hi) / (d_hi² − d_lo²) as a function of s²; `width` is d_hi − d_lo."""
    s = safe_sqrt(s2)
    inside = s * mean_decay(s * width) + jnp.exp(-s * width) / d_hi
    return jnp.exp(-s * d_lo) * inside / (d_lo * (d_lo + d_hi))


_annulus = jax.custom_jvp(_annulus_value)


@_annulus.defjvp
def _annulus_jvp(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
    s2, d_lo, d_hi, width = primals
    d_s2, *d_lengths = tangents
    value, along_lengths = jax.jvp(functools.partial(_annulus_value, s2), (d_lo, d_hi, width), tuple(d_lengths))
    s = safe_sqrt(s2)
    along_s2 = -jnp.exp(-s * d_lo) * mean_decay(s * width) / (2 * (d_lo + d_hi)) * d_s2
    return value, along_lengths + along_s2
