"""Laws of the merge, on frames with a known sensor, and a real bracket that must predict itself."""

import re
from dataclasses import replace

import numpy as np
import pytest
from builders import bent_bracket, real_data

from bssrdf.calib.sensor import Sensor, master_dark
from bssrdf.errors import InputError
from bssrdf.measure.hdr import HOT, NO_DATA, SATURATED, DarkPaired, Shot, merge
from bssrdf.session.frame_files import read_frame_file

SENSOR = Sensor(black_dn=512.0, saturation_dn=65000.0, gain_e_per_dn=1.0, read_noise_e=3.0)
EXPOSURES_S = [0.001 * 2**k for k in range(13)]
DARK_E_PER_S = 2.0


def expose(radiance, exposure_s, rng):
    electrons = rng.poisson((radiance + DARK_E_PER_S) * exposure_s, radiance.shape)
    read = rng.normal(0, SENSOR.read_noise_e, radiance.shape)
    return np.clip(np.rint(electrons + read) + SENSOR.black_dn, 0, 65535).astype(np.uint16)


def shots_of(radiance, exposures_s=EXPOSURES_S, seed=0, n_darks=1):
    rng = np.random.default_rng(seed)
    shots = []
    for number, exposure_s in enumerate(exposures_s):
        darks = [expose(np.zeros(radiance.shape), exposure_s, rng) for _ in range(n_darks)]
        sample = DarkPaired(expose(radiance, exposure_s, rng), master_dark(darks), n_darks)
        shots.append(Shot(f"{number:02d}", exposure_s, lambda sample=sample: sample))
    return shots


def decades(low=1, high=6, shape=(400, 500)):
    """Radiance falling over decades from left to right; the brightest pixel nearly fills the shortest exposure."""
    ramp = np.logspace(-low, -high, shape[1])
    return 0.9 * 64000 / EXPOSURES_S[0] * 10**low * np.broadcast_to(ramp, shape)


@pytest.fixture(scope="module")
def scene():
    radiance = decades(low=0)
    return radiance, shots_of(radiance)


@pytest.fixture(scope="module")
def merged(scene):
    return merge(scene[1], SENSOR)


def bound(radiance):
    """Least relative error that any unbiased estimate can have, dark frames included."""
    information = 0.0
    for t in EXPOSURES_S:
        mean = (radiance + DARK_E_PER_S) * t
        read = 2 * (SENSOR.read_noise_e**2 + 1 / 12)
        usable = mean + SENSOR.black_dn < SENSOR.saturation_dn
        information = information + usable * t**2 / (mean + DARK_E_PER_S * t + read)
    return 1 / np.sqrt(information) / radiance


def test_the_error_is_at_the_bound_in_every_decade_and_the_bias_is_nil(scene, merged):
    radiance, _ = scene
    error = merged.radiance / radiance - 1
    decade = np.floor(-np.log10(radiance / radiance.max()) * 0.9999)
    for number in range(6):
        here = decade == number
        assert np.sqrt(np.mean(error[here] ** 2)) < 1.02 * np.sqrt(np.mean(bound(radiance)[here] ** 2)), number
        standard_error = np.std(error[here]) / np.sqrt(here.sum())
        assert abs(np.mean(error[here])) < max(1e-3, 4 * standard_error), number


def test_the_variance_map_is_right(scene, merged):
    radiance, _ = scene
    assert np.mean((merged.radiance - radiance) ** 2 / merged.variance) == pytest.approx(1, abs=0.02)


def test_the_order_of_the_frames_changes_no_bit(scene, merged):
    shuffled = [scene[1][i] for i in np.random.default_rng(1).permutation(len(scene[1]))]
    again = merge(shuffled, SENSOR)
    for name, plane in vars(merged).items():
        np.testing.assert_array_equal(plane, getattr(again, name))


def test_negatives_are_kept_so_that_darkness_comes_out_as_zero():
    dark = merge(shots_of(np.zeros((200, 200))), SENSOR)
    assert abs(np.mean(dark.radiance)) < 4 * np.sqrt(np.mean(dark.variance) / dark.radiance.size)
    assert np.mean(dark.radiance < 0) == pytest.approx(0.5, abs=0.05)
    assert np.mean(dark.radiance**2 / dark.variance) == pytest.approx(1, abs=0.03)


