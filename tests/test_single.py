"""Laws of first-order scattering."""

import itertools
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from bssrdf.transport import single

CASES = [
    (2.0, 0.5, 0.0, 1.0),
    (1.0, 0.0, 0.5, 1.3),
    (0.03, 1.45, 0.0, 1.3),
    (5.0, 0.1, 0.85, 1.5),
    (1.0, 1.0, -0.3, 1.5),
]
ARGUMENTS = ("sigma_s", "sigma_a", "g", "eta")


@pytest.fixture(autouse=True, scope="module")
def double() -> Iterator[None]:
    with jax.enable_x64(True), jax.numpy_rank_promotion("raise"):
        yield


def transmitted(eta: float, cos_inside: float) -> float:
    """1 − Fr from inside by Snell's law, 0 beyond the critical angle."""
    sin_t = eta * np.sqrt(1 - cos_inside**2)
    if sin_t >= 1:
        return 0.0
    cos_t = np.sqrt(1 - sin_t**2)
    r_s = (eta * cos_inside - cos_t) / (eta * cos_inside + cos_t)
    r_p = (cos_inside - eta * cos_t) / (cos_inside + eta * cos_t)
    return 1 - (r_s**2 + r_p**2) / 2


def phase(g: float, cos_theta: float) -> float:
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cos_theta) ** 1.5)


def literal_rd(sigma_s: float, sigma_a: float, g: float, eta: float, r: float) -> float:
    """Down to depth z, one scattering, and straight to the surface at r, summed over z."""
    sigma_t = sigma_s + sigma_a

    def integrand(z: float) -> float:
        d = np.hypot(r, z)
        mu = z / d
        return sigma_s * np.exp(-sigma_t * (z + d)) * phase(g, -mu) * transmitted(eta, mu) * mu / d**2

    start = r * np.sqrt(eta**2 - 1)
    edges = [start, start + r, start + 4 * r, start + 20 * r, start + 20 * r + 40 / sigma_t]
    return sum(quad(integrand, a, b, epsabs=0, epsrel=1e-10, limit=400)[0] for a, b in itertools.pairwise(edges))


@pytest.mark.parametrize(ARGUMENTS, CASES)
def test_the_curve_is_the_integral_over_depth(sigma_s: float, sigma_a: float, g: float, eta: float) -> None:
    for r_mfp in (1e-3, 0.1, 1.0, 8.0):
        r = r_mfp / (sigma_s + sigma_a)
        expected = literal_rd(sigma_s, sigma_a, g, eta, r)
        assert single.first_order_rd(sigma_s, sigma_a, g, eta, r) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize(ARGUMENTS, CASES)
def test_bins_add_up_to_the_total(sigma_s: float, sigma_a: float, g: float, eta: float) -> None:
    edges = np.concatenate([[0], np.geomspace(1e-4, 60, 40)]) / (sigma_s + sigma_a)
    mean = np.asarray(single.first_order_bin_average(sigma_s, sigma_a, g, eta, edges[:-1], edges[1:]))
    total = float(single.first_order_total(sigma_s, sigma_a, g, eta))
    assert np.sum(mean * np.pi * np.diff(edges**2)) == pytest.approx(total, rel=1e-9)
    assert 0 < total < sigma_s / (sigma_s + sigma_a)


def test_a_bin_is_the_mean_of_the_curve() -> None:
    case = (1.0, 0.2, 0.3, 1.3)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    r = 1.5 + 0.5 * nodes
    mean = np.sum(weights * r * np.asarray(single.first_order_rd(*case, r))) / np.sum(weights * r)
    assert single.first_order_bin_average(*case, 1.0, 2.0) == pytest.approx(mean, rel=1e-9)


def test_the_origin_diverges_as_1_over_r() -> None:
    near, nearer = (float(single.first_order_rd(1.0, 0.1, 0.0, 1.3, r)) * r for r in (1e-4, 1e-6))
    assert near == pytest.approx(nearer, rel=1e-2)


def test_scattering_back_to_back_is_the_known_albedo_series() -> None:
    """Isotropic, matched, normal: ∫₀¹ μ/(1 + μ) dμ · α/2 = α (1 − ln 2)/2."""
    assert single.first_order_total(0.5, 0.5, 0.0, 1.0) == pytest.approx((1 - np.log(2)) / 4, rel=1e-9)


@pytest.mark.parametrize("x64", [True, False])
def test_gradients_are_finite(x64: bool) -> None:
    with jax.enable_x64(x64):
        slope = jax.jit(jax.grad(single.first_order_bin_average, (0, 1, 2, 3, 4, 5)))
        for case in ((1.0, 0.0, 0.0, 1.0), (1.0, 0.5, 0.9, 1.5)):
            for r_lo, r_hi in ((0.0, 1e-3), (1.0, 1.0), (1e3, 2e3)):
                assert np.all(np.isfinite(slope(*case, r_lo, r_hi))), (case, r_lo)


def test_single_precision_agrees_with_double() -> None:
    r = jnp.geomspace(1e-3, 10, 20)
    expected = single.first_order_rd(1.0, 0.2, 0.5, 1.3, r)
    floats = map(jnp.float32, (1.0, 0.2, 0.5, 1.3))
    found = single.first_order_rd(*floats, r.astype(jnp.float32))
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def direction(theta: float, phi: float) -> jax.Array:
    return jnp.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


@pytest.mark.parametrize(ARGUMENTS, CASES)
def test_radiance_is_the_integral_along_the_refracted_ray(sigma_s: float, sigma_a: float, g: float, eta: float) -> None:
    w_i, w_o = direction(0.9, 0.3), direction(0.4, 2.0)
    inward = np.append(-np.asarray(w_i[:2]) / eta, 0)
    outward = np.append(np.asarray(w_o[:2]) / eta, 0)
    inward[2], outward[2] = -np.sqrt(1 - inward @ inward), np.sqrt(1 - outward @ outward)
    irradiance_inside = transmitted(eta, -inward[2]) / (eta**2 * -inward[2]) * eta**2

    def scattered(s: float) -> float:
        depth = s * outward[2]
        return np.exp(-(sigma_s + sigma_a) * (s + depth / -inward[2])) * sigma_s * phase(g, inward @ outward)

    inside = irradiance_inside * quad(scattered, 0, np.inf, epsrel=1e-10)[0]
    expected = inside * transmitted(eta, outward[2]) / eta**2
    assert single.outgoing_radiance(sigma_s, sigma_a, g, eta, w_i, w_o) == pytest.approx(expected, rel=1e-8)


def test_the_papers_form_lacks_the_squared_index() -> None:
    w_i, w_o = direction(0.9, 0.3), direction(0.4, 2.0)
    ours = float(single.outgoing_radiance(1.0, 0.5, 0.2, 1.5, w_i, w_o))
    assert single.outgoing_radiance(1.0, 0.5, 0.2, 1.5, w_i, w_o, paper=True) == pytest.approx(2.25 * ours, rel=1e-12)
