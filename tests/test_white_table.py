"""Monte Carlo tables: energy, limits, derivatives, independent codes, and the media between their nodes."""

import itertools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from builders import OF_TWO_CODES, curve

from bssrdf.errors import InputError
from bssrdf.transport.dipole import Medium
from bssrdf.transport.discrete_ordinates import half_space
from bssrdf.transport.engine import MonteCarloMedium, simulate
from bssrdf.transport.forward import WHOLE_CIRCLE, ForwardModel
from bssrdf.transport.single import first_order_bin_average
from bssrdf.transport.white import grid
from bssrdf.transport.white.archive import lagrange
from bssrdf.transport.white.samples import Walk
from bssrdf.transport.white.store import shipped, table_model

TABLE_ERROR = 0.006
NORMAL = np.array([1.0])


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def medium_of(albedo_p, eta, sigma_tp=1.0):
    return Medium(sigma_tp * (1 - albedo_p), sigma_tp * albedo_p, eta)


def test_shipped_tables_are_small_and_cover_the_usual_media():
    tables = shipped()
    assert {1.3, 1.33, 1.4, 1.5} <= set(tables.etas)
    assert {0.0, 0.8, 0.9} <= set(tables.gs)
    package = Path(grid.__file__).parent / "tables"
    assert sum(file.stat().st_size for file in package.iterdir()) < 1e6


def test_a_table_is_a_forward_model():
    assert isinstance(table_model(1.3, 0.0), ForwardModel)


@pytest.mark.parametrize(("eta", "g"), [(1.3, 0.0), (1.43, 0.7)])
@pytest.mark.parametrize("albedo_p", [1.0, 0.9996, 0.97, 0.6, 0.1, 0.02])
def test_the_curve_integrates_to_the_total(eta, g, albedo_p):
    model, medium = table_model(eta, g), medium_of(albedo_p, eta)
    edges = np.append(0, np.geomspace(1e-3, 200, 200))
    within = float(jnp.sum(model.bin_average(medium, edges[:-1], edges[1:]) * np.pi * np.diff(edges**2)))
    kappa = float(np.sqrt(3 * (1 - albedo_p)))
    beyond = 2 * np.pi * 200**2 * float(model.rd(medium, 200.0)) / (1 + 200 * kappa)
    assert within + beyond == pytest.approx(float(model.total(medium)), rel=1e-4)


@pytest.mark.parametrize(("eta", "g"), [(1.3, 0.0), (1.5, 0.9), (1.37, 0.55)])
def test_totals_between_the_nodes_are_exact(eta, g):
    model = table_model(eta, g)
    nodes = grid.q_nodes()
    for q in (nodes[[0, 1, 4, 9, 15, 24, 30]] + nodes[[1, 2, 5, 10, 16, 25, 31]]) / 2:
        exact = half_space(grid.albedo_of(q, g), g, eta, NORMAL).total
        total = float(model.total(medium_of(1 - q * q, eta)))
        assert total == pytest.approx(exact, rel=1e-3)
        if q * q < 0.1:
            assert 1 - total == pytest.approx(1 - exact, rel=3e-3)


@pytest.mark.parametrize("name", OF_TWO_CODES)
def test_the_curve_agrees_with_an_independent_code(name):
    known = curve(name)
    model, medium = table_model(known.eta, known.g), Medium(known.sigma_a, known.sigma_sp, known.eta)
    value = np.asarray(model.bin_average(medium, known.r_lo, known.r_hi))
    z = (value - known.rd) / np.hypot(known.se, TABLE_ERROR * known.rd)
    seen = known.se < 0.2 * known.rd
    assert np.mean(np.abs(z[seen]) < 3.5) >= 0.95
    assert np.mean(z[seen] ** 2) < 1.5
    assert float(model.total(medium)) == pytest.approx(known.total_r, rel=1e-3)


@pytest.mark.parametrize("name", OF_TWO_CODES)
def test_a_fit_to_an_independent_code_returns_its_coefficients(name):
    known = curve(name)
    sigma_a, sigma_sp, eta, model = known.sigma_a, known.sigma_sp, known.eta, table_model(known.eta, known.g)
    clear = known.se < 0.05 * known.rd
    r_lo, r_hi, rd, se = (each[clear] for each in (known.r_lo, known.r_hi, known.rd, known.se))
    average = jax.jit(lambda p: model.bin_average(Medium(jnp.exp(p[0]), jnp.exp(p[1]), eta), r_lo, r_hi))
    total_of = jax.jit(lambda p: model.total(Medium(jnp.exp(p[0]), jnp.exp(p[1]), eta)))

    def residual(p):
        misses = np.log(np.asarray(average(p)) / rd) / np.hypot(se / rd, TABLE_ERROR)
        return np.append(misses, (float(total_of(p)) - known.total_r) / (3e-4 * known.total_r))

    found = np.exp(scipy.optimize.least_squares(residual, np.log([2 * sigma_a, 0.7 * sigma_sp])).x)
    assert found == pytest.approx([sigma_a, sigma_sp], rel=0.01)


