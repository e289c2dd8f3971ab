"""Monte Carlo walk: against deterministic totals, an independent code's curves, and single scattering."""

import threading

import jax
import numpy as np
import pytest
from builders import OF_TWO_CODES, curve

from bssrdf.errors import InputError
from bssrdf.transport.discrete_ordinates import decay_constant, half_space
from bssrdf.transport.engine import IncidentBeam, MonteCarloMedium, simulate
from bssrdf.transport.exit_radiance import N_MU, angle_weights
from bssrdf.transport.photon import stream_states
from bssrdf.transport.single import first_order_bin_average, first_order_total

NORMAL = np.array([1.0])


def specular(eta):
    return ((eta - 1) / (eta + 1)) ** 2


@pytest.mark.parametrize(
    ("albedo", "g", "eta", "published"),
    [
        (0.5, 0.0, 1.0, 0.115226),
        (0.9, 0.0, 1.0, 0.414947),
        (0.99, 0.0, 1.0, 0.752721),
        (0.9, 0.75, 1.0, 0.1655),
        (2.62 / 2.6241, 0.0, 1.5, 0.767503),
        (4.4 / 4.57, 0.8, 1.3, 0.19069),
        (0.18 / 0.241, 0.0, 1.3, 0.14512),
    ],
)
def test_discrete_ordinates_reproduce_deterministic_totals(albedo, g, eta, published):
    total = half_space(albedo, g, eta, NORMAL).total * (1 - specular(eta))
    assert total == pytest.approx(published, rel=2e-4)


def test_discrete_ordinates_reproduce_giovanelli_with_the_specular_share():
    total = half_space(0.9, 0.0, 1.5, NORMAL).total * (1 - specular(1.5)) + specular(1.5)
    assert total == pytest.approx(0.2600, abs=1e-4)


@pytest.mark.parametrize("g", [0.0, 0.9])
def test_a_conservative_half_space_returns_all_light(g):
    assert half_space(1.0, g, 1.5, NORMAL).total == pytest.approx(1, abs=1e-4)


def test_the_decay_constant_has_its_diffusion_limit_and_stays_below_extinction():
    assert decay_constant(0.9999, 0.8) == pytest.approx(np.sqrt(3 * 1e-4 * (1 - 0.9999 * 0.8)), rel=1e-3)
    assert decay_constant(0.5, 0.0) == pytest.approx(0.957504, abs=1e-6)  # Case and Zweifel 1967
    assert decay_constant(0.02, 0.0) <= 1


@pytest.mark.parametrize(
    ("medium", "expected"),
    [
        (MonteCarloMedium(0.5, 0.5), 0.115226),
        (MonteCarloMedium(0.1, 0.9, 0.75), 0.165517),
        (MonteCarloMedium(0.1, 0.9, 0.0, 1.5), 0.21992 / 0.96),
        (MonteCarloMedium.reduced(0.17, 0.88, 0.8, 1.3), 0.193976),
    ],
)
def test_the_walk_agrees_with_deterministic_totals(medium, expected):
    value, error = simulate(medium, r_edges_mm=[0, 1], n_photons=100_000, seed=11).total_r()
    assert abs(value - expected) < 3.5 * error
    assert error < 0.02 * expected


def test_a_slab_reflects_and_transmits_as_van_de_hulst_found():
    tally = simulate(
        MonteCarloMedium(0.1, 0.9, 0.75, 1.0, 2.0, "matched"), r_edges_mm=[0, 1], n_photons=200_000, seed=2
    )
    r, r_error = tally.total_r()
    t, t_error = tally.total_t()
    assert abs(r - 0.09739) < 3.5 * r_error
    assert abs(t - 0.66096) < 3.5 * t_error


def test_a_black_backing_passes_nothing_on_and_reflects_as_a_matched_one():
    black, matched = (
        simulate(MonteCarloMedium(0.1, 0.9, 0.5, 1.3, 1.0, backing), r_edges_mm=[0, 1], n_photons=4000, seed=3)
        for backing in ("black", "matched")
    )
    assert black.total_t() == (0.0, 0.0)
    assert black.total_r() == matched.total_r()


