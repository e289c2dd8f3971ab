"""A forward model from a table's coefficients: the exact parts added, the curve scaled to its exact total.

NumPy alone: `first_order` is `single.first_order_rd` of one medium, written once more for that reason.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.transport.discrete_ordinates import half_spaces
from bssrdf.transport.exit_radiance import DEGREE, shape_basis, transmittance
from bssrdf.transport.table_grid import (
    N_U_CELLS,
    N_V_CELLS,
    N_W_CELLS,
    R_MAX,
    R_ZERO,
    RHO_ZERO,
    V_MAX,
    W_MAX,
    albedo_of,
    basis,
    by_cell,
    interpolating,
    kappa_reduced,
    log_decay,
    q_nodes,
)
from bssrdf.transport.table_model import TableModel

Floats = NDArray[np.float64]

_MU_FIT = np.cos(np.radians(np.linspace(0, 80, 17)))
_QUADRATURE = np.polynomial.legendre.leggauss(6)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(96)
_THETA = np.pi / 2 * ((1 + _NODES) / 2) ** 3
"""Outside exit angles, crowded at the normal as in `single`."""
_D_THETA = np.pi / 2 * 3 * ((1 + _NODES) / 2) ** 2 * _WEIGHTS / 2


def assemble(eta: float, g: float, log_curve: Floats, log_curve_sd: Floats, angles: Floats) -> TableModel:
    """The model of one (η, g); all arrays in double precision.

    Totals, decay and first order are computed for exactly this η and g, whatever the curve was interpolated from.
    """
    q = q_nodes()
    albedo = albedo_of(q, g)
    exact = half_spaces(albedo[1:], g, eta, _MU_FIT)
    total = np.append(1.0, exact.total)
    once = first_order(eta, g)
    kappa = kappa_reduced(q, g)
    integral = _integral(log_curve, kappa) * ((1 - q) * (1 + q)) ** 2
    scale = np.log((total - albedo * once.total) / integral)
    shapes = _exit_shapes(eta, exact.radiance / exact.total[:, None])
    arrays: dict[str, Any] = {
        "log_curve": by_cell(log_curve + interpolating(scale, even=True)[:, None]),
        "log_curve_sd": log_curve_sd,
        "diffusion_ratio": by_cell(interpolating(_diffusion_ratio(kappa, q))),
        "log_total": by_cell(interpolating(-np.log(total / ((1 - q) * (1 + q))))),
        "first": by_cell(interpolating(once.log_light)),
        "angles": by_cell(np.swapaxes(angles, 1, 2)),
        "total_angles": by_cell(interpolating(np.concatenate([_at_conservative(shapes, q), shapes])).T),
    }
    return TableModel(eta=eta, g=g, first_decay=once.decay, **arrays)


def _diffusion_ratio(kappa: Floats, q: Floats) -> Floats:
    """κ²/(3q²), 1 in the limit q = 0."""
    return np.append(1.0, (kappa[1:] / q[1:]) ** 2 / 3)


def _at_conservative(values: Floats, q: Floats) -> Floats:
    """Values at q = 0 by a parabola through the next three, shape (1, …)."""
    return np.asarray(np.polynomial.polynomial.polyfit(q[1:4], values[:3], 2)[:1])


class FirstOrder(NamedTuple):
    """Light scattered once, per σs/σt; lengths in 1/σt."""

    log_light: Floats
    """ln(ρ R⁽¹⁾) + decay ρ at the knots in ρ."""
    decay: float
    """η + √(η² − 1): that of the light which leaves along the surface."""
    total: float
    """∫ 2πρ R⁽¹⁾ dρ."""


def first_order(eta: float, g: float) -> FirstOrder:
    """See `single.first_order_bin_average` for the equations."""
    inside = np.sqrt((eta - 1) * (eta + 1) + np.cos(_THETA) ** 2) / eta
    phase = (1 - g * g) / (4 * np.pi) * (1 + g * g + 2 * g * inside) ** -1.5
    leaving = phase * transmittance(eta, np.cos(_THETA)) * np.cos(_THETA) * _D_THETA
    decay = eta + np.sqrt(eta**2 - 1)
    rho = RHO_ZERO * np.expm1(np.linspace(0, W_MAX, N_W_CELLS + 1))
    excess = eta * (1 + inside) / np.sin(_THETA) - decay
    light = np.exp(-excess * rho[:, None]) @ leaving / eta
    total = 2 * np.pi * np.sum(leaving * np.sin(_THETA) / (1 + inside)) / eta**2
    return FirstOrder(np.log(light), float(decay), float(total))


def _integral(log_curve: Floats, kappa: Floats) -> Floats:
    """∫ 2πr e^S (1 + κ r) e^(−κ r) dr at every knot of q, the tail beyond R_MAX going on as r⁻³."""
    nodes, weights = _QUADRATURE
    v = V_MAX * (np.arange(N_V_CELLS)[:, None] + (1 + nodes) / 2).ravel() / N_V_CELLS
    dv = np.tile(weights, N_V_CELLS) * V_MAX / N_V_CELLS / 2
    r = R_ZERO * np.expm1(v)
    at_knots = basis(np.arange(N_U_CELLS + 1.0), float(N_U_CELLS), N_U_CELLS) @ log_curve
    within = np.exp((basis(v, V_MAX, N_V_CELLS) @ at_knots.T).T + log_decay(kappa[:, None] * r))
    edge = np.exp((basis(np.array([V_MAX]), V_MAX, N_V_CELLS) @ at_knots.T)[0] - kappa * R_MAX)
    return 2 * np.pi * (within @ (dv * r * (r + R_ZERO)) + edge * R_MAX**2)


def _exit_shapes(eta: float, factors: Floats) -> Floats:
    """Coefficients, (n, DEGREE + 1), of the radiance factors (n, …) given at `_MU_FIT`."""
    return np.asarray(np.linalg.lstsq(shape_basis(eta, _MU_FIT), factors.T, rcond=None)[0].T)


assert _MU_FIT.size > DEGREE + 1
