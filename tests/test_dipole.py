"""Laws of the dipole."""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bssrdf.transport import dipole, fresnel
from bssrdf.transport.dipole import Medium

TAIL_SLOPE = jax.jit(jax.grad(dipole.tail, 1))
FLUENCE_SLOPE = jax.jit(jax.grad(dipole.fluence, 2))
CURVES: dict[str, Callable[..., jax.Array]] = {
    "rd": dipole.rd,
    "log_rd": dipole.log_rd,
    "tail": dipole.tail,
    "log_tail": dipole.log_tail,
    "bin_average": lambda medium, r: dipole.bin_average(medium, r, r + 1),
    "thin_bin": lambda medium, r: dipole.bin_average(medium, r, r),
}
MARBLE = Medium(0.0041, 2.62, 1.5)
HARD_MEDIA = (Medium(0.0, 1.0, 1.3), Medium(1e-9, 1.0, 1.3), Medium(1e-4, 20.0, 1.0), Medium(5.0, 0.01, 2.5))
laws = settings(max_examples=40, deadline=None)


@pytest.fixture(autouse=True, scope="module")
def double() -> Iterator[None]:
    with jax.enable_x64(True), jax.numpy_rank_promotion("raise"):
        yield


@st.composite
def media(draw: st.DrawFn) -> Medium:
    """Scale over 5 decades, absorption ratio from 0 over 8 decades to 0.99."""
    sigma_tp = 10 ** draw(st.floats(-2, 3))
    ratio = draw(st.one_of(st.just(0.0), st.floats(-8, -0.005).map(lambda x: 10**x)))
    return Medium(ratio * sigma_tp, (1 - ratio) * sigma_tp, draw(st.floats(1, 3)))


radii_mfp = st.floats(-3, 2).map(lambda x: 10**x)


def integral(medium: Medium, r_lo: float, r_hi: float) -> float:
    """∫ 2πr R_d dr in u = z_r/d_r, in which infinity is 0 and the 1/r³ decay a constant; panels resolve every scale."""
    z_r = float(medium.z_r)
    u_lo, u_hi = (1 / np.hypot(1, r / z_r) for r in (r_hi, r_lo))
    edges = u_lo + (u_hi - u_lo) * np.concatenate([[0], np.geomspace(1e-9, 1, 60)])
    nodes, weights = np.polynomial.legendre.leggauss(16)
    u = (edges[:-1, None] + np.diff(edges)[:, None] * (1 + nodes) / 2).ravel()
    du = (np.diff(edges)[:, None] * weights / 2).ravel()
    r = z_r * np.sqrt((1 - u) * (1 + u)) / u
    return float(np.sum(np.asarray(dipole.rd(medium, r)) * 2 * np.pi * z_r**2 / u**3 * du))


def literal_rd(medium: Medium, r: NDArray[np.float64]) -> NDArray[np.float64]:
    """Eq. 4 with 1 − α′ and a bare root, as one would type it from the paper."""
    sigma_a, sigma_sp, eta = medium
    sigma_tp = sigma_a + sigma_sp
    sigma_tr = np.sqrt(3 * sigma_a * sigma_tp)
    a = float(fresnel.boundary_a(eta))
    z_r, z_v = 1 / sigma_tp, 1 / sigma_tp + 4 * a / (3 * sigma_tp)
    d_r, d_v = np.sqrt(r**2 + z_r**2), np.sqrt(r**2 + z_v**2)
    real = z_r * (sigma_tr * d_r + 1) * np.exp(-sigma_tr * d_r) / d_r**3
    virtual = z_v * (sigma_tr * d_v + 1) * np.exp(-sigma_tr * d_v) / d_v**3
    return sigma_sp / sigma_tp / (4 * np.pi) * (real + virtual)


@laws
@given(medium=media())
def test_rd_integrates_to_the_closed_total(medium: Medium) -> None:
    assert integral(medium, 0, np.inf) == pytest.approx(float(dipole.total_r(medium)), rel=1e-9)


@laws
@given(medium=media(), r_mfp=radii_mfp)
def test_tail_falls_by_what_rd_emits(medium: Medium, r_mfp: float) -> None:
    r = r_mfp * float(medium.z_r)
    slope = TAIL_SLOPE(medium, r)
    assert slope == pytest.approx(-2 * np.pi * r * float(dipole.rd(medium, r)), rel=1e-9, abs=1e-300)


