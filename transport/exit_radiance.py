"""Radiance at a camera angle from binned exit directions. Dimensionless; angles enter as cosines outside, `mu`.

A radiance factor is π L(mu)/M: 1 at every angle for a Lambertian surface. Just below the surface radiance is smooth in
the direction, so the factor is Fresnel's transmittance times a low polynomial in the cosine inside.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

N_MU = 20
"""Bins of exit direction, uniform in mu², so that Lambertian light fills them equally."""
DEGREE = 3
MAX_ANGLE_DEG = 80.0

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def transmittance(eta: float, mu: Floats) -> Floats:
    """Ft at the outside cosine `mu`, for eta ≥ 1."""
    inside = np.sqrt(eta * eta - 1 + mu * mu)
    r_s = (mu - inside) / (mu + inside)
    r_p = (eta * eta * mu - inside) / (eta * eta * mu + inside)
    return 1 - (r_s**2 + r_p**2) / 2


def shape_basis(eta: float, mu: Floats) -> Floats:
    """Ft times powers of the cosine inside, about the middle of its range; shape (…, DEGREE + 1)."""
    grazing = np.sqrt(1 - 1 / eta**2)
    inside = np.sqrt(1 - (1 - mu * mu) / eta**2)
    centred = (2 * inside - 1 - grazing) / (1 - grazing)
    return transmittance(eta, mu)[..., None] * centred[..., None] ** np.arange(DEGREE + 1)


@functools.cache
def share_to_coefficients(eta: float) -> Floats:
    """Least squares from the shares of the bins to the polynomial, shape (DEGREE + 1, N_MU), errors as of counts."""
    square = (np.arange(N_MU)[:, None] + (1 + _NODES) / 2) / N_MU
    mean = np.einsum("bqk,q->bk", shape_basis(eta, np.sqrt(square)), _WEIGHTS / 2)
    expected = mean[:, :1] / mean[:, 0].sum()
    scale = 1 / np.sqrt(expected)
    return np.linalg.pinv(mean * scale / N_MU) * scale.T


def angle_weights(eta: float, mu: float) -> Floats:
    """Weights, shape (N_MU,), whose sum with the shares of the bins is the radiance factor at `mu`.

    The shares are those of all light that leaves: they add up to 1.
    """
    return shape_basis(eta, np.asarray(mu, dtype=float)) @ share_to_coefficients(eta)
