"""Laws of the elementary steps of a photon: flight, scattering, and the surface as both other texts have it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from numba import njit

from bssrdf.transport import exit_radiance, fresnel
from bssrdf.transport.light import transmittance
from bssrdf.transport.photon import free_path, reflectance_inside, scatter, scattering_cosine, stream_states

N = 400_000


@njit
def paths(state: np.ndarray, n: int) -> np.ndarray:
    return np.array([free_path(state) for _ in range(n)])


@njit
def cosines(state: np.ndarray, g: float, n: int) -> np.ndarray:
    return np.array([scattering_cosine(state, g) for _ in range(n)])


@njit
def turned(state: np.ndarray, g: float, ux: float, uy: float, uz: float, n: int) -> np.ndarray:
    out = np.empty((n, 3))
    for i in range(n):
        out[i] = scatter(state, g, ux, uy, uz)
    return out


def mean_is(values: np.ndarray, expected: float) -> bool:
    return bool(abs(values.mean() - expected) < 4 * values.std() / np.sqrt(values.size))


def test_paths_between_collisions_fall_off_exponentially() -> None:
    drawn = paths(stream_states(1, 1)[0], N)
    for moment, expected in ((1, 1.0), (2, 2.0), (3, 6.0)):
        assert mean_is(drawn**moment, expected)
    assert mean_is((drawn > 9).astype(float), np.exp(-9))


@pytest.mark.parametrize("g", [-0.3, 0.0, 5e-5, 0.5, 0.9])
def test_henyey_and_greenstein_s_moments_are_powers_of_g(g: float) -> None:
    mu = cosines(stream_states(2, 1)[0], g, N)
    for order in (1, 2, 3):
        polynomial = np.polynomial.legendre.Legendre.basis(order)(mu)
        assert mean_is(polynomial, g**order)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.6, 0.0, -0.8), (0.48, 0.64, 0.6), (1.0, 0.0, 0.0)])
def test_scattering_turns_about_the_old_direction_evenly(direction: tuple[float, float, float]) -> None:
    new = turned(stream_states(3, 1)[0], 0.7, *direction, N // 4)
    np.testing.assert_allclose(np.linalg.norm(new, axis=1), 1, rtol=1e-12)
    along = new @ np.array(direction)
    assert mean_is(along, 0.7)
    across = new - along[:, None] * direction
    for component in across.T:
        assert abs(component.mean()) < 4 * component.std() / np.sqrt(len(new)) + 1e-12


@pytest.mark.parametrize("eta", [1.0, 1.3, 1.5, 2.6])
def test_fresnel_is_one_law_in_jax_numpy_and_numba(eta: float, x64: None) -> None:
    outside = np.linspace(0.01, 1, 40)
    inside = np.sqrt(1 - (1 - outside**2) / eta**2)
    compiled = np.array([reflectance_inside(eta, mu) for mu in inside])
    expected = 1 - np.asarray(fresnel.fresnel_t(eta, jnp.asarray(outside)))
    np.testing.assert_allclose(compiled[:, 1], outside, rtol=1e-9)
    for found in (compiled[:, 0], 1 - transmittance(np, eta, outside), 1 - exit_radiance.transmittance(eta, outside)):
        np.testing.assert_allclose(found, expected, atol=1e-11)
    if eta > 1:
        total = 0.999 * np.sqrt(1 - 1 / eta**2)
        assert reflectance_inside(eta, total) == (1.0, 0.0)
        assert fresnel.fresnel_r_inside(eta, total) == 1