def test_a_diffuse_back_adds_what_passes_to_and_fro_under_the_slab():
    """R + T ρ t/(1 − ρ r): r and t are the slab's for diffuse light, here by incidence, η = 1."""
    slab, rho = {"sigma_a": 0.05, "sigma_s": 1.0, "g": 0.5, "thickness_mm": 2.0}, 0.8
    nodes, weights = np.polynomial.legendre.leggauss(5)
    tallies = [
        simulate(
            MonteCarloMedium(**slab, backing="matched"),
            IncidentBeam(incidence_deg=float(np.degrees(np.arccos(np.sqrt((1 + node) / 2))))),
            r_edges_mm=[0, 1],
            n_photons=30_000,
            seed=20,
        )
        for node in nodes
    ]
    r = sum(w / 2 * tally.total_r()[0] for w, tally in zip(weights, tallies, strict=True))
    t = sum(w / 2 * tally.total_t()[0] for w, tally in zip(weights, tallies, strict=True))
    bare = simulate(MonteCarloMedium(**slab, backing="matched"), r_edges_mm=[0, 1], n_photons=60_000, seed=21)
    backed, error = simulate(
        MonteCarloMedium(**slab, backing=rho), r_edges_mm=[0, 1], n_photons=120_000, seed=22
    ).total_r()
    expected = bare.total_r()[0] + bare.total_t()[0] * rho * t / (1 - rho * r)
    assert backed == pytest.approx(expected, abs=4 * np.hypot(error, 0.003))


def test_a_smooth_wall_keeps_light_that_a_black_one_takes_and_one_without_contrast_is_black():
    def total(wall, eta):
        medium = MonteCarloMedium(0.02, 1.0, 0.0, eta, width_mm=8.0, wall=wall)
        return simulate(medium, r_edges_mm=[0, 1], n_photons=60_000, seed=23).total_r()

    (air, air_error), (black, _) = total("air", 1.4), total("black", 1.4)
    assert air > black + 5 * air_error
    (alike, error), (other, other_error) = total("air", 1.0), total("black", 1.0)
    assert abs(alike - other) < 4 * np.hypot(error, other_error)


def test_no_light_leaves_the_surface_beyond_the_wall():
    medium = MonteCarloMedium(0.0, 1.0, 0.0, 1.4, 6.0, "air", 8.0, "air")
    tally = simulate(medium, r_edges_mm=[0, 4.0 + 1e-9], n_photons=4000, seed=24)
    assert tally.scores[:, :, :, -1].sum() == 0
    assert tally.scores.sum() > 0


def test_all_light_is_somewhere_without_absorption():
    tally = simulate(MonteCarloMedium(0.0, 1.0, 0.3, 1.4, 3.0, "matched"), r_edges_mm=[0, 1], n_photons=20_000, seed=4)
    assert tally.total_r()[0] + tally.total_t()[0] == pytest.approx(1, abs=4 * tally.total_r()[1])
    assert tally.lost == 0
    under_air = simulate(MonteCarloMedium(0.0, 1.0, 0.3, 1.4, 3.0, "air"), r_edges_mm=[0, 1], n_photons=20_000, seed=4)
    assert under_air.total_r()[0] + under_air.total_t()[0] == pytest.approx(1, abs=4 * under_air.total_r()[1])
    assert under_air.total_r()[0] > tally.total_r()[0]


@pytest.mark.parametrize("name", OF_TWO_CODES)
def test_the_curve_agrees_with_an_independent_code(name):
    known = curve(name)
    n_photons = {1.5: 150_000, 1.3: 120_000 if known.g else 300_000}[known.eta]
    edges = np.append(known.r_lo, known.r_hi[-1])
    medium = MonteCarloMedium.reduced(known.sigma_a, known.sigma_sp, known.g, known.eta)
    value, error = simulate(medium, r_edges_mm=edges, n_photons=n_photons, seed=1).rd()
    z = (value - known.rd) / np.hypot(error, known.se)
    assert np.mean(np.abs(z) < 3.5) >= 0.95
    assert np.mean(z**2) < 1.5


