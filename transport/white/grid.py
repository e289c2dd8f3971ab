"""The grid of the white tables and splines on it. q = √(1 − α′) names a medium; lengths in 1/σt′.

Along u(q) and v(r) = ln(1 + r/R_ZERO) tables hold coefficients of cubic B-splines on uniform cells: n + 3 of them for
n cells. Coefficient k weighs the spline that is centred on knot k − 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bssrdf.transport.discrete_ordinates import decay_constants

Floats = NDArray[np.float64]

Q_ZERO = 0.05
Q_MAX = 0.98**0.5
"""α′ = 0.02."""
N_Q = 32
R_ZERO = 0.02
R_MAX = 200.0


def u_of(q: Floats | float) -> Floats:
    """The coordinate ln(1 + q/Q_ZERO) − ½ ln α′, along which light varies evenly."""
    return np.log1p(q / Q_ZERO) - np.log1p(-q * q) / 2


U_MAX = float(u_of(Q_MAX))
V_MAX = float(np.log1p(R_MAX / R_ZERO))
N_U_CELLS = N_Q - 1
N_V_CELLS = 46
N_U_COARSE = 10
N_V_COARSE = 20
RHO_ZERO = 0.02
RHO_MAX = 100.0
"""[1/σt] Light scattered once is tabulated over ln(1 + ρ/RHO_ZERO); beyond, it is below e^−200 of all."""
W_MAX = float(np.log1p(RHO_MAX / RHO_ZERO))
N_W_CELLS = 96


def q_nodes() -> Floats:
    """The N_Q knots of q, from 0 to Q_MAX, uniform in u."""
    fine = Q_MAX * np.linspace(0, 1, 2001)
    u = np.linspace(0, U_MAX, N_Q)
    q = np.interp(u, u_of(fine), fine)
    for _ in range(6):  # Newton
        q -= (u_of(q) - u) / (1 / (Q_ZERO + q) + q / (1 - q * q))
    return np.clip(q, 0, Q_MAX)


def albedo_of(q: Floats, g: float) -> Floats:
    """Single-scattering albedo σs/σt."""
    reduced = (1 - q) * (1 + q)
    return reduced / (reduced + q * q * (1 - g))


def kappa_reduced(q: Floats, g: float) -> Floats:
    """Exact decay constant κ of light far from its source, in σt′."""
    albedo = albedo_of(q, g)
    return decay_constants(albedo, g) / (1 - albedo * g)


def log_decay(kappa_r: Floats) -> Floats:
    """ln((1 + κ r) e^(−κ r)), the diffusing light's own decay."""
    return np.log1p(kappa_r) - kappa_r


def cubic_weights(x: Floats, x_max: float, n_cells: int) -> tuple[NDArray[np.int64], Floats]:
    """The first of the four B-splines that are not 0 at each x, and their values there, shape (n, 4)."""
    t = np.clip(x, 0, x_max) * (n_cells / x_max)
    cell = np.minimum(t.astype(np.int64), n_cells - 1)
    f = t - cell
    e = 1 - f
    return cell, np.stack([e**3 / 6, 2 / 3 - f * f * (1 - f / 2), 2 / 3 - e * e * (1 - e / 2), f**3 / 6], axis=-1)


def basis(x: Floats, x_max: float, n_cells: int) -> Floats:
    """The B-splines' values, shape (n, n_cells + 3)."""
    cell, weights = cubic_weights(x, x_max, n_cells)
    values = np.zeros((x.size, n_cells + 3))
    np.put_along_axis(values, cell[:, None] + np.arange(4), weights, axis=1)
    return values


def interpolating(values: Floats, *, even: bool = False) -> Floats:
    """Coefficients of the spline through `values` (n_cells + 1, …) at the knots, not-a-knot at its ends.

    `even`: with zero slope at 0 instead.
    """
    n_cells = values.shape[0] - 1
    through = basis(np.arange(n_cells + 1.0), float(n_cells), n_cells)
    fourth = np.diff(np.eye(n_cells + 3), 4, axis=0)
    start = fourth[0]
    if even:
        start = np.zeros(n_cells + 3)
        start[0], start[2] = 1, -1
    matrix = np.vstack([start, through, fourth[-1]])
    zero = np.zeros((1, *values.shape[1:]))
    coefficients = np.linalg.solve(matrix, np.concatenate([zero, values, zero]))
    if even:
        coefficients[0] = coefficients[2]
    return coefficients


def by_cell(coefficients: Floats) -> Floats:
    """The same spline along the last axis as a cubic in each cell: (…, n + 3) to (…, 4 powers, n)."""
    a, b, c, d = (coefficients[..., k : coefficients.shape[-1] - 3 + k] for k in range(4))
    return np.stack([(a + 4 * b + c) / 6, (c - a) / 2, (a - 2 * b + c) / 2, (d - 3 * c + 3 * b - a) / 6], axis=-2)
