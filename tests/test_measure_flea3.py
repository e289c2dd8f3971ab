"""Brackets of 8 bits, cut off at black and bent, one simulated and one real: each predicts its own exposures."""

import re
from pathlib import Path

import numpy as np
import pytest
from builders import bent_bracket, real_data

from bssrdf.calib.sensor import BEND_PIVOT, by_row, rows_of
from bssrdf.measure.bracket import bracket_of
from bssrdf.measure.hdr import merge
from bssrdf.measure.learn import learn_camera
from bssrdf.measure.levels import beside
from bssrdf.session.records import Camera, Frame

CAMERA = Camera("GBRG", exposure_rel_sd=0.001)
"""A machine-vision camera's labels."""
WHITE_DN = 255
HELD_OUT_MS = (100, 500, 2000)
WAVELENGTHS_NM = (450, 550, 600)


@pytest.fixture(scope="module", params=["simulated", "flea3"])
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if request.param == "flea3":
        return real_data("flea3_bracket")
    made = tmp_path_factory.mktemp("bent")
    for wavelength_nm in WAVELENGTHS_NM:
        bent_bracket(made, wavelength_nm)
    return made


def exposure_s(file):
    return int(re.search(r"_(\d+)ms_", file.name)[1]) / 1000


def bracket(folder, wavelength_nm, without_ms=None):
    files = [("sample", file) for file in sorted(folder.glob(f"frames/*_{wavelength_nm}nm_*"))]
    files += [("dark", file) for file in sorted(folder.glob("darks/*"))]
    frames = [Frame(str(file.relative_to(folder)), kind, exposure_s(file)) for kind, file in files]
    if without_ms:
        frames = [f for f in frames if f.kind == "dark" or round(1000 * f.exposure_s) != without_ms]
    return bracket_of("sample", folder, frames)


def held_out(folder, wavelength_nm, ms):
    whole = bracket(folder, wavelength_nm)
    (shot,) = [s for s in whole.shots(whole.exposures_s()) if f"_{ms}ms_" in s.name]
    raw, dark, _ = shot.load()
    return raw, raw.astype(float) - dark


def shown(signal, raw, learnt):
    """What the camera would show of a straight signal [DN]: bent, on the black that its frames have, with leaks."""
    pivot, bend = BEND_PIVOT * learnt.sensor.span_dn(), learnt.sensor.bend_per_dn()
    bent = signal.astype(float)
    for _ in range(20):
        bent = signal / (1 + bend * (bent - pivot))
    if not learnt.corrections:
        return bent
    each = list(learnt.corrections.values())
    black = by_row(np.add, bent.astype(np.float32), rows_of(np.mean([c.offset_dn for c in each], axis=0), raw.shape))
    leak = by_row(np.add, np.zeros(raw.shape, np.float32), rows_of(each[0].leak_dn, raw.shape))
    return black + leak * beside(~learnt.sensor.unsaturated(raw))


def by_labels(folder, wavelength_nm, without_ms):
    """Radiance by a plain Σ(x − d)/Σt."""
    signal = seconds = 0.0
    rest = bracket(folder, wavelength_nm, without_ms)
    for shot in rest.shots(rest.exposures_s()):
        raw, dark, _ = shot.load()
        good = raw < 250
        signal, seconds = signal + np.where(good, raw.astype(float) - dark, 0), seconds + good * shot.exposure_s
    return np.where(seconds > 0, signal / np.maximum(seconds, 1e-9), np.nan)


def prediction(folder, wavelength_nm, ms):
    """Median absolute errors of our prediction of a frame and of the plain sum's, and the median |z| of ours."""
    rest = bracket(folder, wavelength_nm, ms)
    learnt = learn_camera([rest], CAMERA, 2)
    times = [f.exposure_s * learnt.exposures.factor("sample", f.exposure_s) for f in rest.frames]
    shots = rest.shots(times, learnt.corrections)
    merged = merge(shots, learnt.sensor, hot=learnt.hot, period=2, model_rel_sd=learnt.contradiction)
    raw, seen = held_out(folder, wavelength_nm, ms)
    t = ms / 1000
    expected = shown(merged.radiance * t, raw, learnt)
    judged = (raw > 0.05 * WHITE_DN) & (raw < 0.95 * WHITE_DN) & (merged.mask == 0)
    own = seen / learnt.sensor.gain_e_per_dn + learnt.sensor.read_var_dn() + (learnt.contradiction * seen) ** 2
    z = np.abs(expected - seen)[judged] / np.sqrt(merged.variance * t**2 + own)[judged]
    ours, plain = (
        np.abs(each[judged] / seen[judged] - 1) for each in (expected, by_labels(folder, wavelength_nm, ms) * t)
    )
    return np.median(ours), np.nanmedian(plain), np.median(z)


