"""The light of the bench: batches share no noise, and a camera's light agrees with the deterministic total."""

import numpy as np
import pytest

from bssrdf.bench.camera_light import MEDIA, camera_lights, camera_slices
from bssrdf.bench.trial_light import batches, cells
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
