"""What back and wall make of a half space's light: against literal solutions, the engine's walks, and by its laws."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, special

from bssrdf.bench import finite_light
from bssrdf.bench.finite_light import Case
from bssrdf.transport import shipped_table
from bssrdf.transport.arrays import NUMPY, JaxEngine
from bssrdf.transport.dish import _bessel_k
from bssrdf.transport.engine import MonteCarloMedium, simulate
from bssrdf.transport.finite import Sample, change, changes, half_space, log_ratio, top_of, total_ratio
from bssrdf.transport.light import dipole, shape_of
from bssrdf.transport.slab import FARTHEST, MILNE, Top, air_back, fine, milne, rough

Floats = Any
TOP = Top(1.07, 1.55)
SIGMA = 1.7
X = np.array([0.3, 1.0, 3.0, 6.0, 9.0])


def column(value: float) -> Floats:
    return np.full((1, 1), float(value))


def sample(tau: float, rho: float, omega: float = np.inf, wall: float = 0.0) -> Sample:
    """Of lengths in mean free paths."""
    return Sample(column(tau / SIGMA), column(rho), column(omega / SIGMA), column(wall))


def per_loss(rho: float) -> float:
    """1/z of a face that sends back the share ρ."""
    return 1 / (MILNE + 4 / 3 * rho / (1 - rho))


def literal_spectrum(mu: float, tau: float, h: float) -> float:
    """Flux out of a slab from a unit plane source at TOP.source: four amplitudes from four conditions, D = 1/3."""
    s, z = TOP
    down, up = (lambda x: np.exp(-mu * x)), (lambda x: np.exp(mu * (x - tau)))
    conditions = np.array(
        [
            [1 + z * mu, (1 - z * mu) * up(0), 0, 0],
            [0, 0, (h - mu) * down(tau), h + mu],
            [down(s), up(s), -down(s), -up(s)],
            [-mu * down(s), mu * up(s), mu * down(s), -mu * up(s)],
        ]
    )
    a, b, _, _ = np.linalg.solve(conditions, [0, 0, 0, 3])
    return float((-mu * a + mu * b * up(0)) / 3)


def literal_slab(tau: float, rho: float, q: float) -> tuple[Floats, float]:
    """R(r) and R in reduced units: Hankel's integral by 800 points in k, the half space's part in closed form."""
    nodes, weights = np.polynomial.legendre.leggauss(800)
    k, w = 15 * (1 + nodes), 15 * weights
    h = per_loss(rho)
    mu = np.sqrt(q * q + k * k)
    less = [literal_spectrum(m, tau, h) - np.exp(-m * TOP.source) / (1 + m * TOP.z) for m in mu]
    change = (special.j0(X[:, None] * k) * k * w * less).sum(1) / (2 * np.pi)
    return half_space(NUMPY, TOP, column(q), X[None])[0][0] + change, literal_spectrum(q, tau, h)


def literal_dish(tau: float, rho: float, omega: float, wall: float, q: float) -> tuple[Floats, float]:
    """The same by a Fourier–Bessel series over the k at which J0 meets Robin's condition at the wall."""
    h, h_wall = per_loss(rho), per_loss(wall)
    low, high = np.append(0, special.jn_zeros(1, 699)) + 1e-9, special.jn_zeros(0, 700)
    at_wall = lambda y: h_wall * omega * special.j0(y) - y * special.j1(y)  # noqa: E731
    y = np.array([optimize.brentq(at_wall, a, b) for a, b in zip(low, high, strict=True)])
    weight = np.array([literal_spectrum(np.hypot(q, k), tau, h) if k < 25 else 0.0 for k in y / omega])
    weight /= np.pi * omega**2 * (special.j0(y) ** 2 + special.j1(y) ** 2)
    return (special.j0(X[:, None] * y / omega) * weight).sum(1), float(
        (weight * 2 * np.pi * omega**2 / y * special.j1(y)).sum()
    )


def fast(dish: bool, held: Sample, q: float) -> tuple[Floats, float]:
    half = half_space(NUMPY, TOP, column(q), X[None])[0][0]
    ratio = np.exp(log_ratio(NUMPY, dish, held, TOP, column(np.log(SIGMA)), column(q), X[None] / SIGMA)[0][0])
    total = total_ratio(NUMPY, dish, held, TOP, column(np.log(SIGMA)), column(q))[0][0, 0]
    return ratio * half, total * np.exp(-q * TOP.source) / (1 + q * TOP.z)