def test_the_rest_of_a_bracket_predicts_each_frame_better_than_its_labels_do_and_within_its_stated_error(folder):
    ours, plain, z = np.array([prediction(folder, nm, ms) for nm in WAVELENGTHS_NM for ms in HELD_OUT_MS]).T
    report = np.round(np.stack([100 * ours, 100 * plain, z]), 2).tolist()
    assert np.all(ours <= np.maximum(1.1 * plain, plain + 0.003)), report
    assert ours.max() < 0.05, report
    assert np.median(ours) < 0.03, report
    assert np.all((z > 0.5) & (z < 1.0)), report


def left_out_exposure(folder, wavelength_nm, ms):
    """How far the light of a frame is off its prediction from the rest, as a logarithm, and the error stated for it."""
    rest = bracket(folder, wavelength_nm, ms)
    learnt = learn_camera([rest], CAMERA, 2)
    times = [f.exposure_s * learnt.exposures.factor("sample", f.exposure_s) for f in rest.frames]
    shots = rest.shots(times, learnt.corrections)
    merged = merge(shots, learnt.sensor, hot=learnt.hot, period=2, model_rel_sd=learnt.contradiction)
    raw, seen = held_out(folder, wavelength_nm, ms)
    judged = (raw > 0.2 * WHITE_DN) & (raw < 0.9 * WHITE_DN) & (merged.mask == 0)
    expected = shown(merged.radiance * ms / 1000, raw, learnt)
    of_rest = np.sqrt(np.mean(learnt.exposures.rel_sd**2))
    stated = np.linalg.norm([CAMERA.exposure_rel_sd, of_rest, learnt.contradiction])
    return np.log(np.sum(seen[judged]) / np.sum(expected[judged])), stated


@pytest.mark.slow
def test_stated_errors_of_exposure_are_as_large_as_those_found(folder):
    """Every exposure of every wavelength but the shortest, whose light the rest shows in few pixels."""
    all_ms = [[round(1000 * f.exposure_s) for f in bracket(folder, nm).frames][1:] for nm in WAVELENGTHS_NM]
    each = [
        np.array([left_out_exposure(folder, nm, ms) for ms in of_one])
        for nm, of_one in zip(WAVELENGTHS_NM, all_ms, strict=True)
    ]
    found, stated = (np.array([np.sqrt(np.mean(one[:, column] ** 2)) for one in each]) for column in (0, 1))
    found = np.hypot(found, CAMERA.exposure_rel_sd)  # what a label itself is stated to be off by is not found
    assert np.all((stated < 2 * found) & (found < 2 * stated)), (found, stated)
    assert 0.5 < np.linalg.norm(stated) / np.linalg.norm(found) < 2, (found, stated)


@pytest.mark.parametrize("wavelength_nm", WAVELENGTHS_NM)
def test_labels_known_to_be_exact_stay_and_the_bend_and_the_black_explain_the_rest(folder, wavelength_nm):
    """One camera: its bend is one, and its converter rounds down, which darks that are cut off at 0 do not show."""
    learnt = learn_camera([bracket(folder, wavelength_nm)], CAMERA, 2)
    assert learnt.sensor.black_clipped
    assert np.abs(learnt.exposures.log_scale).max() < 0.006  # the lamp may have changed
    assert np.all(learnt.exposures.rel_sd < 0.008)
    assert 0.02 < learnt.sensor.bend < 0.06
    offsets = [correction.offset_dn for correction in learnt.corrections.values()]
    assert -0.8 < np.median(offsets) < -0.1
