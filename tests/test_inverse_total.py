"""Laws of the inverse of the total reflectance."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bssrdf.transport.dipole import total_r_of_ratio
from bssrdf.transport.fresnel import boundary_a
from bssrdf.transport.inverse_total import absorption_ratio, albedo_p

ETAS = (1.0, 1.3, 1.5, 3.0)
SLOPE = jax.jit(jax.grad(absorption_ratio, (0, 1)))
FORWARD = jax.jit(jax.jacfwd(absorption_ratio))
CURVATURE = jax.jit(jax.grad(jax.grad(absorption_ratio)))


@pytest.fixture(autouse=True, scope="module")
def double() -> Iterator[None]:
    with jax.enable_x64(True), jax.numpy_rank_promotion("raise"):
        yield


@given(total_r=st.floats(1e-3, 1 - 1e-12), eta=st.floats(0.8, 3))
@settings(max_examples=100, deadline=None)
def test_the_total_of_the_inverse_is_what_was_asked(total_r: float, eta: float) -> None:
    assert 1 - total_r_of_ratio(absorption_ratio(total_r, eta), eta) == pytest.approx(1 - total_r, rel=1e-13, abs=4e-16)


@pytest.mark.parametrize("eta", ETAS)
def test_the_inverse_of_the_total_is_the_ratio(eta: float) -> None:
    ratio = jnp.geomspace(1e-8, 0.99, 60)
    np.testing.assert_allclose(absorption_ratio(total_r_of_ratio(ratio, eta), eta), ratio, rtol=1e-10)


@pytest.mark.parametrize("eta", ETAS)
def test_just_below_1_all_digits_of_r_are_used(eta: float) -> None:
    a = float(boundary_a(eta))
    for total_r in (1 - 1e-12, 1 - 2.0**-53):
        expected = ((1 - total_r) / (1 + 2 / 3 * a)) ** 2 / 3
        assert absorption_ratio(total_r, eta) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("eta", ETAS)
def test_near_0_the_albedo_is_proportional_to_r(eta: float) -> None:
    k = 4 / 3 * float(boundary_a(eta))
    for total_r in (1e-12, 1e-100, 1e-300):
        expected = 2 * total_r * np.exp(np.sqrt(3)) / (1 + np.exp(-k * np.sqrt(3)))
        assert albedo_p(total_r, eta) == pytest.approx(expected, rel=1e-9)


def test_out_of_range_is_the_nearest_end_and_nan_stays() -> None:
    total_r = jnp.array([1.0, 1.05, 0.0, -0.1, jnp.nan])
    np.testing.assert_array_equal(absorption_ratio(total_r, 1.3), [0, 0, 1, 1, np.nan])
    np.testing.assert_array_equal(albedo_p(total_r, 1.3), [1, 1, 0, 0, np.nan])


@pytest.mark.parametrize(("total_r", "eta"), [(0.05, 1.3), (0.5, 1.5), (0.9, 0.8), (0.999, 1.3)])
def test_derivatives_agree_with_finite_differences(total_r: float, eta: float) -> None:
    h = 1e-5 * (1 - total_r)
    by_r = (absorption_ratio(total_r + h, eta) - absorption_ratio(total_r - h, eta)) / (2 * h)
    by_eta = (absorption_ratio(total_r, eta + 1e-5) - absorption_ratio(total_r, eta - 1e-5)) / 2e-5
    np.testing.assert_allclose(SLOPE(total_r, eta), (by_r, by_eta), rtol=1e-6)
    curvature = (SLOPE(total_r + h, eta)[0] - SLOPE(total_r - h, eta)[0]) / (2 * h)
    assert CURVATURE(total_r, eta) == pytest.approx(float(curvature), rel=1e-6)
    assert FORWARD(total_r, eta) == pytest.approx(float(SLOPE(total_r, eta)[0]), rel=1e-12)


@pytest.mark.parametrize("x64", [True, False])
def test_gradients_are_finite_from_0_to_beyond_1(x64: bool) -> None:
    with jax.enable_x64(x64):
        for f in (absorption_ratio, albedo_p):
            slope = jax.jit(jax.grad(f, (0, 1)))
            for total_r in (-0.1, 0.0, 1e-6, 0.5, 1 - 1e-7, 1.0, 1.1):
                assert np.all(np.isfinite(slope(total_r, 1.3))), total_r


def test_vmap_and_single_precision_agree_with_scalars() -> None:
    total_r = jnp.array([0.01, 0.3, 0.8, 0.99, 1.0, 1.2])
    one_by_one = [float(absorption_ratio(float(x), 1.3)) for x in total_r]
    np.testing.assert_allclose(jax.vmap(absorption_ratio, (0, None))(total_r, 1.3), one_by_one, rtol=1e-13)
    np.testing.assert_allclose(absorption_ratio(total_r, 1.3), one_by_one, rtol=1e-13)
    single = absorption_ratio(total_r.astype(jnp.float32), jnp.float32(1.3))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, one_by_one, rtol=2e-5)