@pytest.mark.parametrize(("g", "eta"), [(0.0, 1.3), (0.8, 1.5)])
def test_photons_scattered_once_follow_eq_6(g, eta):
    medium = MonteCarloMedium(0.4, 0.6, g, eta)
    edges = np.array([0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6])
    tally = simulate(medium, r_edges_mm=edges, n_photons=300_000, seed=6)
    with jax.enable_x64(True):
        expected = np.asarray(first_order_bin_average(0.6, 0.4, g, eta, edges[:-1], edges[1:]))
        total = float(first_order_total(0.6, 0.4, g, eta))
    value, error = tally.rd("first")
    assert np.mean(((value - expected) / error) ** 2) < 2.5
    assert abs(tally.total_r("first")[0] - total) < 3.5 * tally.total_r("first")[1]


def test_one_seed_gives_the_same_bits_on_any_number_of_threads():
    medium = MonteCarloMedium.reduced(0.1, 1.0, 0.5, 1.4)
    one, two, other = (
        simulate(medium, r_edges_mm=[0, 1, 5], n_photons=3200, seed=seed, n_threads=n)
        for seed, n in ((7, 1), (7, 2), (8, 2))
    )
    assert np.array_equal(one.scores, two.scores)
    assert not np.array_equal(one.scores, other.scores)


def test_streams_are_distinct():
    states = np.concatenate([stream_states(1, 8), stream_states(1, 8, 3), stream_states(2, 8)])
    assert len(np.unique(states[:, 0])) == 24


def test_standard_errors_are_those_of_repeated_runs():
    medium = MonteCarloMedium.reduced(0.2, 1.0, 0.0, 1.3)
    runs = [simulate(medium, r_edges_mm=[0, 0.5, 2], n_photons=3200, seed=seed).rd() for seed in range(24)]
    spread = np.std([value for value, _ in runs], axis=0, ddof=1)
    claimed = np.mean([error for _, error in runs], axis=0)
    assert np.all(np.abs(spread / claimed - 1) < 0.5)


def test_a_wide_beam_spreads_the_light_and_keeps_the_total():
    medium = MonteCarloMedium.reduced(0.1, 1.0, 0.0, 1.3)
    pencil = simulate(medium, r_edges_mm=[0, 0.5, 50], n_photons=40_000, seed=9)
    wide = simulate(medium, IncidentBeam(radius_mm=3.0), r_edges_mm=[0, 0.5, 50], n_photons=40_000, seed=10)
    assert abs(wide.total_r()[0] - pencil.total_r()[0]) < 4 * np.hypot(wide.total_r()[1], pencil.total_r()[1])
    assert wide.rd()[0][0] < 0.3 * pencil.rd()[0][0]


def test_a_beam_fills_its_radius():
    beam = IncidentBeam(radius_mm=2.0)
    medium = MonteCarloMedium(0.0, 1e-6, 0.0, 1.0, 1e-3, "matched")
    tally = simulate(medium, beam, r_edges_mm=[0, 2.0], n_photons=40_000, seed=12)
    inside = tally.scores[:, 1, :, 0].sum() / len(tally.scores)
    assert inside == pytest.approx(1 - np.exp(-2), abs=0.01)


def test_tilted_light_enters_refracted():
    medium = MonteCarloMedium(0.0, 1e-6, 0.0, 1.5, 1.0, "matched")
    tilted = simulate(medium, IncidentBeam(incidence_deg=60.0), r_edges_mm=[0, 0.6, 0.8], n_photons=64, seed=13)
    offset = np.tan(np.arcsin(np.sin(np.radians(60)) / 1.5))
    assert 0.6 < offset < 0.8
    assert tilted.scores[:, 1, :, 1].sum() / len(tilted.scores) == pytest.approx(1, abs=1e-3)