@pytest.mark.parametrize("tau", [2.0, 4.0, 12.0])
@pytest.mark.parametrize("rho", [0.0, 0.9, 0.99])
@pytest.mark.parametrize("q", [1e-3, 0.1, 0.7])
def test_a_slab_is_the_literal_solution(tau: float, rho: float, q: float) -> None:
    curve, total = fast(False, sample(tau, rho), q)
    expected, expected_total = literal_slab(tau, rho, q)
    near = 3 * tau > X  # farther out next to nothing is left of the half space's light
    np.testing.assert_allclose(curve[near], expected[near], rtol=5e-4)
    assert total == pytest.approx(expected_total, rel=1e-7)


@pytest.mark.parametrize("tau", [5.0, 25.0])
@pytest.mark.parametrize(("rho", "wall"), [(0.0, 0.0), (0.9, 0.0), (0.0, 0.5)])
@pytest.mark.parametrize("q", [1e-3, 0.1, 0.7])
def test_a_dish_is_the_literal_series(tau: float, rho: float, wall: float, q: float) -> None:
    curve, total = fast(True, sample(tau, rho, 10.0, wall), q)
    expected, expected_total = literal_dish(tau, rho, 10.0, wall, q)
    np.testing.assert_allclose(curve[1:], expected[1:], rtol=2e-5)
    assert total == pytest.approx(expected_total, rel=1e-6)


def test_a_deep_dish_is_one_of_any_depth() -> None:
    deep, total = fast(True, sample(200.0, 0.0, 10.0), 0.1)
    deeper, same = fast(True, sample(np.inf, 0.9, 10.0), 0.1)
    np.testing.assert_allclose(deep, deeper, rtol=1e-4)
    assert total == pytest.approx(same, rel=1e-5)


