"""The light of a white Monte Carlo table in JAX. Lengths in mm, coefficients in 1/mm.

R_d(r) is light scattered once, known exactly, plus that scattered twice or more, from the table (see `smooth`). The
integral of both over the surface is the total by discrete ordinates.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bssrdf.errors import InputError
from bssrdf.transport.dipole import Medium, diffuse_decay
from bssrdf.transport.exit_radiance import DEGREE
from bssrdf.transport.forward import Azimuths
from bssrdf.transport.fresnel import fresnel_t
from bssrdf.transport.precision import Real
from bssrdf.transport.single import phase_hg
from bssrdf.transport.white.coefficients import Coefficients
from bssrdf.transport.white.grid import (
    N_U_CELLS,
    N_U_COARSE,
    Q_MAX,
    Q_ZERO,
    R_MAX,
    R_ZERO,
    RHO_ZERO,
    U_MAX,
    V_MAX,
    W_MAX,
)

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def rd(table: Coefficients, medium: Medium, r: Real) -> Float[Array, "..."]:
    """R_d(r) [1/mm²]; raises InputError outside the table where the values are known."""
    check(medium, r)
    return _first(table, medium, r) + _multiple(table, medium, r)


def bin_average(table: Coefficients, medium: Medium, r_lo: Real, r_hi: Real) -> Float[Array, "..."]:
    """Mean of R_d over the annulus [r_lo, r_hi], weighted by r dr."""
    check(medium, r_hi)
    at_nodes = Medium(*(_with_nodes(field) for field in medium))
    unit = R_ZERO / at_nodes.sigma_tp
    v_lo, v_hi = jnp.log1p(_with_nodes(r_lo) / unit), jnp.log1p(_with_nodes(r_hi) / unit)
    column = (-1, *(1,) * (jnp.ndim(v_hi) - 1)) if jnp.ndim(v_hi) else (-1,)
    r = unit * jnp.expm1(v_lo + (v_hi - v_lo) * ((1 + _NODES) / 2).reshape(column).astype(v_hi.dtype))
    ring = _WEIGHTS.reshape(column).astype(v_hi.dtype) * r * (r + unit)
    light = _first(table, at_nodes, r) + _multiple(table, at_nodes, r)
    return (ring * light).sum(axis=0) / ring.sum(axis=0)


def total(table: Coefficients, medium: Medium) -> Float[Array, "..."]:
    """Total diffuse reflectance."""
    check(medium, 0.0)
    return medium.albedo_p * jnp.exp(-_cubic(table.log_total, _u(medium)))


def radiance(table: Coefficients, medium: Medium, r: Real, mu: Real, azimuths: Azimuths) -> Float[Array, "..."]:
    """π L [1/mm²] at radius r > 0 towards the outside cosine `mu`, a mean over `azimuths`.

    The odd harmonics are left out, which the two sides of a spot cancel, and the even ones go as the second does.
    """
    check(medium, r)
    v = jnp.minimum(jnp.log1p(r * medium.sigma_tp / R_ZERO) / V_MAX, 1)
    rows = jnp.moveaxis(_rows(table.angles, _u(medium), N_U_COARSE), -3, 0)
    rank = max(jnp.ndim(v) - (rows.ndim - 3), 0)
    shape = _cubic(jnp.expand_dims(rows, tuple(range(rows.ndim - 2, rows.ndim - 2 + rank))), v[None])
    lobe = _exit_lobe(table.eta, mu, shape[: DEGREE + 1])
    square_of_sine = (1 - jnp.square(mu)) / jnp.square(table.eta)
    across = square_of_sine * _exit_lobe(table.eta, mu, shape[DEGREE + 1 :])
    multiple = _multiple(table, medium, r) * (lobe - azimuths.cos_2 * across)
    return multiple + azimuths.along * _first_radiance(table, medium, r, mu)


def total_radiance_factor(table: Coefficients, medium: Medium, mu: Real) -> Float[Array, "..."]:
    """π L/R over the whole surface towards the outside cosine `mu`: 1 for a Lambertian surface."""
    check(medium, 0.0)
    u = _u(medium)
    cells = jnp.expand_dims(table.total_angles, tuple(range(1, 1 + jnp.ndim(u))))
    return _exit_lobe(table.eta, mu, _cubic(cells, u[None])[: DEGREE + 1])


def check(medium: Medium, r: Real) -> None:
    """Raise InputError where medium or radius, if known outside a compiled function, lie outside the table."""
    values = (medium.sigma_a, medium.sigma_sp, r)
    if any(isinstance(value, jax.core.Tracer) for value in values):
        return
    sigma_a, sigma_sp, radius = (np.asarray(value) for value in values)
    if not (np.all(np.isfinite(sigma_a)) and np.all(sigma_a >= 0)):
        raise InputError(f"sigma_a = {sigma_a}: the Monte Carlo table needs finite values of at least 0 [1/mm]")
    if not (np.all(np.isfinite(sigma_sp)) and np.all(sigma_sp > 0)):
        raise InputError(f"sigma_sp = {sigma_sp}: the Monte Carlo table needs finite values above 0 [1/mm]")
    lowest = float(np.min(sigma_sp / (sigma_a + sigma_sp)))
    if lowest < (1 - Q_MAX**2) * (1 - 1e-6):
        raise InputError(f"reduced albedo = {lowest:.4g}: the Monte Carlo table starts at {1 - Q_MAX**2:.4g}")
    if not np.all(radius >= 0):
        raise InputError(f"r = {np.min(radius)}: give radii of at least 0 [mm]")
    farthest = float(np.max(radius * (sigma_a + sigma_sp)))
    if farthest > R_MAX * (1 + 1e-6):
        raise InputError(f"r = {farthest:.4g} reduced mean free paths: the Monte Carlo table ends at {R_MAX:g}")


@jax.jit
def _first(table: Coefficients, medium: Medium, r: Real) -> Float[Array, "..."]:
    sigma_s = medium.sigma_sp / (1 - table.g)
    sigma_t = sigma_s + medium.sigma_a
    rho = sigma_t * r
    w = jnp.log1p(rho / RHO_ZERO) / W_MAX
    return sigma_s / r * jnp.exp(_cubic(table.first, jnp.minimum(w, 1)) - table.first_decay * rho)


@jax.jit
def _first_radiance(table: Coefficients, medium: Medium, r: Real, mu: Real) -> Float[Array, "..."]:
    """π L⁽¹⁾, the mean over all azimuths; see `single.first_order_bin_average` for the geometry."""
    sine = jnp.sqrt(1 - jnp.square(mu))
    inside = jnp.sqrt(1 - jnp.square(sine / table.eta))
    sigma_s = medium.sigma_sp / (1 - table.g)
    path = (sigma_s + medium.sigma_a) * table.eta * (1 + inside) * r
    safe = jnp.maximum(sine, jnp.finfo(jnp.result_type(sine)).tiny ** 0.25)
    decay = jnp.exp(-path / safe) / safe
    return sigma_s * phase_hg(table.g, -inside) * fresnel_t(table.eta, mu) * decay / (2 * table.eta * r)


@jax.jit
def _multiple(table: Coefficients, medium: Medium, r: Real) -> Float[Array, "..."]:
    u = _u(medium)
    x = medium.sigma_tp * r
    ratio = medium.sigma_a / medium.sigma_tp
    kappa2 = 3 * ratio * _cubic(table.diffusion_ratio, u)
    v = jnp.log1p(x / R_ZERO) / V_MAX
    smooth = _cubic(_rows(table.log_curve, u, N_U_CELLS), jnp.minimum(v, 1))
    beyond = 3 * V_MAX * jnp.maximum(v - 1, 0)  # diffusing light goes on as the cube of the radius
    return jnp.square(medium.sigma_sp) * jnp.exp(smooth - beyond) * diffuse_decay(kappa2 * x * x)


def _u(medium: Medium) -> Float[Array, "..."]:
    """u/U_MAX of the medium. Light is even in q at q = 0: a q of 1e-8 there keeps derivatives right and finite."""
    ratio = jnp.asarray(medium.sigma_a / medium.sigma_tp)
    q = jnp.sqrt(ratio + jnp.finfo(jnp.result_type(ratio, float)).eps)
    return (jnp.log1p(q / Q_ZERO) + jnp.log(medium.sigma_tp / medium.sigma_sp) / 2) / U_MAX


def _with_nodes(value: Real) -> Float[Array, "..."]:
    """An array with a first axis of length 1 for the nodes of a quadrature; a number stays one."""
    array = jnp.asarray(value)
    return array[None] if array.ndim else array


def _rows(coefficients: Float[Array, "u ..."], t: Float[Array, "..."], n_cells: int) -> Float[Array, "..."]:
    """What a table holds along its further axes, at t in [0, 1] along its first."""
    first = jnp.clip((t * n_cells).astype(jnp.int32), 0, n_cells - 1)
    f = jnp.expand_dims(t * n_cells - first, tuple(range(t.ndim, t.ndim + coefficients.ndim - 1)))
    e = 1 - f
    weights = (e**3 / 6, 2 / 3 - f * f * (1 - f / 2), 2 / 3 - e * e * (1 - e / 2), f**3 / 6)
    a, b, c, d = (weight * jnp.asarray(coefficients)[first + k] for k, weight in enumerate(weights))
    return a + b + c + d


def _cubic(cells: Float[Array, "... 4 n"], t: Float[Array, "..."]) -> Float[Array, "..."]:
    """Piecewise cubic at t in [0, 1]; leading axes of the cells broadcast against t."""
    lead, n = cells.shape[:-2], cells.shape[-1]
    cell = jnp.clip((t * n).astype(jnp.int32), 0, n - 1)
    f = t * n - cell
    start = 4 * n * jnp.arange(np.prod(lead, dtype=int), dtype=jnp.int32).reshape(lead) + cell
    flat = jnp.asarray(cells).reshape(-1)
    a, b, c, d = (flat.at[start + k * n].get(mode="promise_in_bounds") for k in range(4))
    return ((d * f + c) * f + b) * f + a


def _exit_lobe(eta: Real, mu: Real, shape: Float[Array, "k ..."]) -> Float[Array, "..."]:
    """Ft times the sum of Legendre polynomials of `exit_radiance` in the cosine inside."""
    grazing = jnp.sqrt(1 - 1 / jnp.square(eta))
    inside = jnp.sqrt(1 - (1 - jnp.square(mu)) / jnp.square(eta))
    centred = (2 * inside - 1 - grazing) / (1 - grazing)
    polynomials = [jnp.ones_like(centred), centred]
    for k in range(1, len(shape) - 1):
        polynomials.append(((2 * k + 1) * centred * polynomials[k] - k * polynomials[k - 1]) / (k + 1))
    terms = (jnp.stack(polynomials), shape)
    rank = max(term.ndim for term in terms)
    basis, weights = (term.reshape(*term.shape, *(1,) * (rank - term.ndim)) for term in terms)
    return fresnel_t(eta, mu) * (basis * weights).sum(axis=0)
