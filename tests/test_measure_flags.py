"""Bad sessions: a flag or an error, never a silent number. And what the light beyond the frame and the glare do."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from builders import film

from bssrdf.errors import InputError
from bssrdf.measure.calibrate import calibrate_camera
from bssrdf.measure.session import measure_session
from bssrdf.measure.total_errors import speckle_rel_sd
from bssrdf.session.frames_csv import read_frames, write_frames
from bssrdf.session.hdr_image import write_hdr_exr
from bssrdf.session.records import Beam, Camera, Frame, Geometry, Material, Reference, Session
from bssrdf.session.slice_csv import read_slice

EXPOSURES_S = [0.001 * 3**k for k in range(8)]
BLACK, WHITE, GAIN, READ_NOISE_E = 500, 16383, 2.0, 3.0
MM_PER_PX, VIEW_DEG = 0.1, 45.0
SHAPE = (90, 120)
CENTRE = (61.2, 44.7)


def gaussians(r_mm):
    return 0.5 * np.exp(-((r_mm / 0.8) ** 2)) + 0.02 * np.exp(-((r_mm / 2.0) ** 2))


def tile(r_mm):
    return 0.8 * np.exp(-((r_mm / 0.6) ** 2))


RHO = 0.5
TOTAL = RHO * (0.5 * 0.8**2 + 0.02 * 2.0**2) / (0.8 * 0.6**2)


def picture(curve, centre=CENTRE):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    along = (y - centre[1]) / np.cos(np.radians(VIEW_DEG))
    return curve(MM_PER_PX * np.hypot(x - centre[0], along))


class Bench:
    """Pictures by kind, and what is done to each frame of a session before it is written."""

    def __init__(self, seed=0):
        self.rng = np.random.default_rng(seed)
        self.pictures = {"sample": picture(gaussians), "reference": picture(tile)}
        self.time_error = dict.fromkeys(EXPOSURES_S, 0.0)
        self.repeats = 1
        self.e_per_s = 0.75 * (WHITE - BLACK) * GAIN / EXPOSURES_S[0] / 0.8

    def light(self, kind, number, repeat):
        return self.pictures.get(kind, np.zeros(SHAPE))

    def write(self, path: Path, **beam) -> Session:
        session = Session(
            path,
            Camera("mono", BLACK, WHITE),
            Material("wax", 1.4),
            Geometry(MM_PER_PX, view_angle_deg=VIEW_DEG, view_angle_sd_deg=0.2, mm_per_px_rel_sd=0.001),
            Beam(**beam),
            Reference("tile", (RHO,), (0.0,)),
        )
        noise = {"gain_e_per_dn": GAIN, "read_noise_e": READ_NOISE_E}
        true_s = [exposure_s * (1 + self.time_error[exposure_s]) for exposure_s in EXPOSURES_S]
        return film(
            session,
            lambda *which: self.e_per_s * self.light(*which),
            EXPOSURES_S,
            self.rng,
            true_s=true_s,
            repeats=self.repeats,
            **noise,
        )


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    session = Bench().write(tmp_path_factory.mktemp("flags") / "plain")
    return session, measure_session(session)


def test_a_clean_session_raises_no_flag(plain):
    assert plain[1].slice.flags == ()
    assert plain[1].slice.total_r["mono"] == pytest.approx(TOTAL, rel=0.01)
    assert plain[1].slice.total_r["mono"] == pytest.approx(TOTAL, abs=4 * plain[1].slice.total_r_sd["mono"])


def test_gain_and_noise_come_from_the_frames(plain):
    found = calibrate_camera(plain[0])
    assert found.camera.gain_e_per_dn == pytest.approx(GAIN, rel=0.1)
    assert found.camera.read_noise_e == pytest.approx(READ_NOISE_E, rel=0.3)
    assert found.nonlinearity < 0.01


def test_the_order_of_the_lines_changes_no_bit(plain, tmp_path):
    session, measured = plain
    frames = read_frames(session.path)
    write_frames(session.path, [frames[i] for i in np.random.default_rng(0).permutation(len(frames))])
    again = measure_session(session)
    write_frames(session.path, frames)
    np.testing.assert_array_equal(again.images["sample"].radiance, measured.images["sample"].radiance)
    np.testing.assert_array_equal(again.slice.channels["mono"].rd_per_mm2, measured.slice.channels["mono"].rd_per_mm2)


def test_labels_off_by_five_percent_are_put_right_and_flagged(tmp_path):
    bench = Bench()
    bench.time_error = dict(zip(EXPOSURES_S, np.random.default_rng(3).choice([-0.05, 0.05], 8), strict=True))
    curve = measure_session(bench.write(tmp_path / "labels")).slice
    assert "exposure_labels_off" in curve.flags
    assert curve.total_r["mono"] == pytest.approx(TOTAL, rel=0.01)


def test_a_copied_frame_is_merged_once_and_flagged(tmp_path):
    session = Bench().write(tmp_path / "copy")
    once = measure_session(session)
    (session.path / "frames/copy.tif").write_bytes((session.path / "frames/sample_5.tif").read_bytes())
    write_frames(session.path, [*read_frames(session.path), Frame("frames/copy.tif", "sample", EXPOSURES_S[5])])
    twice = measure_session(session)
    assert "duplicate_frame" in twice.slice.flags
    np.testing.assert_array_equal(twice.images["sample"].variance, once.images["sample"].variance)


def test_a_sample_that_moved_is_flagged_or_refused(tmp_path):
    class Moving(Bench):
        by_px = 0.4

        def light(self, kind, number, repeat):
            if kind == "sample" and number >= 4:
                return picture(gaussians, (CENTRE[0] + self.by_px, CENTRE[1]))
            return super().light(kind, number, repeat)

    assert "moved" in measure_session(Moving().write(tmp_path / "moved")).slice.flags
    Moving.by_px = 2.0
    with pytest.raises(InputError, match=r"sample_4\.tif: the picture moved by about [12]\.\d px"):
        measure_session(Moving().write(tmp_path / "moved far"))


def test_two_spots_are_flagged(tmp_path):
    bench = Bench()
    bench.pictures["sample"] = bench.pictures["sample"] + 0.3 * picture(gaussians, (100.0, 20.0))
    assert "second_spot" in measure_session(bench.write(tmp_path / "two")).slice.flags


def test_the_line_of_light_scattered_once_is_no_second_spot(tmp_path):
    bench = Bench()
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    ahead = y - CENTRE[1]
    bench.pictures["sample"] = bench.pictures["sample"] + np.where(
        (ahead > 0) & (abs(x - CENTRE[0]) < 1.5), 0.5 * np.exp(-np.maximum(ahead, 0) / 15), 0
    )
    assert "second_spot" not in measure_session(bench.write(tmp_path / "line")).slice.flags


def test_a_lamp_that_drifts_between_repeats_widens_the_error_of_the_total(plain, tmp_path):
    class Drifting(Bench):
        def light(self, kind, number, repeat):
            return super().light(kind, number, repeat) * (1 + 0.03 * repeat)

    bench = Drifting()
    bench.repeats = 2
    curve = measure_session(bench.write(tmp_path / "drift")).slice
    assert "drift" in curve.flags
    assert curve.total_r_sd["mono"] / curve.total_r["mono"] > 0.02


def test_laser_speckle_of_the_tile_goes_into_the_total(tmp_path):
    curve = measure_session(
        Bench().write(tmp_path / "laser", kind="laser", channels=("633nm",), spot_radius_mm=0.15)
    ).slice
    assert "speckle" in curve.flags
    assert curve.total_r_sd["633nm"] / curve.total_r["633nm"] == pytest.approx(0.15, abs=0.02)


def test_speckle_shrinks_with_a_wider_lens(plain):
    session = plain[0]
    wide = replace(session, camera=Camera(aperture_mm=25.0), geometry=replace(session.geometry, distance_mm=150.0))
    assert speckle_rel_sd(0.15, "633nm", wide) == pytest.approx(speckle_rel_sd(0.15, "633nm", session) / 8)


def test_a_saturated_spot_has_a_curve_but_no_total(tmp_path):
    bench = Bench()
    bench.pictures["sample"] = 3 * bench.pictures["sample"]
    curve = measure_session(bench.write(tmp_path / "saturated")).slice
    assert "saturated" in curve.flags
    assert curve.total_r == {}
    assert len(curve.channels["mono"].r_mm) > 20


def test_a_beam_outside_of_the_frame_is_an_error(tmp_path):
    bench = Bench()
    bench.pictures["sample"] = picture(gaussians, (-4.0, 45.0))
    with pytest.raises(InputError, match=r"sample: the brightest point .* lies on the edge"):
        measure_session(bench.write(tmp_path / "outside"))


def test_a_dark_brighter_than_its_frame_is_an_error(tmp_path):
    session = Bench().write(tmp_path / "dark")
    dark = tifffile.imread(session.path / "frames/sample_dark_3.tif")
    tifffile.imwrite(session.path / "frames/sample_dark_3.tif", dark + 300)
    with pytest.raises(InputError, match=r"sample_3.tif: its dark frame is brighter"):
        measure_session(session)


def test_a_lower_plateau_than_the_white_level_is_found(tmp_path):
    session = Bench().write(tmp_path / "plateau")
    for file in (session.path / "frames").glob("*.tif"):
        tifffile.imwrite(file, np.minimum(tifffile.imread(file), 13_000))
    assert calibrate_camera(session).camera.white == pytest.approx(13_000, rel=0.02)
    assert measure_session(session).slice.total_r["mono"] == pytest.approx(TOTAL, rel=0.015)


def test_images_that_another_tool_merged_go_the_same_way(plain, tmp_path):
    session, measured = plain
    frames = []
    (tmp_path / "elsewhere").mkdir()
    for kind, hdr in measured.images.items():
        write_hdr_exr(tmp_path / "elsewhere" / f"{kind}.exr", vars(hdr), {})
        frames.append(Frame(f"{kind}.exr", f"{kind}_hdr", 1.0))
    write_frames(tmp_path / "elsewhere", frames)
    other = Session(
        tmp_path / "elsewhere", Camera(), session.material, session.geometry, session.beam, session.reference
    )
    curve = measure_session(other).slice
    assert curve.total_r["mono"] == pytest.approx(measured.slice.total_r["mono"], rel=1e-3)
    ours, theirs = measured.slice.channels["mono"], curve.channels["mono"]
    np.testing.assert_allclose(theirs.rd_per_mm2[:20], ours.rd_per_mm2[:20], rtol=1e-3)
    assert np.all(theirs.sd_per_mm2[:20] > 0)
    rough = measure_session(other, hdr_rel_sd=0.3).slice.channels["mono"]
    np.testing.assert_array_equal(rough.rd_per_mm2[3:20] > 0, True)
    assert np.all(rough.sd_per_mm2[3:20] > 0.99 * theirs.sd_per_mm2[3:20])
    assert np.median(rough.sd_per_mm2[3:20] / theirs.sd_per_mm2[3:20]) > 3


def test_a_material_that_is_left_unnamed_is_flagged_until_it_is_named(plain):
    session, measured = plain
    unnamed = replace(session, material=replace(session.material, name="unnamed"))
    assert measure_session(unnamed).slice.flags == ("unnamed", *measured.slice.flags)
    assert measure_session(session, from_hdr=True).slice.flags == measured.slice.flags


def test_a_flat_field_takes_vignetting_out(tmp_path):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    vignette = 1 - 0.3 * np.hypot((x - 60) / 60, (y - 45) / 45) ** 2 / 2
    bench = Bench()
    bench.pictures = {kind: image * vignette for kind, image in bench.pictures.items()}
    session = bench.write(tmp_path / "flat")
    bench.pictures = {"flat": 0.3 * vignette}
    frames = read_frames(session.path)
    for kind in ("flat", "flat_dark"):
        for repeat in range(4):
            mean = bench.e_per_s * bench.pictures.get(kind, np.zeros(SHAPE)) * 0.001
            dn = np.rint((bench.rng.poisson(mean) + bench.rng.normal(0, 3, SHAPE)) / GAIN) + BLACK
            tifffile.imwrite(session.path / f"frames/{kind}{repeat}.tif", dn.astype(np.uint16))
            frames.append(Frame(f"frames/{kind}{repeat}.tif", kind, 0.001))
    write_frames(session.path, frames)
    part = measure_session(session).slice.channels["mono"]
    bright = (part.r_mm > 0.3) & (part.r_mm < 3.0)
    truth = RHO * gaussians(part.r_mm) / (np.pi * 0.8 * 0.6**2)
    assert np.sqrt(np.mean((part.rd_per_mm2 / truth - 1)[bright] ** 2)) < 0.04


def test_errors_that_are_not_stated_are_assumed_flagged_and_never_zero(plain):
    session, measured = plain
    assert measured.slice.mm_rel_sd == 0.001
    bare = replace(session, geometry=Geometry(MM_PER_PX, view_angle_deg=VIEW_DEG), reference=Reference("tile", (RHO,)))
    curve = measure_session(bare).slice
    assert set(curve.flags) == {"reflectance_sd_assumed", "scale_sd_assumed", "view_angle_sd_assumed"}
    assert (curve.mm_rel_sd, curve.view_angle_sd_deg) == (0.005, 1.0)
    assert curve.scale_rel_sd == pytest.approx(np.hypot(measured.slice.scale_rel_sd, 0.01))


def test_sessions_against_one_reference_name_the_errors_they_share(plain, tmp_path):
    own, twin, other = (Bench(seed).write(tmp_path / str(number)) for number, seed in enumerate((0, 1, 2)))
    for frame in read_frames(own.path):
        if frame.kind == "reference":
            (twin.path / frame.file).write_bytes((own.path / frame.file).read_bytes())
    shared = [measure_session(session).slice.shared_errors for session in (own, twin, other)]
    assert shared[0] == shared[1] != shared[2]
    assert read_slice(own.path / "measured/slice.csv").shared_errors == shared[0]