CASES = {
    "thin on black": (False, sample(3.0, 0.0)),
    "on white": (False, sample(8.0, 0.9)),
    "cup": (True, sample(15.0, 0.03, 11.0, 0.0)),
    "glass cup": (True, sample(40.0, 0.9, 20.0, air_back(1.3))),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("q", [1e-6, 0.02, 0.4, 1.4])
def test_slopes_are_differences_and_both_engines_agree(name: str, q: float, x64: None) -> None:
    dish, held = CASES[name]
    step = 1e-4

    def both(e: Any, log_sigma: float, at: float) -> tuple[Any, Any]:
        as_array = e.xp.asarray
        place = (as_array(column(log_sigma)), as_array(column(at)))
        on = Sample(*map(as_array, held))
        return log_ratio(e, dish, on, TOP, *place, as_array(X[None])), total_ratio(e, dish, on, TOP, *place)

    here = both(NUMPY, 0.1, q)
    with jax.numpy_rank_promotion("allow"):
        compiled = jax.jit(lambda: both(JaxEngine(), 0.1, q))()
    for ours, other in zip(jax.tree.leaves(here), jax.tree.leaves(compiled), strict=True):
        np.testing.assert_allclose(ours, other, rtol=1e-9, atol=1e-9)
    along = [both(NUMPY, 0.1 + sign * step, q) for sign in (1, -1)]
    across = [both(NUMPY, 0.1, q * (1 + sign * step)) for sign in (1, -1)]
    for which in (0, 1):
        np.testing.assert_allclose(
            here[which][1], (along[0][which][0] - along[1][which][0]) / (2 * step), rtol=1e-4, atol=1e-6
        )
        np.testing.assert_allclose(
            here[which][2] * q, (across[0][which][0] - across[1][which][0]) / (2 * step), rtol=1e-4, atol=1e-6
        )


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("q", [1e-6, 0.1, 1.4])
def test_the_value_alone_is_that_with_slopes_for_samples_near_one_another(name: str, q: float) -> None:
    dish, held = CASES[name]
    place = (TOP, column(0.1), column(q), X[None])
    near = [
        held._replace(thickness_mm=1.3 * held.thickness_mm),
        held._replace(thickness_mm=0.8 * held.thickness_mm, radius_mm=0.8 * held.radius_mm),
        held._replace(back=held.back + 0.05),
    ]
    values = np.concatenate(changes(NUMPY, dish, fine(), near, held, *place))
    expected = np.concatenate([change(NUMPY, dish, each, *place)[0] for each in near])
    half = half_space(NUMPY, TOP, column(q), np.exp(0.1) * X[None])[0]
    assert (abs(values - expected) < 2e-4 * half).all()
    (roughly,) = changes(NUMPY, dish, rough(), [held], held, *place)
    assert (abs(roughly - change(NUMPY, dish, held, *place)[0]) < 2e-4 * half + 1e-6 * half.max()).all()


@pytest.mark.parametrize("name", CASES)
def test_single_precision_is_finite_and_near(name: str) -> None:
    dish, held = CASES[name]
    single = jax.tree.map(lambda each: jnp.asarray(each, jnp.float32), held)
    for q in (1e-6, 0.1, 1.4):
        place = (jnp.full((1, 1), 0.1, jnp.float32), jnp.full((1, 1), q, jnp.float32))
        with jax.numpy_rank_promotion("allow"):
            found = log_ratio(JaxEngine(), dish, single, TOP, *place, jnp.asarray(X[None], jnp.float32))
            total = total_ratio(JaxEngine(), dish, single, TOP, *place)
        exact = log_ratio(NUMPY, dish, held, TOP, column(0.1), column(q), X[None])
        for ours, other in zip(found, exact, strict=True):
            np.testing.assert_allclose(ours[:, :4], other[:, :4], rtol=0.02, atol=0.02)
        assert all(bool(jnp.isfinite(each).all()) for each in (*found, *total))


def test_modified_bessel_functions_of_the_second_kind_are_scipy_s() -> None:
    y = np.geomspace(0.4, 300, 200)
    for ours, theirs in zip(_bessel_k(np, y), (special.k0e(y), special.k1e(y)), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-11)


MEDIA = {
    "tau": st.floats(2, 60),
    "q": st.floats(1e-6, 1.5),
    "rho": st.floats(0, 0.97),
    "omega": st.floats(8, 80),
    "wall": st.floats(0, 0.6),
    "dish": st.booleans(),
}


@settings(max_examples=60, deadline=None)
@given(**MEDIA)
def test_light_is_never_negative_and_rises_with_the_back(
    tau: float, q: float, rho: float, omega: float, wall: float, dish: bool
) -> None:
    place = (column(np.log(SIGMA)), column(q))
    low, high = (sample(tau, each, omega, wall) for each in (rho, rho + 0.02))
    ratio = log_ratio(NUMPY, dish, low, TOP, *place, np.linspace(0.1, min(omega, FARTHEST * tau), 30)[None] / SIGMA)
    assert all(np.isfinite(each).all() for each in ratio)
    totals = [total_ratio(NUMPY, dish, each, TOP, *place)[0][0, 0] for each in (low, high)]
    assert 0 < totals[0] <= totals[1] * (1 + 1e-9)


@settings(max_examples=60, deadline=None)
@given(tau=MEDIA["tau"], q=st.floats(1e-6, 1.3), omega=MEDIA["omega"], dish=MEDIA["dish"])
def test_on_black_a_deeper_sample_is_brighter(tau: float, q: float, omega: float, dish: bool) -> None:
    place = (column(np.log(SIGMA)), column(q))
    totals = [total_ratio(NUMPY, dish, sample(depth, 0.0, omega), TOP, *place)[0][0, 0] for depth in (tau, 1.1 * tau)]
    assert totals[0] <= totals[1] * (1 + 1e-9)
    assert totals[1] <= 1 + 1e-9


@pytest.mark.parametrize("dish", [False, True])
def test_without_end_a_sample_is_a_half_space_to_the_last_bit(dish: bool) -> None:
    endless = Sample(column(1e9), column(0.5), column(1e9 if dish else np.inf), column(0.0))
    place = (column(0.0), column(0.05))
    assert np.all(log_ratio(NUMPY, dish, endless, TOP, *place, X[None])[0] == 0)
    assert total_ratio(NUMPY, dish, endless, TOP, *place)[0] == pytest.approx(1, abs=1e-15)


def test_milne_s_length_is_known_without_a_surface_and_rises_with_its_index() -> None:
    assert milne(1 + 1e-9) == pytest.approx(MILNE, abs=1e-6)
    assert MILNE < milne(1.2) < milne(1.5) < milne(2.0)
    assert MILNE + 4 / 3 * air_back(1.4) / (1 - air_back(1.4)) == pytest.approx(milne(1.4))


@pytest.mark.parametrize(("eta", "tau"), [(1.3, 4.0), (1.5, 6.0)])
def test_a_lossless_slab_passes_on_what_exact_transport_says(eta: float, tau: float) -> None:
    """T = (source + z)/(τ + z + 0.7104): diffusion with Fdr alone would be 2 % off."""
    top = top_of(shipped_table(eta, 0.0))
    passed, error = simulate(
        MonteCarloMedium(0.0, 1.0, 0.0, eta, tau, "matched"), r_edges_mm=[0, 1], n_photons=60_000, seed=31
    ).total_t()
    assert passed == pytest.approx(sum(top) / (tau + top.z + MILNE), abs=4 * error)
    assert error < 0.006 * passed


def test_the_source_of_the_paper_s_dipole_makes_up_its_own_loss() -> None:
    model = dipole(1.4)
    assert sum(top_of(model)) == pytest.approx(1 + 2 * model.a / 3, rel=1e-3)


def as_sample(case: Case) -> tuple[bool, Sample]:
    back = air_back(case.eta) if isinstance(case.back, str) else case.back
    wall = air_back(case.eta) if case.wall == "air" else 0.0
    radius = np.inf if case.width_mm is None else case.width_mm / 2
    return case.width_mm is not None, Sample(*map(column, (case.depth_mm, back, radius, wall)))


def predicted(case: Case) -> tuple[Floats, float]:
    """R_d over the case's annuli and R, by table and ratio."""
    model = shipped_table(case.eta, case.g)
    top, (dish, held) = top_of(model), as_sample(case)
    log_sigma, q = map(column, shape_of(*case.coefficients))
    nodes, weights = np.polynomial.legendre.leggauss(4)
    lo, hi = case.edges_mm[:-1, None], case.edges_mm[1:, None]
    r = np.sqrt(lo**2 + (hi**2 - lo**2) * (1 + nodes) / 2)
    sigma = np.exp(log_sigma)
    rd = sigma**2 * model.look(NUMPY, q, sigma * r.reshape(1, -1))[0]
    rd = rd * np.exp(log_ratio(NUMPY, dish, held, top, log_sigma, q, r.reshape(1, -1))[0])
    total = model.total(NUMPY, q)[0] * total_ratio(NUMPY, dish, held, top, log_sigma, q)[0]
    return (rd.reshape(r.shape) * weights / 2).sum(1), float(total[0, 0])


@pytest.mark.parametrize("case", [c for c in finite_light.slabs() if c.depth_mfp > 7.9], ids=lambda c: c.name)
def test_slabs_of_eight_mean_free_paths_and_more_are_as_the_engine_has_them(case: Case) -> None:
    light = finite_light.shipped()[case.name]
    rd, total = predicted(case)
    assert light.total == pytest.approx(total, abs=0.005 * total + 3 * light.total_se)
    off, noise = light.rd[1:] / rd[1:] - 1, light.rd_se[1:] / rd[1:]
    told = (noise < 0.05) & (light.rd[1:] > 1e-4 * light.rd[1])  # fainter annuli of dark media hang on a few photons
    excess = float(np.mean(off[told] ** 2 - noise[told] ** 2))
    scatter = float(np.sqrt(2 * np.sum(noise[told] ** 4)) / told.sum())
    assert excess < (0.03 if case.depth_mfp < 10 else 0.01) ** 2 + 4 * scatter


@pytest.mark.parametrize("case", finite_light.dishes(), ids=lambda c: c.name)
def test_dishes_are_as_the_engine_has_them(case: Case) -> None:
    light = finite_light.shipped()[case.name]
    rd, total = predicted(case)
    assert light.total == pytest.approx(total, abs=0.005 * total + 3 * light.total_se)
    off, noise = light.rd[1:] / rd[1:] - 1, light.rd_se[1:] / rd[1:]
    assert np.mean(off**2 - noise**2) < 0.01**2 + 3 * np.sqrt(2 * np.sum(noise**4)) / noise.size