@pytest.mark.parametrize(
    ("sigma_a", "sigma_sp", "g", "eta", "n_photons"),
    [
        pytest.param(0.98, 0.02, 0.0, 1.3, 2_000_000, id="albedo 0.02"),
        pytest.param(0.98, 0.02, 0.8, 1.3, 2_000_000, id="albedo 0.02 forward"),
        pytest.param(0.02, 1.0, 0.7, 1.33, 60_000, id="Intralipid"),
        pytest.param(0.1, 0.9, 0.66, 1.43, 100_000, id="silicone"),
    ],
)
def test_the_curve_agrees_with_the_absorbing_walk(sigma_a, sigma_sp, g, eta, n_photons):
    medium = Medium(sigma_a, sigma_sp, eta)
    edges = np.append(0, np.geomspace(0.02, 8, 25))
    tally = simulate(
        MonteCarloMedium.reduced(sigma_a, sigma_sp, g, eta), r_edges_mm=edges, n_photons=n_photons, seed=31
    )
    value, error = tally.rd()
    model = np.asarray(table_model(eta, g).bin_average(medium, edges[:-1], edges[1:]))
    seen = error < 0.15 * value
    z = (model - value)[seen] / np.hypot(error, TABLE_ERROR * value)[seen]
    assert seen.sum() > 10
    assert np.mean(np.abs(z) < 3.5) >= 0.95
    assert np.mean(z**2) < 1.8


def test_light_scattered_once_is_exact_at_low_albedo():
    medium = medium_of(0.02, 1.3)
    lo, hi = np.array([0, 0.01, 0.1]), np.array([0.01, 0.02, 0.2])
    once = np.asarray(first_order_bin_average(medium.sigma_sp, medium.sigma_a, 0.0, 1.3, lo, hi))
    assert np.asarray(table_model(1.3, 0.0).bin_average(medium, lo, hi)) / once == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("eta", "g"), [(1.3, 0.0), (1.5, 0.8)])
def test_the_longest_paths_are_continued_as_diffusing_light(eta, g):
    """At albedo 1 a half space is a dipole of moment P = −d ln R/dκ: R_d → P/(2π r³)."""
    model = table_model(eta, g)
    q = 1e-3
    moment = -np.log(half_space(grid.albedo_of(q, g), g, eta, NORMAL).total) / (np.sqrt(3) * q)
    value = float(model.rd(medium_of(1.0, eta), 80.0)) * 2 * np.pi * 80.0**3
    assert value == pytest.approx(moment, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("g", [0.0, 0.8])
def test_the_depth_of_the_first_jump_does_not_matter(g, monkeypatch):
    import threading

    from bssrdf.transport.white import samples as white_samples

    def curve(depth, margin, seed):
        monkeypatch.setattr(white_samples, "JUMP_DEPTH", depth)
        monkeypatch.setattr(white_samples, "JUMP_MARGIN", margin)
        batches = [Walk(g, np.array([1.5]), 0).batch(seed, i, 20_000, threading.Event())[0] for i in range(24)]
        summed = np.add.reduceat(np.array(batches)[:, :-1, 0, 0], np.arange(40, 112, 6), axis=1)
        return summed.mean(0), summed.std(0, ddof=1) / np.sqrt(24)

    (late, late_error), (early, early_error) = curve(24.0, 18.0, 1), curve(10.0, 6.0, 2)
    z = (late - early) / np.hypot(late_error, early_error)
    assert np.mean(z**2) < 2.2


@pytest.mark.parametrize("albedo_p", [0.9996, 0.96, 0.5, 0.05])
def test_derivatives_agree_with_finite_differences(albedo_p):
    model, medium = table_model(1.43, 0.7), medium_of(albedo_p, 1.43)
    radii = jnp.array([0.003, 0.1, 1.0, 7.0])

    def logs(p):
        scattered = Medium(p[0], p[1], 1.43)
        return jnp.append(jnp.log(model.rd(scattered, radii)), jnp.log(model.total(scattered)))

    at = jnp.array([medium.sigma_a, medium.sigma_sp])
    exact = jax.jacfwd(logs)(at)
    reverse = jax.jacrev(logs)(at)
    for k in range(2):
        step = jnp.zeros(2).at[k].set(1e-5 * at[k])
        finite = (logs(at + step) - logs(at - step)) / (2e-5 * at[k])
        assert np.asarray(exact[:, k]) == pytest.approx(np.asarray(finite), rel=1e-4, abs=1e-4)
        assert np.asarray(reverse[:, k]) == pytest.approx(np.asarray(exact[:, k]), rel=1e-9)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_derivatives_are_finite_without_absorption(dtype):
    model = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), table_model(1.3, 0.8))
    radii = jnp.array([1e-3, 1.0, 100.0], dtype)

    def value(sigma_a):
        medium = Medium(sigma_a, jnp.asarray(1.0, dtype), jnp.asarray(1.3, dtype))
        return jnp.sum(jnp.log(model.rd(medium, radii))) + model.total(medium)

    assert np.isfinite(value(jnp.asarray(0.0, dtype)))
    assert np.isfinite(jax.grad(value)(jnp.asarray(0.0, dtype)))


