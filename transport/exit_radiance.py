"""Radiance at a camera angle from binned exit directions. Dimensionless; angles enter as cosines outside, `mu`.

A radiance factor is π L(mu)/M: 1 at every angle for a Lambertian surface. Just below the surface radiance is smooth in
the direction, so its mean over all azimuths is Fresnel's transmittance times a low polynomial in the cosine inside.

Away from the beam light still runs outwards, so that it is not the same at every azimuth about the normal: a camera
whose plane of view stands at a right angle to the radius sees less than the mean. The difference vanishes at the normal
as the square of the sine inside, times a polynomial again. Light scattered once runs exactly along the radius.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

N_MU = 20
"""Bins of exit direction, uniform in mu², so that Lambertian light fills them equally."""
DEGREE = 4
DEGREE_ACROSS = 2
MAX_ANGLE_DEG = 80.0

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def transmittance(eta: float, mu: Floats) -> Floats:
    """Ft at the outside cosine `mu`, for eta ≥ 1."""
    inside = np.sqrt(eta * eta - 1 + mu * mu)
    r_s = (mu - inside) / (mu + inside)
    r_p = (eta * eta * mu - inside) / (eta * eta * mu + inside)
    return 1 - (r_s**2 + r_p**2) / 2


@functools.lru_cache(maxsize=64)
def boundary_a(eta: float) -> float:
    """A = (1 + Fdr)/(1 − Fdr) for eta ≥ 1, from inside: 1 − Fdr = C/eta², C = 2∫₀¹ Ft μ dμ of light from outside."""
    nodes, weights = np.polynomial.legendre.leggauss(32)
    u, du = (1 + nodes) / 2, weights / 2
    entering = float(6 * du @ (u**5 * transmittance(eta, u**3)))  # μ = u³: nodes crowd where eta near 1 has a layer
    return 2 * eta**2 / entering - 1


def shape_basis(eta: float, mu: Floats) -> Floats:
    """Ft times Legendre polynomials of the cosine inside, over its range; shape (…, DEGREE + 1)."""
    return transmittance(eta, mu)[..., None] * _polynomials(eta, mu, DEGREE)


def across_basis(eta: float, mu: Floats) -> Floats:
    """The same for what an azimuth at a right angle to the radius adds; shape (…, DEGREE_ACROSS + 1)."""
    square_of_sine = (1 - mu * mu) / eta**2
    return (transmittance(eta, mu) * square_of_sine)[..., None] * _polynomials(eta, mu, DEGREE_ACROSS)


def _polynomials(eta: float, mu: Floats, degree: int) -> Floats:
    """Legendre's, of the cosine inside: −1 for light that leaves along the surface, 1 along the normal."""
    grazing = np.sqrt(1 - 1 / eta**2)
    inside = np.sqrt(1 - (1 - mu * mu) / eta**2)
    centred = (2 * inside - 1 - grazing) / (1 - grazing)
    return np.polynomial.legendre.legvander(centred, degree).reshape(*np.shape(mu), degree + 1)


@functools.cache
def share_to_coefficients(eta: float, *, across: bool = False) -> Floats:
    """Least squares from the shares of the bins to either basis, shape (degree + 1, N_MU), errors as of counts."""
    square = (np.arange(N_MU)[:, None] + (1 + _NODES) / 2) / N_MU
    mu = np.sqrt(square)
    expected = np.einsum("bq,q->b", transmittance(eta, mu), _WEIGHTS)[:, None]
    mean = np.einsum("bqk,q->bk", (across_basis if across else shape_basis)(eta, mu), _WEIGHTS / 2)
    scale = 1 / np.sqrt(expected / expected.sum())
    return np.linalg.pinv(mean * scale / N_MU) * scale.T


def angle_weights(eta: float, mu: float) -> Floats:
    """Weights, shape (N_MU,), whose sum with the shares of the bins is the radiance factor at `mu`.

    The shares are those of all light that leaves: they add up to 1.
    """
    return shape_basis(eta, np.asarray(mu, dtype=float)) @ share_to_coefficients(eta)
