"""Laws of the smooth dielectric surface."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from bssrdf.transport import exit_radiance, fresnel

ETAS = (0.7, 1.0001, 1.01, 1.1, 1.3, 1.5, 2.0, 3.0)


@pytest.fixture(autouse=True, scope="module")
def double() -> Iterator[None]:
    with jax.enable_x64(True), jax.numpy_rank_promotion("raise"):
        yield


def literal_reflectance(n_from: float, n_to: float, cos_i: float) -> float:
    """Fresnel's equations by Snell's law, as in a textbook."""
    sin_t = n_from / n_to * np.sqrt(1 - cos_i**2)
    if sin_t >= 1:
        return 1.0
    cos_t = np.sqrt(1 - sin_t**2)
    r_s = (n_from * cos_i - n_to * cos_t) / (n_from * cos_i + n_to * cos_t)
    r_p = (n_to * cos_i - n_from * cos_t) / (n_to * cos_i + n_from * cos_t)
    return (r_s**2 + r_p**2) / 2


def literal_average(n_from: float, n_to: float) -> float:
    """2∫Fr μ dμ, split at the critical angle, with μ = μc + s² against the root there."""
    critical = np.sqrt(max(0.0, 1 - (n_to / n_from) ** 2))

    def integrand(s: float) -> float:
        mu = critical + s * s
        return literal_reflectance(n_from, n_to, min(mu, 1.0)) * 2 * mu * 2 * s

    return critical**2 + quad(integrand, 0, np.sqrt(1 - critical), epsabs=1e-13, epsrel=1e-13, limit=400)[0]


@given(eta=st.floats(0.5, 4), cos_i=st.floats(1e-3, 1))
@settings(max_examples=50, deadline=None)
def test_both_sides_follow_fresnels_equations(eta: float, cos_i: float) -> None:
    assert fresnel.fresnel_r(eta, cos_i) == pytest.approx(literal_reflectance(1, eta, cos_i), abs=1e-7)
    assert fresnel.fresnel_r_inside(eta, cos_i) == pytest.approx(literal_reflectance(eta, 1, cos_i), abs=1e-7)


@pytest.mark.parametrize("eta", [1.1, 1.3, 1.5, 2.0])
def test_transmittance_is_the_same_both_ways(eta: float) -> None:
    cos_outside = jnp.linspace(0.01, 1, 50)
    cos_inside = jnp.sqrt(1 - (1 - cos_outside**2) / eta**2)
    np.testing.assert_allclose(
        fresnel.fresnel_t(eta, cos_outside), 1 - fresnel.fresnel_r_inside(eta, cos_inside), atol=1e-12
    )


def test_reflectance_at_its_limits() -> None:
    assert fresnel.fresnel_r(1.5, 1.0) == pytest.approx(0.04, abs=1e-15)
    assert fresnel.fresnel_r(1.5, 0.0) == 1
    assert fresnel.fresnel_r_inside(1.5, 0.7) == 1
    assert np.all(fresnel.fresnel_r(1.0, jnp.linspace(0, 1, 11)) == 0)


@pytest.mark.parametrize("eta", ETAS)
def test_averages_agree_with_adaptive_quadrature(eta: float) -> None:
    assert fresnel.fdr_exact(eta) == pytest.approx(literal_average(eta, 1), abs=1e-10)
    assert fresnel.exit_norm(eta) == pytest.approx(1 - literal_average(1, eta), abs=1e-10)


@pytest.mark.parametrize("eta", [1.01, 1.1, 1.3, 1.5, 1.7, 2.0])
def test_polynomial_is_good_to_its_stated_error(eta: float) -> None:
    assert fresnel.fdr(eta) == pytest.approx(-1.440 / eta**2 + 0.710 / eta + 0.668 + 0.0636 * eta, rel=1e-15)
    assert fresnel.fdr(eta) == pytest.approx(float(fresnel.fdr_exact(eta)), abs=0.002)


def test_a_leaves_the_polynomial_where_it_does_not_hold() -> None:
    assert fresnel.boundary_a(1.0) == 1
    assert fresnel.boundary_a(3.0) == pytest.approx(23.9, abs=0.05)
    assert fresnel.boundary_a(0.7) == fresnel.boundary_a(0.7, exact=True)
    assert fresnel.boundary_a(1.3) != fresnel.boundary_a(1.3, exact=True)
    assert fresnel.boundary_a(1.3) == pytest.approx(float(fresnel.boundary_a(1.3, exact=True)), rel=0.01)


@pytest.mark.parametrize("x64", [True, False])
def test_gradients_are_finite_at_grazing_critical_and_matched(x64: bool) -> None:
    critical = float(np.sqrt(1 - 1 / 1.5**2))
    with jax.enable_x64(x64):
        for f in (fresnel.fresnel_r, fresnel.fresnel_r_inside):
            slope = jax.jit(jax.grad(f, (0, 1)))
            for eta, cos_i in ((1.5, 0.0), (1.5, critical), (1.0, 0.0), (1.0, 1.0), (0.7, 0.0)):
                assert np.all(np.isfinite(slope(eta, cos_i))), (f, eta, cos_i)
        for g in (fresnel.boundary_a, fresnel.exit_norm):
            assert np.all(np.isfinite(jax.jit(jax.vmap(jax.grad(g)))(jnp.array([0.5, 1.0, 1.3, 2.0, 3.0]))))


def test_arrays_and_single_precision_agree_with_scalars() -> None:
    etas = jnp.array([[0.8, 1.0, 1.3], [1.5, 2.0, 3.0]])
    one_by_one = [float(fresnel.boundary_a(float(eta))) for eta in etas.ravel()]
    np.testing.assert_allclose(jax.jit(fresnel.boundary_a)(etas).ravel(), one_by_one, rtol=1e-12)
    single = fresnel.boundary_a(etas.astype(jnp.float32))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single.ravel(), one_by_one, rtol=1e-5)


@pytest.mark.parametrize("eta", [1.0, 1.001, 1.33, 1.5, 2.0])
def test_the_boundary_by_reciprocity_is_that_of_the_average_from_inside(eta):
    assert exit_radiance.boundary_a(eta) == pytest.approx(float(fresnel.boundary_a(eta, exact=True)), rel=1e-6)