def test_mean_path_length_is_the_curve_s_derivative_by_absorption():
    edges = np.array([0, 0.3, 1.0, 2.0])
    lower, middle, upper = (
        simulate(MonteCarloMedium(a, 1.0, 0.0, 1.3), r_edges_mm=edges, n_photons=400_000, seed=14)
        for a in (0.18, 0.2, 0.22)
    )
    slope = np.log(lower.rd()[0] / upper.rd()[0]) / 0.04
    assert middle.mean_path_mm() == pytest.approx(slope, rel=0.35)


@pytest.mark.parametrize("eta", [1.0, 1.33, 1.5])
def test_lambertian_light_under_the_surface_has_the_fresnel_lobe(eta):
    square = (np.arange(N_MU * 200) + 0.5) / (N_MU * 200)
    mu = np.sqrt(square)
    inside = np.sqrt(eta**2 - 1 + square)
    transmitted = (
        1 - (((mu - inside) / (mu + inside)) ** 2 + ((eta**2 * mu - inside) / (eta**2 * mu + inside)) ** 2) / 2
    )
    share = transmitted.reshape(N_MU, 200).sum(1) / transmitted.sum()
    at_45 = np.interp(np.sqrt(0.5), mu, transmitted) / transmitted.mean()
    assert angle_weights(eta, np.sqrt(0.5)) @ share == pytest.approx(at_45, rel=1e-4)


@pytest.mark.parametrize("angle", [0, 30, 45, 60])
def test_radiance_of_the_whole_surface_agrees_with_discrete_ordinates(angle):
    medium = MonteCarloMedium.reduced(0.17, 0.88, 0.8, 1.3)
    tally = simulate(medium, r_edges_mm=[0, 1], n_photons=200_000, seed=15)
    expected = half_space(medium.sigma_s / medium.sigma_t, 0.8, 1.3, np.cos(np.radians([angle]))).radiance[0]
    value, error = tally.total_radiance(angle)
    assert abs(value - expected) < 3.5 * error


def test_an_interrupted_run_keeps_what_is_finished():
    def interrupt(done, asked):
        if done >= 3:
            raise KeyboardInterrupt

    tally = simulate(
        MonteCarloMedium.reduced(0.1, 1.0),
        r_edges_mm=[0, 1],
        n_photons=64_000,
        seed=16,
        n_threads=1,
        progress=interrupt,
    )
    assert tally.interrupted
    assert 3 <= len(tally.scores) < 32
    assert tally.n_photons == 2000 * len(tally.scores)
    assert 0.2 < tally.total_r()[0] < 0.8
    assert threading.active_count() < 10


def test_ctrl_c_before_anything_is_finished_goes_on():
    def interrupt(done, asked):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(
            MonteCarloMedium.reduced(0.001, 1.0),
            r_edges_mm=[0, 1],
            n_photons=3_200_000,
            seed=16,
            n_threads=1,
            progress=interrupt,
        )


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        ({"eta": 0.9}, "eta = 0.9"),
        ({"g": 1.0}, "g = 1.0"),
        ({"g": -1.0}, "g = -1.0"),
        ({"sigma_s": 0.0}, "sigma_s = 0.0"),
        ({"sigma_a": float("nan")}, "sigma_a = nan"),
        ({"sigma_a": -0.1}, "sigma_a = -0.1"),
        ({"thickness_mm": 0.0}, "thickness_mm = 0.0"),
        ({"thickness_mm": 1.0, "backing": 1.0}, "backing = 1.0"),
        ({"thickness_mm": 1.0, "backing": "glass"}, "backing = glass"),
        ({"width_mm": -1.0}, "width_mm = -1.0"),
        ({"width_mm": 9.0, "wall": "white"}, "wall = white"),
    ],
)
def test_an_impossible_medium_is_refused_by_value(arguments, value):
    with pytest.raises(InputError, match=value):
        MonteCarloMedium(**{"sigma_a": 0.1, "sigma_s": 1.0} | arguments)


@pytest.mark.parametrize("edges", [[0.1, 1], [0, 1, 1], [0], [0, float("inf")]])
def test_radii_that_do_not_ascend_from_zero_are_refused(edges):
    with pytest.raises(InputError, match="r_edges_mm"):
        simulate(MonteCarloMedium(0.1, 1.0), r_edges_mm=edges, n_photons=10, seed=1)
