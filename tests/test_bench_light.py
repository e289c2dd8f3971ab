"""The light of the bench: batches share no noise, and a camera's light agrees with the deterministic total."""

import numpy as np
import pytest

from bssrdf.bench.camera_light import MEDIA, camera_lights, camera_slices
from bssrdf.bench.trial_light import batches, cells, edges_mm, exchanged
from bssrdf.transport import MonteCarloMedium, simulate
from bssrdf.transport.discrete_ordinates import half_space
from bssrdf.transport.exit_radiance import transmittance


def test_batches_of_a_cell_are_independent_lights_of_it():
    cell = next(each for each in cells() if each.name == "Potato R")
    lights = batches(cell, 24, 6_000, seed=3)
    totals = np.array([light.total for light in lights])
    albedo = cell.sigma_sp / (cell.sigma_sp + cell.sigma_a)
    exact = half_space(albedo, 0.0, cell.eta, np.array([1.0])).total
    assert abs(totals.mean() - exact) < 4 * lights[0].total_se / np.sqrt(24)
    assert np.std(totals, ddof=1) == pytest.approx(lights[0].total_se, rel=1e-6)
    assert all(light.used == lights[0].used for light in lights)
    curves = np.array([light.rd[light.used] for light in lights])
    assert curves.shape[1] > 20
    departures = (curves - curves.mean(axis=0)) / lights[0].rd_se[lights[0].used]
    assert abs(np.corrcoef(departures)[np.triu_indices(24, 1)].mean()) < 0.1


@pytest.fixture(scope="module")
def light():
    return camera_lights(MEDIA["Ketchup R"].medium, (45.0,), range(1, 4), photons=40_000)[0]


def test_a_camera_sees_the_total_of_discrete_ordinates(light):
    medium = light.medium
    albedo = medium.sigma_sp / (medium.sigma_sp + medium.sigma_a)
    seen = half_space(albedo, 0.0, medium.eta, np.array([np.sqrt(0.5)])).radiance[0]
    entering = transmittance(medium.eta, np.array(1.0))
    assert light.total.mean() == pytest.approx(entering * seen, rel=0.01)


def test_across_the_view_less_is_seen_than_around(light):
    near = slice(0, 10)
    assert np.all(light.across.mean(axis=0)[near] < light.around.mean(axis=0)[near])


def test_seeds_are_lights_of_their_own_and_say_their_noise(light):
    assert len(set(light.total.tolist())) == 3
    pieces = camera_slices(light, 0.01, 0.002, seed=1)
    assert len(pieces) == 3
    part = pieces[0].channels["G"]
    assert np.all(part.sd_per_mm2 > 0.0099 * light.across[0])


def spread_of_the_mean(values):
    """Variance of the mean over all columns, over what it is where columns are independent."""
    departures = (values - values.mean(axis=0)) / values.std(axis=0, ddof=1)
    return np.var(departures.sum(axis=1), ddof=1) / departures.shape[1]


def test_annuli_of_one_trial_are_independent_where_those_of_one_walk_are_not():
    cell = next(each for each in cells() if each.name == "Ketchup R")
    medium = MonteCarloMedium.reduced(cell.sigma_a, cell.sigma_sp, 0.0, cell.eta)
    tally = simulate(medium, r_edges_mm=edges_mm(cell), n_photons=400 * 2_000, seed=4, n_batches=400)
    walked = tally.scores[:, 0, :, :-1].sum((1, 3)) / tally.area_mm2
    lights = exchanged(cell, walked, tally.scores[:, 0].sum((1, 2, 3)), 2_000, seed=4)
    assert spread_of_the_mean(walked[:, -150:]) > 4
    assert spread_of_the_mean(np.array([light.rd[-150:] for light in lights])) < 1.4
    np.testing.assert_array_equal(np.sort([light.rd[-1] for light in lights]), np.sort(walked[:, -1]))
    assert lights[0].total_se == pytest.approx(tally.total_r()[1] * 20)


def test_rings_of_one_camera_slice_do_not_go_with_its_total():
    [light] = camera_lights(MEDIA["Whole milk R"].medium, (45.0,), range(60), photons=4_000)
    pieces = camera_slices(light, 0.0, 0.0, seed=2)
    total = np.array([piece.total_r["G"] for piece in pieces])
    rings = np.array([piece.channels["G"].rd_per_mm2 for piece in pieces])
    assert np.corrcoef((light.across / light.across.mean(axis=0)).sum(axis=1), light.total)[0, 1] > 0.7
    assert abs(np.corrcoef((rings / rings.mean(axis=0)).sum(axis=1), total)[0, 1]) < 0.45
