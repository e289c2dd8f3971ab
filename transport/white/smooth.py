"""From white samples to a smooth table: penalised splines of the light scattered twice or more.

With lengths in 1/σt′, q = √(1 − α′) and v = ln(1 + r/R_ZERO) the table holds S(u, v), u of `u_of`, in

    R_multiple(r) = σt′² α′² e^S (1 + κ r) e^(−κ r)

where κ is the exact decay constant. What is left in S varies slowly, so that cubic splines on uniform knots hold it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from bssrdf.transport.exit_radiance import share_to_coefficients
from bssrdf.transport.white.grid import (
    N_Q,
    N_U_CELLS,
    N_U_COARSE,
    N_V_CELLS,
    N_V_COARSE,
    R_MAX,
    R_ZERO,
    U_MAX,
    V_MAX,
    cubic_weights,
    kappa_reduced,
    log_decay,
    q_nodes,
    u_of,
)
from bssrdf.transport.white.samples import N_R, WhiteSamples, radius_of_bin_edges
from bssrdf.transport.white.walk import COARSE

Floats = NDArray[np.float64]

ROUGHNESS_V = 0.005
"""Expected third differences of the coefficients of S along v."""
ROUGHNESS_U = 0.3
Q2_LEAST = 0.003
"""Along u they are expected to be ROUGHNESS_U (q² + Q2_LEAST): S is a series in q² and q³."""
BENDING_V = 0.5
"""Expected second differences along v: where there is no light to sample, S goes on as a power of r."""
ANGLE_ROUGHNESS, ACROSS_ROUGHNESS = 0.02, 0.1
"""Expected second differences of the coefficients of exit radiance: over all azimuths, and across, where they fall from
1 to 0.1 within a few cells. At 0.02 light across the view came out 1 to 4 % off at g 0.8 (tests/test_exit_azimuth.py);
from 0.05 to 0.2 it hardly changes."""
MAX_RELATIVE_ERROR = 0.5
"""Bins that are worse than this say nothing to the logarithm."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


class FittedTable(NamedTuple):
    """One (η, g): coefficients of cubic B-splines on uniform knots over [0, U_MAX] × [0, V_MAX]."""

    log_curve: Floats
    """(N_U_CELLS + 3, N_V_CELLS + 3): S."""
    log_curve_sd: Floats
    """(N_Q, N_V_CELLS + 1): standard error of S, relative error of the curve, at the knots."""
    angles: Floats
    """(N_U_COARSE + 3, N_V_COARSE + 3, DEGREE + DEGREE_ACROSS + 2): shape of its exit radiance over all azimuths, and
    what one at a right angle to the radius adds, see `exit_radiance`."""
    chi2: float
    """Mean square of the residuals of the bins in their standard errors."""


def fit_tables(samples: WhiteSamples) -> list[FittedTable]:
    """One table for each of the samples' indices."""
    return [_fit(samples, e) for e in range(samples.etas.size)]


def _fit(samples: WhiteSamples, e: int) -> FittedTable:
    q = q_nodes()
    edges = radius_of_bin_edges(q, samples.g)
    mean = samples.curve[e, :, :-1] / (np.pi * np.diff(edges**2)) / ((1 - q) * (1 + q))[:, None] ** 2
    relative = _smooth_error(samples.curve_se[e, :, :-1], samples.curve[e, :, :-1])
    usable = (relative < MAX_RELATIVE_ERROR) & (edges[:, 1:] < R_MAX)
    rows, bins = np.nonzero(usable)
    lo, hi = edges[rows, bins], edges[rows, bins + 1]
    radii = lo[:, None] + (hi - lo)[:, None] * (1 + _NODES) / 2
    known = log_decay(kappa_reduced(q, samples.g)[rows][:, None] * radii) + np.log(radii * _WEIGHTS)
    along_u = _sparse_basis(u_of(q)[rows], U_MAX, N_U_CELLS)
    along_v = [_sparse_basis(np.log1p(r / R_ZERO), V_MAX, N_V_CELLS) for r in radii.T]
    at_radii = [_row_kron(along_u, b) for b in along_v]
    target = np.log(mean[rows, bins] * (hi**2 - lo**2) / (hi - lo))
    weight = 1 / relative[rows, bins]
    penalty = _penalty()
    coefficients = np.zeros(along_u.shape[1] * along_v[0].shape[1])
    for _ in range(4):
        log_parts = np.stack([m @ coefficients for m in at_radii], axis=1) + known
        model = np.logaddexp.reduce(log_parts, axis=1)
        parts = np.exp(log_parts - model[:, None])
        design = sum(m.multiply(parts[:, i : i + 1]) for i, m in enumerate(at_radii))
        weighted = sparse.csr_array(design).multiply(weight[:, None]).tocsr()
        normal = (weighted.T @ weighted).toarray() + penalty
        residual = target - model + design @ coefficients
        factor = cho_factor(normal)
        coefficients = cho_solve(factor, weighted.T @ (weight * residual))
    chi2 = float(np.mean((weight * (residual - design @ coefficients)) ** 2))
    shape = (N_U_CELLS + 3, N_V_CELLS + 3)
    knots = _row_kron(
        _sparse_basis(np.repeat(u_of(q), N_V_CELLS + 1), U_MAX, N_U_CELLS),
        _sparse_basis(np.tile(np.linspace(0, V_MAX, N_V_CELLS + 1), N_Q), V_MAX, N_V_CELLS),
    )
    variance = np.einsum("ij,ji->i", knots @ np.eye(knots.shape[1]), cho_solve(factor, knots.T.toarray()))
    sd = np.sqrt(variance).reshape(N_Q, N_V_CELLS + 1)
    log_curve = coefficients.reshape(shape)
    log_curve[0] = log_curve[2]
    return FittedTable(log_curve, sd, _fit_angles(samples, e, edges), chi2)


