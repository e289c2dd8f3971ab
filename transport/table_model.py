"""The white Monte Carlo table as a forward model in JAX. Lengths in mm, coefficients in 1/mm.

R_d(r) is light scattered once, known exactly, plus that scattered twice or more, from the table (see `table_fit`). The
integral of both over the surface is the total by discrete ordinates.
"""

from __future__ import annotations

from typing import NamedTuple

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
from bssrdf.transport.table_grid import (
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


class TableModel(NamedTuple):
    """Monte Carlo light of a half space of one η and g, as spline coefficients; `table_assembly` makes it."""

    eta: Real
    g: Real
    log_curve: Float[Array, "u 4 v"]
    """S of `table_fit`: along u splines' coefficients, along v cubics by cell."""
    log_curve_sd: Float[Array, "q v"]
    """Its standard error at the knots: relative error of the light scattered twice or more."""
    diffusion_ratio: Float[Array, "4 u"]
    """κ²/(3 σa σt′): 1 at albedo 1."""
    log_total: Float[Array, "4 u"]
    """−ln(R/α′)."""
    first: Float[Array, "4 w"]
    """ln(ρ R⁽¹⁾/(σs σt)) + first_decay ρ along ln(1 + ρ/RHO_ZERO), ρ = σt r."""
    first_decay: Real
    angles: Float[Array, "u k 4 v"]
    """Shape of the exit radiance of the light scattered twice or more, see `table_fit`."""
    total_angles: Float[Array, "k 4 u"]
    """The same of the total, over all azimuths."""

    @property
    def name(self) -> str:
        return "mc"

    @property
    def q_max(self) -> float:
        return float(np.sqrt(3) * Q_MAX)

    @property
    def window_mfp(self) -> tuple[float, float]:
        return (0.0, R_MAX)

    @property
    def relative_error(self) -> float:
        return 0.003

    @property
    def exit_error_mfp(self) -> float:
        return 0.008  # docs/white-tables.md

    def rd(self, medium: Medium, r: Real) -> Float[Array, "..."]:
        """R_d(r) [1/mm²]; raises InputError outside the table where the values are known."""
        self.check(medium, r)
        return self._first(medium, r) + self._multiple(medium, r)

    def bin_average(self, medium: Medium, r_lo: Real, r_hi: Real) -> Float[Array, "..."]:
        """Mean of R_d over the annulus [r_lo, r_hi], weighted by r dr."""
        self.check(medium, r_hi)
        at_nodes = Medium(*(_with_nodes(field) for field in medium))
        unit = R_ZERO / at_nodes.sigma_tp
        v_lo, v_hi = jnp.log1p(_with_nodes(r_lo) / unit), jnp.log1p(_with_nodes(r_hi) / unit)
        column = (-1, *(1,) * (jnp.ndim(v_hi) - 1)) if jnp.ndim(v_hi) else (-1,)
        r = unit * jnp.expm1(v_lo + (v_hi - v_lo) * ((1 + _NODES) / 2).reshape(column).astype(v_hi.dtype))
        ring = _WEIGHTS.reshape(column).astype(v_hi.dtype) * r * (r + unit)
        light = self._first(at_nodes, r) + self._multiple(at_nodes, r)
        return (ring * light).sum(axis=0) / ring.sum(axis=0)

    def total(self, medium: Medium) -> Float[Array, "..."]:
        """Total diffuse reflectance."""
        self.check(medium, 0.0)
        return medium.albedo_p * jnp.exp(-_cubic(self.log_total, _u(medium)))

    def radiance(self, medium: Medium, r: Real, mu: Real, azimuths: Azimuths) -> Float[Array, "..."]:
        """π L [1/mm²] at radius r > 0 towards the outside cosine `mu`, a mean over `azimuths`.

        The odd harmonics are left out, which the two sides of a spot cancel, and the even ones go as the second does.
        """
        self.check(medium, r)
        v = jnp.minimum(jnp.log1p(r * medium.sigma_tp / R_ZERO) / V_MAX, 1)
        rows = jnp.moveaxis(_rows(self.angles, _u(medium), N_U_COARSE), -3, 0)
        rank = max(jnp.ndim(v) - (rows.ndim - 3), 0)
        shape = _cubic(jnp.expand_dims(rows, tuple(range(rows.ndim - 2, rows.ndim - 2 + rank))), v[None])
        lobe = _exit_lobe(self.eta, mu, shape[: DEGREE + 1])
        square_of_sine = (1 - jnp.square(mu)) / jnp.square(self.eta)
        across = square_of_sine * _exit_lobe(self.eta, mu, shape[DEGREE + 1 :])
        multiple = self._multiple(medium, r) * (lobe - azimuths.cos_2 * across)
        return multiple + azimuths.along * self._first_radiance(medium, r, mu)

    def total_radiance_factor(self, medium: Medium, mu: Real) -> Float[Array, "..."]:
        """π L/R over the whole surface towards the outside cosine `mu`: 1 for a Lambertian surface."""
        self.check(medium, 0.0)
        u = _u(medium)
        cells = jnp.expand_dims(self.total_angles, tuple(range(1, 1 + jnp.ndim(u))))
        return _exit_lobe(self.eta, mu, _cubic(cells, u[None])[: DEGREE + 1])

    def check(self, medium: Medium, r: Real) -> None:
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
    def _first(self, medium: Medium, r: Real) -> Float[Array, "..."]:
        sigma_s = medium.sigma_sp / (1 - self.g)
        sigma_t = sigma_s + medium.sigma_a
        rho = sigma_t * r
        w = jnp.log1p(rho / RHO_ZERO) / W_MAX
        return sigma_s / r * jnp.exp(_cubic(self.first, jnp.minimum(w, 1)) - self.first_decay * rho)

    @jax.jit
    def _first_radiance(self, medium: Medium, r: Real, mu: Real) -> Float[Array, "..."]:
        """π L⁽¹⁾, the mean over all azimuths; see `single.first_order_bin_average` for the geometry."""
        sine = jnp.sqrt(1 - jnp.square(mu))
        inside = jnp.sqrt(1 - jnp.square(sine / self.eta))
        sigma_s = medium.sigma_sp / (1 - self.g)
        path = (sigma_s + medium.sigma_a) * self.eta * (1 + inside) * r
        safe = jnp.maximum(sine, jnp.finfo(jnp.result_type(sine)).tiny ** 0.25)
        decay = jnp.exp(-path / safe) / safe
        return sigma_s * phase_hg(self.g, -inside) * fresnel_t(self.eta, mu) * decay / (2 * self.eta * r)

    @jax.jit
    def _multiple(self, medium: Medium, r: Real) -> Float[Array, "..."]:
        u = _u(medium)
        x = medium.sigma_tp * r
        ratio = medium.sigma_a / medium.sigma_tp
        kappa2 = 3 * ratio * _cubic(self.diffusion_ratio, u)
        v = jnp.log1p(x / R_ZERO) / V_MAX
        smooth = _cubic(_rows(self.log_curve, u, N_U_CELLS), jnp.minimum(v, 1))
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
