"""Laws of the BRDF and of the BSSRDF that it comes from."""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.typing import NDArray

from bssrdf.transport import bssrdf as model
from bssrdf.transport.bssrdf import s_d
from bssrdf.transport.dipole import Medium, rd, total_r
from bssrdf.transport.fresnel import exit_norm, fresnel_t
from bssrdf.transport.single import first_order_total

SKIN = Medium(0.17, 0.88, 1.3)
MARBLE = Medium(0.0041, 2.62, 1.5)
NORMAL = np.array([0.0, 0.0, 1.0])


@pytest.fixture(autouse=True, scope="module")
def double() -> Iterator[None]:
    with jax.enable_x64(True), jax.numpy_rank_promotion("raise"):
        yield


def hemisphere(n_theta: int = 80, n_phi: int = 64) -> tuple[jax.Array, jax.Array]:
    """Directions (n, 3) and projected solid angles (n,): Gauss in √cos θ, even steps in φ."""
    nodes, weights = np.polynomial.legendre.leggauss(n_theta)
    u = (1 + nodes) / 2
    mu, phi = np.meshgrid(u**2, 2 * np.pi * np.arange(n_phi) / n_phi, indexing="ij")
    sine = np.sqrt(1 - mu**2)
    projected = np.repeat(u**2 * u * weights * 2 * np.pi / n_phi, n_phi)
    return jnp.stack([sine * np.cos(phi), sine * np.sin(phi), mu], axis=-1).reshape(-1, 3), jnp.asarray(projected)


def albedo(f: Callable[[jax.Array, jax.Array], jax.Array], w_i: jax.Array | NDArray[np.float64]) -> float:
    w_o, projected = hemisphere()
    return float(jnp.sum(f(jnp.broadcast_to(w_i, w_o.shape), w_o) * projected))


@pytest.mark.parametrize(("medium", "g"), [(SKIN, 0.0), (SKIN, 0.8), (MARBLE, 0.3)])
def test_single_term_returns_the_first_order_flux(medium: Medium, g: float) -> None:
    sigma_s = medium.sigma_sp / (1 - g)
    entered = float(fresnel_t(medium.eta, 1.0))
    expected = entered * float(first_order_total(sigma_s, medium.sigma_a, g, medium.eta))
    found = albedo(lambda w_i, w_o: model.brdf_single(medium, g, w_i, w_o), NORMAL)
    assert found == pytest.approx(expected, rel=1e-8)
    printed = albedo(lambda w_i, w_o: model.brdf_single(medium, g, w_i, w_o, paper=True), NORMAL)
    assert printed == pytest.approx(medium.eta**2 * expected, rel=1e-8)


@pytest.mark.parametrize("medium", [SKIN, MARBLE])
@pytest.mark.parametrize("cos_i", [1.0, 0.5, 0.1])
def test_diffuse_term_returns_the_total_of_what_entered(medium: Medium, cos_i: float) -> None:
    w_i = jnp.array([np.sqrt(1 - cos_i**2), 0.0, cos_i])
    expected = float(fresnel_t(medium.eta, cos_i) * total_r(medium))
    assert albedo(lambda a, b: model.brdf_diffuse(medium, a, b), w_i) == pytest.approx(expected, rel=1e-8)
    printed = albedo(lambda a, b: model.brdf_diffuse(medium, a, b, paper=True), w_i)
    assert printed == pytest.approx(expected * float(exit_norm(medium.eta)), rel=1e-8)


def test_diffuse_term_is_the_bssrdf_over_the_surface() -> None:
    w_i, w_o = jnp.array([0.6, 0.0, 0.8]), jnp.array([0.0, 0.8, 0.6])
    for paper in (False, True):
        t, dt = np.linspace(-12, 7, 4001, retstep=True)
        r = np.exp(t)
        over_surface = np.sum(2 * np.pi * r**2 * np.asarray(s_d(SKIN, r, 0.8, 0.6, paper=paper))) * dt
        assert model.brdf_diffuse(SKIN, w_i, w_o, paper=paper) == pytest.approx(over_surface, rel=1e-6)


def test_bssrdf_returns_the_exitant_light_of_what_entered() -> None:
    mu, weights = np.polynomial.legendre.leggauss(60)
    mu, weights = (1 + mu) / 2, weights / 2
    leaving = np.sum(2 * np.pi * mu * weights * np.asarray(s_d(MARBLE, 1.0, 0.7, mu)))
    assert leaving == pytest.approx(float(fresnel_t(1.5, 0.7) * rd(MARBLE, 1.0)), rel=1e-8)
    printed = np.asarray(s_d(MARBLE, 1.0, 0.7, mu, paper=True))
    expected = np.asarray(fresnel_t(1.5, 0.7) * rd(MARBLE, 1.0) * fresnel_t(1.5, mu) / np.pi)
    np.testing.assert_allclose(printed, expected, rtol=1e-13)


@pytest.mark.parametrize("paper", [False, True])
def test_light_may_go_either_way(paper: bool) -> None:
    w, _ = hemisphere(8, 6)
    forth = model.brdf(SKIN, 0.5, w, w[::-1], paper=paper)
    back = model.brdf(SKIN, 0.5, w[::-1], w, paper=paper)
    assert np.ptp(np.asarray(forth)) > 0.01
    np.testing.assert_allclose(forth, back, rtol=1e-12)


def test_the_whole_is_the_sum_and_0_below_the_surface() -> None:
    w_i, w_o = jnp.array([[0.6, 0.0, 0.8]]), jnp.array([[0.0, 0.8, 0.6]])
    parts = model.brdf_single(SKIN, 0.5, w_i, w_o) + model.brdf_diffuse(SKIN, w_i, w_o)
    assert model.brdf(SKIN, 0.5, w_i, w_o) == parts
    assert model.brdf(SKIN, 0.5, -w_i, w_o) == 0
    assert model.brdf(SKIN, 0.5, w_i, -w_o) == 0