def _smooth_error(se: Floats, value: Floats) -> Floats:
    """Relative errors by bin, their own noise smoothed over neighbouring bins; infinite where no light came."""
    relative = np.where(value > 0, se / np.where(value > 0, value, 1), np.inf)
    padded = np.pad(relative, ((0, 0), (2, 2)), mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=1)
    return np.maximum(relative, np.median(around, axis=-1))


def _sparse_basis(x: Floats, x_max: float, n_cells: int) -> sparse.csr_array:
    """The B-splines' values at x, shape (n, n_cells + 3), four a row."""
    cell, weights = cubic_weights(x, x_max, n_cells)
    columns = cell[:, None] + np.arange(4)
    return sparse.csr_array((weights.ravel(), columns.ravel(), np.arange(0, 4 * x.size + 1, 4)), (x.size, n_cells + 3))


def _row_kron(a: sparse.csr_array, b: sparse.csr_array) -> sparse.csr_array:
    """Rows of a ⊗ rows of b, for factors of four entries a row."""
    n = a.shape[0]
    columns = a.indices.reshape(n, 4, 1) * b.shape[1] + b.indices.reshape(n, 1, 4)
    values = a.data.reshape(n, 4, 1) * b.data.reshape(n, 1, 4)
    pointers = np.arange(0, 16 * n + 1, 16)
    return sparse.csr_array((values.ravel(), columns.ravel(), pointers), shape=(n, a.shape[1] * b.shape[1]))


def _penalty() -> Floats:
    """Prior precision of the coefficients of S: smooth along both axes, and even about u = 0.

    ln R_d at fixed r has no term linear in q: the path lengths there have a finite mean.
    """
    n_u, n_v = N_U_CELLS + 3, N_V_CELLS + 3
    third_u = np.diff(np.eye(n_u), 3, axis=0) / (ROUGHNESS_U * (q_nodes()[:, None] ** 2 + Q2_LEAST))[1:]
    third_v = np.diff(np.eye(n_v), 3, axis=0) / ROUGHNESS_V
    second_v = np.diff(np.eye(n_v), 2, axis=0) / BENDING_V
    even = np.zeros((1, n_u))
    even[0, 0], even[0, 2] = 1e5, -1e5
    across_u = third_u.T @ third_u + even.T @ even
    across_v = third_v.T @ third_v + second_v.T @ second_v
    return np.kron(across_u, np.eye(n_v)) + np.kron(np.eye(n_u), across_v)


def _fit_angles(samples: WhiteSamples, e: int, edges: Floats) -> Floats:
    """Coefficients of the exit radiance on the coarse grid, smoothed."""
    eta = float(samples.etas[e])
    flux = samples.angles[e].sum(-1)
    over = np.where(flux > 0, flux, 1)[..., None]
    middle = np.sqrt(edges[:, :-1:COARSE] * edges[:, COARSE::COARSE] + R_ZERO**2)
    all_azimuths = _smooth_coefficients(
        samples.angles[e] / over,
        samples.angles_se[e] / over,
        share_to_coefficients(eta),
        flux > 0,
        middle,
        ANGLE_ROUGHNESS,
    )
    across = _smooth_coefficients(
        samples.across[e] / over,
        samples.across_se[e] / over,
        share_to_coefficients(eta, across=True),
        flux > 0,
        middle,
        ACROSS_ROUGHNESS,
    )
    return np.concatenate([all_azimuths, across], axis=-1)


def _smooth_coefficients(
    share: Floats, error: Floats, to_coefficients: Floats, lit: NDArray[np.bool_], middle: Floats, roughness: float
) -> Floats:
    """Splines through the coefficients of each bin, shape (N_U_COARSE + 3, N_V_COARSE + 3, n_coefficients)."""
    values = share @ to_coefficients.T
    errors = np.sqrt(error**2 @ (to_coefficients.T**2))
    rows, bins = np.nonzero(lit & (errors[..., 0] < MAX_RELATIVE_ERROR))
    design = _row_kron(
        _sparse_basis(u_of(q_nodes())[rows], U_MAX, N_U_COARSE),
        _sparse_basis(np.log1p(middle[rows, bins] / R_ZERO), V_MAX, N_V_COARSE),
    )
    n_u, n_v = N_U_COARSE + 3, N_V_COARSE + 3
    second_u, second_v = np.diff(np.eye(n_u), 2, axis=0), np.diff(np.eye(n_v), 2, axis=0)
    rough = np.kron(second_u.T @ second_u, np.eye(n_v)) + np.kron(np.eye(n_u), second_v.T @ second_v)
    out = np.empty((n_u, n_v, to_coefficients.shape[0]))
    for k in range(out.shape[-1]):
        weight = 1 / np.maximum(errors[rows, bins, k], 1e-4)
        weighted = design.multiply(weight[:, None]).tocsr()
        normal = (weighted.T @ weighted).toarray() + rough / roughness**2
        out[..., k] = np.linalg.solve(normal, weighted.T @ (weight * values[rows, bins, k])).reshape(n_u, n_v)
    return out


assert N_R % COARSE == 0
