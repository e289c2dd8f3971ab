"""R_d of media that share a boundary and a phase function, as tables over the distance in units of 1/σt′.

A medium is then its reduced albedo alone: its R_d(r) is σt′² times the table's at σt′ r. The tables are kept on disk
beside those of Monte Carlo, since JAX, which makes them, takes seconds to start.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.render.kept import kept

Floats = NDArray[np.float64]
Kernel = Literal["table", "dipole"]
KERNELS: tuple[Kernel, ...] = ("table", "dipole")

FIRST = 2.0**-10
"""Of the radii; a shortest mean free path is not under 2⁻⁵ (g = 0.95), and nearer than that light falls as 1/r."""
OCTAVES, PER_OCTAVE = 22, 24
WIDEST = 0.8
"""Radius of a disc over its distance, at most: a node of a tree is small against it."""
DISCS = 8
"""Cells over the square of that, along which a mean over a disc grows evenly."""
COSINES = 128
_VERSION = 2
_FINE = 4
"""Radii between those of the tables, in the integrals."""
_LEAST_ALBEDO = 0.0201
"""Of the Monte Carlo tables; below, light is scattered once, and R is in proportion to the albedo."""


class Kernels(NamedTuple):
    """Tables for media of ascending reduced albedo (k,); radii FIRST · 2^(i/PER_OCTAVE), n of them."""

    albedo: Floats
    total: Floats
    """R = ∫ 2πr R_d dr, (k,)."""
    disc: NDArray[np.float32]
    """Mean of R_d over a disc at distance r of radius √(j/DISCS) WIDEST r, and last r dR_d/dr, (k, n, DISCS + 2)."""
    inside: NDArray[np.float32]
    """∫₀ʳ R_d s ds and ∫₀ʳ R_d s² ds, (k, n, 2)."""
    lobe: Floats
    """Radiance that leaves over Fresnel's transmittance, 1 along the normal, over cosines from 0 to 1, (k, COSINES)."""


def radii() -> Floats:
    """(n,)."""
    return np.asarray(FIRST * 2.0 ** (np.arange(OCTAVES * PER_OCTAVE) / PER_OCTAVE))


def cosines() -> Floats:
    """(COSINES,); the first is not quite 0, where nothing would be transmitted."""
    return np.maximum(np.linspace(0, 1, COSINES), 1e-3)


def kernels(eta: float, g: float, albedo: Floats, kind: Kernel = "table") -> Kernels:
    """The tables for media of these reduced albedos, from the cache where they are in it."""
    known = (_VERSION, kind, eta, g, *albedo.tolist())
    return Kernels(**kept("kernel", known, lambda: _make(eta, g, albedo, kind)._asdict()))


def _make(eta: float, g: float, albedo: Floats, kind: Kernel) -> Kernels:
    fine = FIRST * 2.0 ** (np.arange(-4 * PER_OCTAVE, (OCTAVES + 1) * PER_OCTAVE * _FINE) / (PER_OCTAVE * _FINE))
    found = [_medium(eta, g, each, kind, fine) for each in albedo.tolist()]
    total = np.array([each[1] for each in found])
    tables = [_tables(fine, rd, total) for rd, total, _ in found]
    disc, inside = (np.array(part, np.float32) for part in zip(*tables, strict=True))
    return Kernels(albedo, total, disc, inside, np.array([each[2] for each in found]))


def _medium(eta: float, g: float, albedo: float, kind: Kernel, r: Floats) -> tuple[Floats, float, Floats]:
    """R_d, R and the lobe of a medium with σt′ = 1."""
    import jax.numpy as jnp

    from bssrdf.transport import dipole, scoped_x64, table_model

    @scoped_x64
    def by_dipole() -> tuple[Floats, float, Floats]:
        medium = dipole.Medium(1 - albedo, albedo, eta)
        return np.asarray(dipole.rd(medium, jnp.asarray(r))), float(dipole.total_r(medium)), np.ones(COSINES)

    @scoped_x64
    def by_table() -> tuple[Floats, float, Floats]:
        model = table_model(eta, g)
        known = max(albedo, _LEAST_ALBEDO)
        medium = dipole.Medium(1 - known, known, eta)
        r_max = model.window_mfp[1]
        rd = np.asarray(model.rd(medium, jnp.asarray(np.minimum(r, r_max))))
        far = np.asarray(dipole.rd(medium, jnp.asarray(np.maximum(r, r_max))))
        rd = np.where(r <= r_max, rd, rd[-1] * far / max(float(dipole.rd(medium, r_max)), 1e-300))
        mu = cosines()
        lobe = np.asarray(model.total_radiance_factor(medium, jnp.asarray(mu))) / _transmittance(eta, mu)
        return rd * (albedo / known), float(model.total(medium)) * albedo / known, np.maximum(lobe / lobe[-1], 0)

    return by_dipole() if kind == "dipole" else by_table()


def _transmittance(eta: float, mu: Floats) -> Floats:
    import jax.numpy as jnp

    from bssrdf.transport.fresnel import fresnel_t

    return np.asarray(fresnel_t(eta, jnp.asarray(mu)), np.float64)


def _tables(fine: Floats, rd: Floats, total: float) -> tuple[Floats, Floats]:
    """Means over discs and integrals up to each radius, of an R_d whose integral is brought to `total`."""
    rd = np.maximum(rd, 1e-290)
    flux, moment = (_integral(fine, rd * fine**power) for power in (1, 2))
    scale = total / (2 * math.pi * flux[-1])
    r = radii()
    inside = np.stack([np.interp(np.log(r), np.log(fine), scale * whole) for whole in (flux, moment)], axis=-1)
    return _discs(r, np.log(fine), np.log(np.maximum(rd * scale, 1e-290))), inside


def _integral(x: Floats, y: Floats) -> Floats:
    """∫₀ˣ y dx where y goes as a power of x between its values, and as at first below them."""
    power = np.diff(np.log(y)) / np.diff(np.log(x)) + 1
    ends = x * y
    pieces = np.where(np.abs(power) > 1e-6, np.diff(ends) / power, y[:-1] * x[:-1] * np.diff(np.log(x)))
    return np.concatenate([[0], np.cumsum(pieces)]) + ends[0] / max(float(power[0]), 0.5)


def _discs(r: Floats, log_fine: Floats, log_rd: Floats) -> Floats:
    """Means over discs by rings of equal weight and azimuths, and the slope."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    azimuth = math.pi * (np.arange(16) + 0.5) / 16
    mean = np.empty((len(r), DISCS + 2))
    for j in range(DISCS + 1):
        s = WIDEST * math.sqrt(j / DISCS) * np.sqrt((1 + nodes) / 2)[:, None]
        apart = np.sqrt(1 + s * s + 2 * s * np.cos(azimuth))
        light = np.exp(np.interp(np.log(r[:, None, None] * apart), log_fine, log_rd))
        mean[:, j] = light.mean(axis=2) @ weights / 2
    slope = np.interp(np.log(r), log_fine, np.gradient(log_rd, log_fine))
    mean[:, -1] = mean[:, 0] * slope
    return mean