@laws
@given(medium=media(), r_mfp=radii_mfp, relative_width=st.floats(-6, 1).map(lambda x: 10**x))
def test_bin_average_is_the_mean_over_its_annulus(medium: Medium, r_mfp: float, relative_width: float) -> None:
    r_lo = r_mfp * float(medium.z_r)
    r_hi = r_lo * (1 + relative_width)
    area = np.pi * (r_hi - r_lo) * (r_hi + r_lo)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    narrow = relative_width < 0.1 or r_hi < 0.1 * float(medium.z_r)  # there `integral` loses digits: u is near 1
    if narrow and float(medium.sigma_tr) * (r_hi - r_lo) < 20:
        r = (r_lo + r_hi) / 2 + nodes * (r_hi - r_lo) / 2
        expected = np.sum(weights * r * np.asarray(dipole.rd(medium, r))) / np.sum(weights * r)
    else:
        expected = integral(medium, r_lo, r_hi) / area
    assert dipole.bin_average(medium, r_lo, r_hi) == pytest.approx(expected, rel=1e-9, abs=1e-290)


@laws
@given(medium=media())
def test_bins_add_up_to_the_total_less_the_tail(medium: Medium) -> None:
    edges = float(medium.z_r) * np.concatenate([[0], np.geomspace(1e-3, 50, 40)])
    light = np.asarray(dipole.bin_average(medium, edges[:-1], edges[1:])) * np.pi * np.diff(edges**2)
    assert light.sum() == pytest.approx(float(dipole.total_r(medium) - dipole.tail(medium, edges[-1])), rel=1e-10)


@laws
@given(medium=media())
def test_rd_is_equation_4(medium: Medium) -> None:
    r = float(medium.z_r) * np.geomspace(1e-3, 30, 50)
    np.testing.assert_allclose(dipole.rd(medium, r), literal_rd(medium, r), rtol=1e-12)
    np.testing.assert_allclose(dipole.bin_average(medium, r, r), literal_rd(medium, r), rtol=1e-12)
    np.testing.assert_allclose(np.exp(dipole.log_rd(medium, r)), literal_rd(medium, r), rtol=1e-11)
    np.testing.assert_allclose(np.exp(dipole.log_tail(medium, r)), dipole.tail(medium, r), rtol=1e-11)


@laws
@given(medium=media(), scale=st.floats(-2, 2).map(lambda x: 10**x))
def test_the_shape_depends_on_albedo_and_index_alone(medium: Medium, scale: float) -> None:
    scaled = Medium(medium.sigma_a * scale, medium.sigma_sp * scale, medium.eta)
    r = float(medium.z_r) * np.geomspace(1e-3, 30, 20)
    np.testing.assert_allclose(dipole.rd(scaled, r / scale), scale**2 * dipole.rd(medium, r), rtol=1e-11)
    assert dipole.total_r(scaled) == pytest.approx(float(dipole.total_r(medium)), rel=1e-13)


@laws
@given(medium=media(), r_mfp=radii_mfp)
def test_exitant_light_is_the_gradient_of_the_fluence(medium: Medium, r_mfp: float) -> None:
    r = r_mfp * float(medium.z_r)
    flow = medium.diffusion * FLUENCE_SLOPE(medium, r, 0.0)
    assert flow == pytest.approx(float(dipole.rd(medium, r)), rel=1e-10)


def test_the_total_is_that_of_the_tail_from_the_origin_and_1_without_absorption() -> None:
    assert dipole.tail(MARBLE, 0.0) == pytest.approx(float(dipole.total_r(MARBLE)), rel=1e-14)
    assert dipole.total_r(Medium(0.0, 3.0, 1.3)) == 1


def test_the_total_keeps_its_digits_near_albedo_1() -> None:
    q = np.sqrt(3e-16)
    a = float(fresnel.boundary_a(1.3))
    assert 1 - dipole.total_r_of_ratio(1e-16, 1.3) == pytest.approx(q * (1 + 2 / 3 * a), rel=1e-7)
    with jax.enable_x64(False):
        slope = jax.grad(dipole.total_r_of_ratio)(1e-9, 1.3)
    assert slope == pytest.approx(float(jax.grad(dipole.total_r_of_ratio)(1e-9, 1.3)), rel=1e-5)