def test_repeated_frames_are_all_merged():
    radiance = np.full((100, 100), 50_000.0)
    once = merge(shots_of(radiance, [0.1]), SENSOR)
    fourfold = merge(shots_of(radiance, [0.1] * 4), SENSOR)
    assert np.all(fourfold.count == 4)
    assert np.mean(fourfold.variance) == pytest.approx(np.mean(once.variance) / 4, rel=0.01)


def test_a_saturated_sample_is_left_out_by_pixel_and_channel():
    radiance = np.zeros((20, 20, 3)) + np.array([1e5, 1e6, 1e9])
    image = merge(shots_of(radiance, [0.01, 0.1]), SENSOR)
    assert [np.unique(image.count[..., c]).tolist() for c in range(3)] == [[2], [1], [0]]
    assert np.all(image.mask[..., 2] == SATURATED | NO_DATA)
    assert np.all(np.isnan(image.radiance[..., 2]))
    np.testing.assert_allclose(image.radiance[..., :2].mean((0, 1)), [1e5, 1e6], rtol=3e-3)


def test_a_clipped_black_leaves_the_sum_of_all_light_over_the_sum_of_all_time():
    """Read noise is not known where the converter cuts it off: each photon counts alike, the dark ones apart."""
    cut = replace(SENSOR, black_dn=0.0, black_clipped=True)
    radiance = np.broadcast_to(np.geomspace(3e4, 6e7, 300), (300, 300))
    shots = shots_of(radiance)
    merged = merge(shots, cut)
    samples = [shot.load() for shot in shots]
    good = np.array([each.raw < cut.saturation_dn for each in samples])
    light = np.sum([g * (s.raw.astype(float) - s.dark) for g, s in zip(good, samples, strict=True)], axis=0)
    seconds = np.tensordot(EXPOSURES_S, good, 1)
    np.testing.assert_allclose(merged.radiance, light / seconds, rtol=1e-5)
    assert np.mean(merged.radiance / radiance) == pytest.approx(1, abs=1e-4)
    assert 0 < (~good).mean() < 1


def test_hot_pixels_are_marked():
    hot = np.zeros((8, 8), bool)
    hot[2, 3] = True
    image = merge(shots_of(np.full((8, 8), 1e4), [0.1]), SENSOR, hot=hot)
    assert np.argwhere(image.mask & HOT).tolist() == [[2, 3]]


def test_frames_of_another_size_are_named():
    shots = shots_of(np.full((8, 8), 1e4), [0.1]) + shots_of(np.full((8, 9), 1e4), [0.2])
    with pytest.raises(InputError, match=r"00: is \(9, 8\) pixels.* first frame \(8, 8\)"):
        merge(shots, SENSOR)


def test_everything_saturated_is_an_error():
    with pytest.raises(InputError, match="every pixel is saturated"):
        merge(shots_of(np.full((8, 8), 1e9), [0.1, 0.2]), SENSOR)


FLEA3_SENSOR = Sensor(black_dn=0.0, saturation_dn=250.0, gain_e_per_dn=25.0, read_noise_e=10.0, black_clipped=True)


def flea3_shots(folder, wavelength_nm):
    def load(file, darks):
        planes = [read_frame_file(dark).data for dark in darks]
        return DarkPaired(read_frame_file(file).data, master_dark(planes), len(planes))

    shots = []
    for file in sorted((folder / "frames").glob(f"*_{wavelength_nm}nm_*")):
        ms = re.search(r"_(\d+)ms_", file.name)[1]
        darks = sorted((folder / "darks").glob(f"*_{ms}ms_*"))
        shots.append(Shot(file.name, int(ms) / 1000, lambda file=file, darks=darks: load(file, darks)))
    return shots


@pytest.mark.parametrize("camera", ["simulated", "flea3"])
def test_a_bracket_of_8_bits_predicts_each_of_its_own_exposures(camera, tmp_path):
    folder = tmp_path if camera == "simulated" else real_data("flea3_bracket")
    if camera == "simulated":
        bent_bracket(folder, 600, bend=0.0, down=False)
    shots = flea3_shots(folder, 600)
    assert len(shots) == 7
    for held_out in shots:
        rest = merge([shot for shot in shots if shot is not held_out], FLEA3_SENSOR, period=2)
        raw, dark, _ = held_out.load()
        well_exposed = (raw > 20) & (raw < 235) & (rest.mask == 0)
        ratio = (raw - dark)[well_exposed] / (rest.radiance[well_exposed] * held_out.exposure_s)
        assert abs(np.median(ratio) - 1) < 0.02, held_out.name
