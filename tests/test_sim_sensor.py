"""The simulated sensor obeys the laws that a photon transfer measurement of a real one would find."""

from __future__ import annotations

import numpy as np
import pytest

from bssrdf.rig.sim.sensor import SimSensor, dark_current, expose, mosaic

SENSOR = SimSensor(height_px=200, width_px=300, hot_share=0.0, dark_e_per_s=0.0)


def test_variance_grows_with_the_mean_by_the_gain_from_the_read_noise_up() -> None:
    for rate in (0.0, 50.0, 20_000.0):
        dn = expose(SENSOR, rate, 1.0, np.random.default_rng(1)).astype(float)
        assert dn.mean() - SENSOR.black_dn == pytest.approx(rate / SENSOR.gain_e_per_dn, abs=0.2)
        quantisation = 1 / 12
        expected = (rate + SENSOR.read_noise_e**2) / SENSOR.gain_e_per_dn**2 + quantisation
        assert dn.var() == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("bits", [14, 16])
def test_too_much_light_clips_at_the_full_well(bits: int) -> None:
    sensor = SimSensor(bits=bits)
    assert (expose(sensor, 2 * sensor.full_well_e, 1.0, np.random.default_rng(1)) == 2**bits - 1).all()
    just_below = expose(sensor, 0.9 * sensor.full_well_e, 1.0, np.random.default_rng(1))
    assert np.median(just_below) < 2**bits - 1


def test_hot_pixels_stay_where_they_are_and_grow_with_the_exposure() -> None:
    sensor = SimSensor(hot_share=1e-3)
    hot = dark_current(sensor) > 1000
    assert 50 < hot.sum() < 250
    short, long = (expose(sensor, 0.0, t, np.random.default_rng(1))[hot].mean() - sensor.black_dn for t in (0.1, 1.0))
    assert long == pytest.approx(10 * short, rel=0.1)


def test_the_mosaic_takes_each_pixel_from_its_own_filter() -> None:
    planes = {channel: np.full(SENSOR.shape, float(value)) for value, channel in enumerate("RGB")}
    tile = mosaic(SENSOR, planes)[:2, :2]
    np.testing.assert_array_equal(tile, [[0, 1], [1, 2]])
