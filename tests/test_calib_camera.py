"""What frames tell of their camera: exposure ratios, gain, noise, saturation, movement, colour and response."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from bssrdf.calib.colour import calibrate_colour
from bssrdf.calib.counts import plateau_dn
from bssrdf.calib.exposures import Comparison, comparable, compared
from bssrdf.calib.frame_model import solve_frames
from bssrdf.calib.frame_solution import Exposed
from bssrdf.calib.photon_transfer import pair_gain, read_noise_dn
from bssrdf.calib.registration import shift_between
from bssrdf.calib.response import fit_response
from bssrdf.calib.sensor import Sensor
from bssrdf.calib.spot import find_spot
from bssrdf.errors import InputError
from bssrdf.session.records import Camera

SENSOR = Sensor(black_dn=512.0, saturation_dn=16200.0, gain_e_per_dn=2.0, read_noise_e=4.0)
LABELS_S = [0.001 * 2**k for k in range(13)]


def signal(light_dn, rng):
    """A frame above its dark: shot and read noise of both, rounded."""
    electrons = rng.poisson(light_dn * SENSOR.gain_e_per_dn) + rng.normal(
        0, SENSOR.read_noise_e * 2**0.5, light_dn.shape
    )
    return np.rint(electrons / SENSOR.gain_e_per_dn).astype(np.float32)


def solved(true_s, radiance, seed=0):
    """The frame model of one bracket of `LABELS_S`."""
    rng = np.random.default_rng(seed)
    comparisons = []
    before = None
    for number, (label_s, t) in enumerate(zip(LABELS_S, true_s, strict=True)):
        frame = signal(np.minimum(radiance * t, 40_000), rng)
        good = frame + SENSOR.black_dn < SENSOR.saturation_dn
        if before is not None:
            ratio = label_s / LABELS_S[number - 1]
            chosen = good & before[1] & comparable(before[0], frame, ratio, SENSOR, SENSOR.span_dn())
            pair = before[0][chosen].astype(float), frame[chosen].astype(float)
            told = compared(*pair, ratio, SENSOR)
            comparisons += [Comparison(number - 1, number, 0, False, False, *means) for _, *means in told]
        before = frame, good
    frames = [Exposed("sample", label_s, label_s, 0.03) for label_s in LABELS_S]
    return solve_frames(frames, comparisons, 1, SENSOR.read_var_dn() ** 0.5, SENSOR.span_dn())


def test_wrong_exposure_labels_are_found_from_the_overlap_of_the_bracket():
    radiance = 0.9 * 15_600 / LABELS_S[0] * np.broadcast_to(np.logspace(0, -6, 600), (400, 600))
    errors = np.random.default_rng(4).uniform(-0.02, 0.02, 13)
    errors[0] = 0.05
    found = solved(np.array(LABELS_S) * (1 + errors), radiance)
    left = found.log_scale - np.log(1 + errors)
    assert np.abs(left - left[-1]).max() < 1.5e-3
    shape = np.eye(13) - 1 / 13
    sd = np.sqrt(np.diag(shape @ found.covariance @ shape))
    assert np.sqrt(np.mean((shape @ left / sd) ** 2)) < 1.6


def test_the_estimate_has_no_bias_where_most_pixels_are_dark():
    radiance = 150.0 / LABELS_S[6] * np.random.default_rng(0).exponential(1, (300, 400))
    scales = np.mean([solved(LABELS_S, radiance, seed).log_scale for seed in range(5)], axis=0)
    assert scales[9] - scales[6] == pytest.approx(0, abs=8e-4)


def test_a_ratio_that_few_bright_pixels_decide_states_their_error():
    """A spot on a dark surface: 24 pixels, the two brightest of which have six tenths of the light."""
    light, rng, z = 0.6 ** np.arange(24) * 8000 + 60, np.random.default_rng(7), []
    for _ in range(2000):
        pair = [signal(light * t, rng).astype(float) for t in (1.0, 1.5)]
        ((_, shorter, longer, log_var),) = compared(*pair, 1.5, SENSOR)
        z.append(np.log(longer / shorter / 1.5) / log_var**0.5)
    assert np.std(z) == pytest.approx(1, abs=0.1)


def test_without_overlap_the_labels_stay():
    found = solve_frames([Exposed("sample", t, t, 0.03) for t in (0.1, 0.2)], [], 1, 1.0, 1000.0)
    assert found.log_scale.tolist() == [0, 0]
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), 0.03, rtol=0.1)  # and that of the lamp


def test_photon_transfer_finds_gain_and_read_noise():
    rng = np.random.default_rng(1)
    light = np.tile(np.linspace(500, 10_000, 400), 200)
    read_var = 2 * SENSOR.read_var_dn()
    for ratio in (1.0, 2.0):
        gain = pair_gain(signal(light, rng).astype(float), signal(light * ratio, rng).astype(float), read_var / 2 * 2)
        assert gain.e_per_dn == pytest.approx(SENSOR.gain_e_per_dn, rel=5 * gain.rel_sd)
        assert gain.rel_sd < 0.01
        assert gain.power == pytest.approx(1, abs=0.05)
    pattern = rng.normal(0, 20, (300, 300))
    darks = [np.rint(512 + pattern + rng.normal(0, 2, pattern.shape)) for _ in range(2)]
    assert read_noise_dn(*darks) == pytest.approx(np.hypot(2, 12**-0.5), rel=0.02)


def test_saturation_is_where_pixels_stop_following_the_light():
    rng = np.random.default_rng(2)
    radiance = np.logspace(2, 5, 200_000)
    shorter = signal(radiance * 0.1, rng)
    longer = np.minimum(512 + signal(radiance * 0.2, rng), 9000 + rng.integers(0, 4, radiance.shape))
    assert plateau_dn(shorter, longer, 2.0, 512, 16383) == pytest.approx(9000, abs=5)
    follows = 512 + signal(radiance[:100_000] * 0.2, rng)
    assert plateau_dn(shorter[:100_000], follows, 2.0, 512, 16383) is None


def test_a_shifted_scene_is_seen_and_a_still_one_is_not():
    y, x = np.mgrid[:120, :160]

    def scene(dx, seed):
        rng = np.random.default_rng(seed)
        return signal(5000 * np.exp(-((x - 80 - dx) ** 2 + (y - 60) ** 2) / 500) + 200, rng)

    everywhere = np.ones((120, 160), bool)
    still, moved = (shift_between(scene(0, 1), scene(dx, 2), everywhere, 1) for dx in (0, 0.6))
    assert still.length_px < 5 * still.sd_px
    assert moved.x_px == pytest.approx(0.6, abs=0.15)
    assert moved.length_px > 10 * moved.sd_px


def test_the_spot_is_found_to_a_twentieth_of_a_pixel():
    y, x = (a.ravel().astype(float) for a in np.mgrid[:81, :101])
    misses = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        cx, cy = 50 + rng.uniform(-3, 3), 40 + rng.uniform(-3, 3)
        r2 = (x - cx) ** 2 + 2 * (y - cy) ** 2
        light = 3000 * np.exp(-r2 / 20) + 2000 / (1 + r2 / 30) ** 1.5
        spot = find_spot(x, y, signal(light, rng).astype(float), (48.0, 42.0), 3.0)
        misses.append(np.hypot(spot.x_px - cx, spot.y_px - cy))
    assert max(misses) < 0.05


def test_the_ellipse_of_a_gaussian_spot():
    y, x = (a.ravel().astype(float) for a in np.mgrid[:81, :101])
    spot = find_spot(x, y, np.exp(-2 * ((x - 50) / 8) ** 2 - 2 * ((y - 40) / 5) ** 2), (49.0, 41.0), 3.0)
    assert spot.ellipse_px()[:2] == pytest.approx((8.0, 5.0), rel=0.01)


def test_a_colour_chart_gives_the_matrix_to_srgb(tmp_path):
    colour = pytest.importorskip("colour")
    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    srgb = colour.XYZ_to_RGB(colour.xyY_to_XYZ(np.array(list(chart.data.values()))), "sRGB", chart.illuminant)
    camera = np.array([[0.6, 0.3, 0.1], [0.2, 0.7, 0.1], [0.05, 0.25, 0.7]])
    image = np.full((700, 900, 3), 0.4)
    image[135:-135, 135:-135] = 0.02
    for number, patch in enumerate(np.clip(srgb, 0, None) @ camera.T):
        row, column = divmod(number, 6)
        image[156 + 100 * row : 244 + 100 * row, 156 + 100 * column : 244 + 100 * column] = patch
    image = 30_000 * cv2.GaussianBlur(image, (0, 0), 1) + np.random.default_rng(0).normal(0, 30, image.shape)
    mosaic = np.empty((1400, 1800))
    for place, channel in enumerate((0, 1, 1, 2)):
        row, column = divmod(place, 2)
        mosaic[row::2, column::2] = image[..., channel]
    tifffile.imwrite(tmp_path / "chart.tif", np.rint(mosaic + 512).astype(np.uint16))
    found = calibrate_colour(tmp_path / "chart.tif", Camera("RGGB", 512.0))
    np.testing.assert_allclose(found.matrix @ camera, np.eye(3), atol=0.02)
    assert found.rms < 0.01
    tifffile.imwrite(tmp_path / "blank.tif", np.full((400, 600), 1000, np.uint16))
    with pytest.raises(InputError, match=r"blank.tif: shows no 24-patch colour chart"):
        calibrate_colour(tmp_path / "blank.tif", Camera("RGGB", 512.0))
    with pytest.raises(InputError, match=r"blank.tif: has the layout mono"):
        calibrate_colour(tmp_path / "blank.tif", Camera("mono"))


def test_the_response_of_a_gamma_camera_is_straightened():
    light = np.broadcast_to(np.linspace(0.005, 1, 300), (200, 300))
    exposures_s = [0.05, 0.1, 0.2, 0.4, 0.8]
    frames = [np.rint(255 * np.clip(2 * t * light, 0, 1) ** (1 / 2.2)).astype(np.uint8) for t in exposures_s]
    response = fit_response(frames, exposures_s)
    middle = (frames[2] > 20) & (frames[2] < 240)
    ratio = response.linearised(Path("frame"), frames[2])[middle] / light[middle]
    assert np.std(ratio) / np.mean(ratio) < 0.03
    with pytest.raises(InputError, match="at least three"):
        fit_response(frames[:2], exposures_s[:2])
    with pytest.raises(InputError, match="0 pixels are well exposed"):
        fit_response([np.zeros_like(frame) for frame in frames], exposures_s)
    with pytest.raises(InputError, match=r"a\.jpg: is not an 8-bit image of 1 channels"):
        response.linearised(Path("a.jpg"), np.zeros((4, 4, 3), np.uint8))