def test_absorption_only_darkens_every_radius():
    model = table_model(1.33, 0.9)
    radii = jnp.geomspace(0.01, 20, 40)
    values = [np.asarray(model.rd(Medium(a, 1.0, 1.33), radii)) for a in (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 5.0)]
    assert all(np.all(more < less) for less, more in itertools.pairwise(values))


def test_lengths_scale():
    model, radii = table_model(1.4, 0.35), jnp.geomspace(0.01, 20, 30)
    once = model.rd(Medium(0.05, 1.0, 1.4), radii)
    thrice = model.rd(Medium(0.15, 3.0, 1.4), radii / 3)
    assert np.asarray(thrice) == pytest.approx(9 * np.asarray(once), rel=1e-12)


def test_jit_vmap_and_broadcasting_give_the_same_values():
    model, radii = table_model(1.3, 0.0), jnp.geomspace(0.01, 20, 7)
    sigma_a = jnp.array([0.0, 0.01, 1.0])
    plain = np.array([model.rd(Medium(float(a), 1.0, 1.3), radii) for a in sigma_a])
    mapped = jax.jit(jax.vmap(lambda a: model.rd(Medium(a, 1.0, 1.3), radii)))(sigma_a)
    broadcast = model.rd(Medium(sigma_a[:, None], jnp.ones((3, 1)), 1.3), radii[None])
    assert np.asarray(mapped) == pytest.approx(plain, rel=1e-12)
    assert np.asarray(broadcast) == pytest.approx(plain, rel=1e-12)


def test_a_thin_bin_is_the_curve_itself():
    model, medium = table_model(1.3, 0.0), medium_of(0.9, 1.3)
    assert float(model.bin_average(medium, 1.0, 1.0)) == pytest.approx(float(model.rd(medium, 1.0)), rel=1e-9)


@pytest.mark.parametrize("angle", [0, 30, 45, 60])
def test_the_total_exit_radiance_is_that_of_discrete_ordinates(angle):
    mu = np.cos(np.radians(angle))
    for albedo_p in (0.999, 0.84, 0.3):
        exact = half_space(grid.albedo_of(np.sqrt(1 - albedo_p), 0.8), 0.8, 1.3, np.array([mu]))
        factor = float(table_model(1.3, 0.8).total_radiance_factor(medium_of(albedo_p, 1.3), mu))
        assert factor == pytest.approx(exact.radiance[0] / exact.total, rel=2e-3)


def test_the_exit_radiance_of_the_curve_averages_to_that_of_the_total():
    model, medium = table_model(1.3, 0.8), Medium(0.17, 0.88, 1.3)
    edges = np.append(0, np.geomspace(0.01, 60, 80))
    flux = np.asarray(model.bin_average(medium, edges[:-1], edges[1:])) * np.diff(edges**2)
    for angle in (30, 45, 60):  # along the normal light scattered once leaves at the source itself
        mu = np.cos(np.radians(angle))
        middle = (edges[1:] + edges[:-1]) / 2
        factor = np.asarray(model.radiance(medium, middle, mu, WHOLE_CIRCLE) / model.rd(medium, middle))
        mean = np.sum(flux * factor) / flux.sum()
        assert mean == pytest.approx(float(model.total_radiance_factor(medium, mu)), rel=0.015)


def test_interpolation_is_exact_at_nodes_and_for_cubics():
    nodes = np.array([0.0, 0.35, 0.6, 0.75, 0.8, 0.9])
    assert lagrange(nodes, 0.6) == pytest.approx(np.eye(6)[2])
    assert lagrange(nodes, 0.7) @ nodes**3 == pytest.approx(0.7**3)


@pytest.mark.parametrize(
    ("medium", "r", "message"),
    [
        (Medium(0.99, 0.01, 1.3), 1.0, "reduced albedo = 0.01"),
        (Medium(float("nan"), 1.0, 1.3), 1.0, "sigma_a = nan"),
        (Medium(-0.1, 1.0, 1.3), 1.0, "sigma_a = -0.1"),
        (Medium(0.1, 0.0, 1.3), 1.0, "sigma_sp = 0.0"),
        (Medium(0.0, 1.0, 1.3), 201.0, "r = 201"),
        (Medium(0.0, 1.0, 1.3), -1.0, "r = -1"),
    ],
)
def test_outside_its_range_a_table_raises(medium, r, message):
    with pytest.raises(InputError, match=message):
        table_model(1.3, 0.0).rd(medium, r)