@pytest.mark.parametrize("medium", [MARBLE, Medium(0.5, 1.0, 1.3)])
def test_logarithms_stay_finite_where_the_curve_underflows(medium: Medium) -> None:
    near, far = 5e3 / float(medium.sigma_tr), 5.1e3 / float(medium.sigma_tr)
    assert dipole.rd(medium, near) == 0
    for log_curve in (dipole.log_rd, dipole.log_tail):
        slope = (log_curve(medium, far) - log_curve(medium, near)) / (far - near)
        assert slope == pytest.approx(-float(medium.sigma_tr), rel=1e-3)


@pytest.mark.parametrize("x64", [True, False])
@pytest.mark.parametrize("name", CURVES)
def test_values_and_gradients_are_finite_at_the_hard_points(name: str, x64: bool) -> None:
    with jax.enable_x64(x64):
        f = jax.jit(jax.value_and_grad(CURVES[name], (0, 1)))
        for medium in HARD_MEDIA:
            for r in (0.0, 1e-6, 1.0, 1e3, 1e6):
                assert np.all(np.isfinite(jax.tree.leaves(f(medium, r)))), (medium, r)


@pytest.mark.parametrize("x64", [True, False])
def test_gradients_of_the_total_are_finite_at_the_hard_points(x64: bool) -> None:
    slope = jax.jit(jax.grad(dipole.total_r))
    with jax.enable_x64(x64):
        for medium in HARD_MEDIA:
            assert np.all(np.isfinite(jax.tree.leaves(slope(medium))))


@pytest.mark.parametrize("name", ["rd", "log_rd", "bin_average", "thin_bin"])
@pytest.mark.parametrize("r", [0.0, 3.0])
def test_the_slope_at_zero_absorption_is_the_limit_from_above(name: str, r: float) -> None:
    slope = jax.jit(jax.grad(lambda sigma_a: CURVES[name](Medium(sigma_a, 1.0, 1.3), r)))
    assert slope(0.0) == pytest.approx(float(slope(1e-12)), rel=1e-4)


@pytest.mark.parametrize("name", CURVES)
def test_first_and_second_derivatives_agree_with_finite_differences(name: str) -> None:
    def curve(x: jax.Array) -> jax.Array:
        return CURVES[name](Medium(x[0], x[1], MARBLE.eta), x[2])

    x = np.array([MARBLE.sigma_a, MARBLE.sigma_sp, 2.0])
    steps = np.diag(1e-5 * x)
    f, slope, curvature = jax.jit(curve), jax.jit(jax.grad(curve)), jax.jit(jax.hessian(curve))
    differences = [float(f(x + h) - f(x - h)) / (2 * h.max()) for h in steps]
    np.testing.assert_allclose(slope(x), differences, rtol=1e-6)
    second = np.array([np.asarray(slope(x + h) - slope(x - h)) / (2 * h.max()) for h in steps])
    np.testing.assert_allclose(curvature(x), second, rtol=1e-5, atol=1e-7 * np.abs(second).max())


@pytest.mark.parametrize("eta", [0.8, 1.3, 2.5])
def test_the_slope_in_the_index_agrees_with_finite_differences(eta: float) -> None:
    low, high = (float(dipole.rd(MARBLE._replace(eta=eta + h), 2.0)) for h in (-1e-5, 1e-5))
    slope = jax.grad(dipole.rd)(MARBLE._replace(eta=eta), 2.0).eta
    assert slope == pytest.approx((high - low) / 2e-5, rel=1e-6)


@pytest.mark.parametrize("name", CURVES)
def test_single_precision_agrees_with_double(name: str) -> None:
    r = jnp.geomspace(1e-2, 30, 40)
    double = CURVES[name](MARBLE, r)
    single = CURVES[name](Medium(*map(jnp.float32, MARBLE)), r.astype(jnp.float32))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, double, rtol=2e-5, atol=1e-6 if name.startswith("log") else 0)


@pytest.mark.parametrize("name", CURVES)
def test_jit_and_vmap_change_nothing(name: str) -> None:
    f = CURVES[name]
    r = jnp.geomspace(1e-2, 30, 10)
    media_stack = Medium(jnp.array([0.0, 0.1, 0.5]), jnp.array([1.0, 2.0, 0.5]), jnp.array([1.0, 1.3, 1.5]))
    stacked = jax.jit(jax.vmap(f, (0, None)))(media_stack, r)
    for i in range(3):
        one = Medium(*(float(x[i]) for x in media_stack))
        np.testing.assert_allclose(stacked[i], [float(f(one, float(x))) for x in r], rtol=1e-12, atol=1e-14)
