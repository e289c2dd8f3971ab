"""A forward model from a table's coefficients: the exact parts added, the curve scaled to its exact total.

NumPy alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.transport.discrete_ordinates import half_spaces
from bssrdf.transport.exit_radiance import DEGREE, shape_basis
from bssrdf.transport.incidence import NORMAL, Incidence, once_scattered
from bssrdf.transport.white.grid import (
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
from bssrdf.transport.white.model import TableModel

Floats = NDArray[np.float64]

_MU_FIT = np.cos(np.radians(np.linspace(0, 80, 17)))
_QUADRATURE = np.polynomial.legendre.leggauss(6)


def assemble(
    eta: float, g: float, log_curve: Floats, log_curve_sd: Floats, angles: Floats, beam: Incidence = NORMAL
) -> TableModel:
    """The model of one (η, g); all arrays in double precision.

    Totals, decay and first order are computed for exactly this η and g, whatever the curve was interpolated from.
    """
    q = q_nodes()
    albedo = albedo_of(q, g)
    exact = half_spaces(albedo[1:], g, eta, _MU_FIT, sin_incidence=beam.sine)
    total = np.append(1.0, exact.total)
    once = once_scattered(eta, g, beam, RHO_ZERO * np.expm1(np.linspace(0, W_MAX, N_W_CELLS + 1)))
    kappa = kappa_reduced(q, g)
    multiple = total - albedo * once.total
    integral = _integral(log_curve, kappa) * ((1 - q) * (1 + q)) ** 2
    scale = np.zeros_like(q) if beam.across else np.log(multiple / integral)  # one side alone has no known integral
    shapes = _exit_shapes(eta, exact.radiance / exact.total[:, None])
    arrays: dict[str, Any] = {
        "log_curve": by_cell(log_curve + interpolating(scale, even=True)[:, None]),
        "log_curve_sd": log_curve_sd,
        "diffusion_ratio": by_cell(interpolating(_diffusion_ratio(kappa, q))),
        "log_total": by_cell(interpolating(-np.log(total / ((1 - q) * (1 + q))))),
        "first": by_cell(interpolating(np.log(once.light))),
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
