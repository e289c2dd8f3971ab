"""Frames at fault are refused by name, or the intervals of R hold; levels come from the data; repeats only help."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import tifffile
from builders import film

from bssrdf.bench.frame_faults import EXPOSURES_S, FAULTS, PLAIN, Setup, good, scene, session_of, write_session
from bssrdf.bench.frames import run_frames_bench, trial, true_slice
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError
from bssrdf.measure.session import measure_session
from bssrdf.session.frames_csv import read_frames, write_frames
from bssrdf.session.records import Camera

SETUP = PLAIN
LEAST_HELD = 3.0
"""Standard errors: two seeds of each fault are no statistics, `bssrdf bench frames` makes them."""


@pytest.fixture(scope="module")
def truth():
    return true_slice(SETUP)


@pytest.mark.parametrize("fault", ["good", "lamp", "flicker", "black", "darks"])
def test_what_can_be_measured_is_within_its_error(fault, truth):
    for seed in (4, 5):
        found = trial(fault, seed, truth, SETUP)
        assert found.refused is None
        assert np.abs(found.total_z).max() < LEAST_HELD
        assert np.abs(np.concatenate(found.decade_z)).max() < LEAST_HELD + 0.5


@pytest.mark.parametrize(
    "setup",
    [Setup(spot_aspect=1.4), Setup(spread_aspect=1.3), Setup("ketchup", incidence_deg=30.0)],
    ids=["elliptical spot", "fibres", "oblique beam"],
)
def test_a_good_session_of_another_make_is_measured_within_its_error(setup, tmp_path):
    found = measure_session(write_session(tmp_path / "s", good, 7, setup)).slice
    off = found.total_r["G"] - true_slice(setup).total_r["G"]
    assert abs(off) < LEAST_HELD * found.total_r_sd["G"]


@pytest.mark.parametrize("fault", ["stale", "exchanged"])
def test_a_frame_of_another_exposure_is_refused_by_name(fault, truth):
    for seed in (0, 1):
        refused = trial(fault, seed, truth, SETUP).refused
        assert refused
        assert refused.startswith(("frames/sample_", "frames/reference_"))
        assert "\n" not in refused


def test_a_bracket_that_lags_by_one_frame_is_refused_though_few_pixels_are_bright_in_the_shortest(tmp_path):
    def lagging(frames, rng):
        return [replace(f, exposure_s=EXPOSURES_S[max(f.number - 1, 0)]) if f.kind == "sample" else f for f in frames]

    with pytest.raises(InputError, match=r"sample_1_0\.tif: shows the same light as .*sample_0_0\.tif"):
        measure_session(write_session(tmp_path / "lag", lagging, 0))


def test_the_light_of_a_tile_in_a_small_frame_hides_no_black_offset(tmp_path):
    """White, it departs from the form of diffusion by some tenths of a percent, and its R does not tell its decay."""
    close_up = replace(scene(Setup("skin1")), mm_per_px=0.06, spot_radius_mm=0.2)
    light = close_up.photo_currents()
    (truth,) = close_up.radiance_factors(close_up.sample)
    session = session_of(tmp_path, Camera("mono", 512.0, 16383.0), Setup("skin1"))
    session = replace(
        session,
        geometry=replace(session.geometry, mm_per_px=0.06),
        reference=replace(session.reference, reflectance=close_up.radiance_factors(close_up.tile)),
    )
    for seed in range(4):
        rng = np.random.default_rng(seed)
        of_seed = replace(session, path=tmp_path / str(seed))
        film(of_seed, lambda kind, *_: light.get(kind, 0 * light["sample"]), EXPOSURES_S, rng, gain_e_per_dn=4.0)
        found = measure_session(of_seed).slice
        assert "black_offset" not in found.flags
        assert abs(found.total_r["G"] - truth) < LEAST_HELD * found.total_r_sd["G"]


def test_files_that_are_gamma_coded_are_refused_with_the_power_that_was_found(tmp_path):
    session = write_session(tmp_path / "gamma", good, 0)
    for file in (session.path / "frames").glob("*.tif"):
        share = np.clip(tifffile.imread(file) / 16383.0 - 512 / 16383, 0, 1)
        tifffile.imwrite(file, np.rint(65535 * share ** (1 / 2.2)).astype(np.uint16))
    session = replace(session, camera=Camera("mono"))
    with pytest.raises(InputError, match=r"rise as the power 0\.4\d of the exposure.*gamma-coded"):
        measure_session(session)


def in_container(session, convert, camera):
    """The session with every file's values converted, and nothing said of black and white but by `camera`."""
    for file in (session.path / "frames").glob("*.tif"):
        tifffile.imwrite(file, convert(tifffile.imread(file)))
    return replace(session, camera=camera)


def clipped_by(share):
    def convert(dn):
        return np.minimum(dn, round(512 + share * (16383 - 512))).astype(np.uint16)

    return convert


@pytest.mark.parametrize(
    ("name", "convert"),
    [
        ("14 bits low", lambda dn: dn),
        ("14 bits high", lambda dn: dn << 2),
        ("14 bits spread over 16", lambda dn: np.rint(dn * (65535 / 16383)).astype(np.uint16)),
        ("float 0 to 1", lambda dn: (dn / 16383).astype(np.float32)),
        ("float in any unit", lambda dn: (37.2 * dn).astype(np.float32)),
        ("clips early", clipped_by(0.8)),
    ],
)
def test_levels_and_steps_come_from_the_data_whatever_holds_them(tmp_path, truth, name, convert):
    session = in_container(write_session(tmp_path / "s", good, 5), convert, Camera("mono"))
    plain = measure_session(write_session(tmp_path / "plain", good, 5)).slice
    found = measure_session(session).slice
    assert found.total_r["G"] == pytest.approx(plain.total_r["G"], rel=0.002)
    assert found.total_r_sd["G"] == pytest.approx(plain.total_r_sd["G"], rel=0.3)
    assert not {"gain_unknown", "nonlinear", "white_unseen"} & set(found.flags)


def test_colours_that_clip_apart_are_told_apart(tmp_path):
    session = write_session(tmp_path / "rgb", good, 6)
    for file in (session.path / "frames").glob("*.tif"):
        dn = tifffile.imread(file)
        apart = [np.minimum(dn, limit) for limit in (12_000, 16_383, 14_000)]
        tifffile.imwrite(file, np.stack(apart, axis=-1).astype(np.uint16), photometric="rgb")
    session = replace(session, camera=Camera("rgb"), beam=replace(session.beam, channels=None))
    found = measure_session(session).slice
    saturation = found.provenance["sensor"]["saturations_dn"]
    assert saturation == pytest.approx([12_000, 16_383, 14_000], rel=0.012)
    for channel in "RB":
        assert found.total_r[channel] == pytest.approx(found.total_r["G"], rel=0.002)


def test_steps_coarser_than_noise_are_allowed_for(tmp_path, truth):
    """10 bits of a quiet camera, and no exposure that lifts the faint light over half a step."""
    session = write_session(tmp_path / "s", good, 7)
    short = [f for f in read_frames(session.path) if f.exposure_s < 0.1]
    write_frames(session.path, short)
    found = measure_session(in_container(session, lambda dn: dn >> 4, Camera("mono"))).slice
    assert "coarse_steps" in found.flags
    assert abs(found.total_r["G"] - truth.total_r["G"]) < 2 * found.total_r_sd["G"]


def test_a_white_that_no_frame_reaches_is_said_to_be_unseen(tmp_path):
    session = write_session(tmp_path / "s", good, 8)
    write_frames(session.path, [f for f in read_frames(session.path) if f.exposure_s < 0.005])
    assert "white_unseen" in measure_session(session).slice.flags


def test_repeats_tell_the_gain_and_never_make_r_less_certain(tmp_path):
    sds, gains = [], []
    for repeats in (1, 2, 4):
        found = measure_session(write_session(tmp_path / str(repeats), good, 9, repeats=repeats)).slice
        assert not {"drift", "gain_unknown"} & set(found.flags)
        sds.append(found.total_r_sd["G"])
        gains.append(found.provenance["sensor"]["gain_e_per_dn"])
    assert sds[2] <= 1.02 * sds[1] <= 1.02 * 1.02 * sds[0]
    assert gains == pytest.approx([scene().sensor.gain_e_per_dn] * 3, rel=0.04)


def test_the_bench_says_what_it_saw(tmp_path):
    trials = run_frames_bench(seeds=1, faults=("good",), out=tmp_path / "out")
    assert [t.fault for t in trials] == ["good"]
    assert (tmp_path / "out/frames.json").exists()
    assert run(cli, ["bench", "frames", "--fault", "rain"]) == 2


def test_an_r_beyond_white_names_what_the_frames_show(tmp_path):
    def dim(frames, rng):
        return [replace(f, light=f.light / 2) if f.kind == "reference" else f for f in FAULTS["lamp"](frames, rng)]

    session = write_session(tmp_path / "s", dim, 1)
    session = replace(session, reference=replace(session.reference, reflectance=(1.19,), reflectance_sd=(0.001,)))
    with pytest.raises(InputError, match=r"beyond what a sample can reflect; mend what the frames show: "):
        measure_session(session)
