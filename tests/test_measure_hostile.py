"""Files of other people that are not what they seem: measured right, or refused by the true cause."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile
from numpy.typing import NDArray

from bssrdf.bench.frame_faults import EXPOSURES_S, good, scene, write_session
from bssrdf.calib.counts import step_dn
from bssrdf.calib.exposures import LocalRatios
from bssrdf.calib.frame_model import Exposures
from bssrdf.calib.surface import Surface
from bssrdf.errors import InputError
from bssrdf.measure.frame_checks import uneven_light
from bssrdf.measure.hdr import Hdr
from bssrdf.measure.image import Image
from bssrdf.measure.levels import Level
from bssrdf.measure.profile import RadialProfile
from bssrdf.measure.session import measure_session
from bssrdf.measure.slice import SliceOptions, measure_slice
from bssrdf.measure.tail import Boundary, Surroundings, Tail, fit_tail
from bssrdf.session.constancy import check_constant
from bssrdf.session.records import Beam, Camera, Card, Frame, Geometry, Material, Reference, Session, Slice

LAST = len(EXPOSURES_S) - 1


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Session]:
    path = tmp_path_factory.mktemp("hostile") / "whole"
    return path, write_session(path, good, seed=1)


@pytest.fixture
def session(whole: tuple[Path, Session], tmp_path: Path) -> Session:
    shutil.copytree(whole[0], tmp_path / "s")
    return replace(whole[1], path=tmp_path / "s")


def change(session: Session, name: str, how: Callable[[NDArray], NDArray]) -> None:
    for file in sorted((session.path / "frames").glob(name)):
        tifffile.imwrite(file, how(tifffile.imread(file)))


def holds(found: Slice | None) -> bool:
    bench = scene()
    (truth,) = bench.radiance_factors(bench.sample)
    assert found is not None
    return abs(found.total_r["G"] - truth) < 3 * found.total_r_sd["G"]


def refused(session: Session, cause: str) -> None:
    with pytest.raises(InputError, match=cause):
        measure_session(session)


@pytest.mark.parametrize("kind", ["sample", "sample_dark", "reference"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_pixels_that_hold_no_number_are_left_out(session: Session, kind: str, value: float) -> None:
    rng = np.random.default_rng(0)

    def spoilt(raw: NDArray) -> NDArray:
        return np.where(rng.random(raw.shape) < 1e-3, np.float32(value), raw.astype(np.float32))

    change(session, f"{kind}_[0-9]*", spoilt)
    assert holds(measure_session(session).slice)


def test_pixels_without_a_number_in_any_frame_are_counted(session: Session) -> None:
    def spoilt(raw: NDArray) -> NDArray:
        raw = raw.astype(np.float32)
        raw[20:23, 30:35] = np.nan
        return raw

    change(session, "sample_[0-9]*", spoilt)
    measured = measure_session(session)
    assert holds(measured.slice)
    assert measured.slice is not None
    assert "missing_pixels" in measured.slice.flags
    assert measured.provenance["found"]["missing_pixels"] == "15 of the sample"


def test_frame_of_no_number_at_all_is_refused_by_name(session: Session) -> None:
    change(session, "reference_2_*", lambda raw: np.full(raw.shape, np.nan, np.float32))
    refused(session, r"reference_2_0\.tif: holds no number")


@pytest.mark.parametrize("unit", [1e-24, 1e18, 1e40])
def test_numbers_whose_squares_single_precision_loses_are_refused(session: Session, unit: float) -> None:
    change(session, "*", lambda raw: raw * unit)
    refused(replace(session, camera=Camera("mono")), "largest number is .*; scale all frames|holds no number that")


@pytest.mark.parametrize(("kind", "number"), [("sample", 0), ("sample", LAST), ("reference", 3)])
def test_frame_without_light_is_refused_by_name(session: Session, kind: str, number: int) -> None:
    rng = np.random.default_rng(0)
    frames = session.path / "frames"
    dark = tifffile.imread(frames / f"{kind}_dark_{number}_0.tif")
    tifffile.imwrite(frames / f"{kind}_{number}_0.tif", rng.permutation(dark, axis=0))
    refused(session, rf"{kind}_{number}_0\.tif: shows hardly any light|times the light of .*{kind}_{number}_0\.tif")


@pytest.mark.parametrize("of", ["reference_5_0", "sample_4_0", "sample_dark_5_0"])
def test_copy_of_a_file_that_it_cannot_be_is_refused(session: Session, of: str) -> None:
    frames = session.path / "frames"
    shutil.copy(frames / f"{of}.tif", frames / "sample_5_0.tif")
    refused(session, "once more, byte for byte")


def test_darks_of_one_value_are_no_copies(session: Session) -> None:
    """A camera of coarse steps shows one value in the dark, whatever the exposure."""
    change(session, "*", lambda raw: (raw // 64).astype(np.uint8))
    session = replace(session, camera=replace(session.camera, black=8.0, white=255.0))
    found = measure_session(session).slice
    assert holds(found)
    assert found is not None
    assert "coarse_steps" in found.flags


def test_dark_that_no_camera_took_is_refused(session: Session) -> None:
    change(session, "sample_dark_*", lambda raw: np.full_like(raw, 512))
    refused(session, r"sample_dark_0_0\.tif: shows one value in nearly all pixels")


@pytest.mark.parametrize("offset", [20, 400])
def test_darks_of_another_black_are_named(session: Session, offset: int) -> None:
    change(session, "sample_dark_*", lambda raw: raw - offset)
    refused(session, rf"sample_0_0\.tif: lies {offset // 10 - 1}\d DN above its dark even where it is darkest")


def test_frame_cut_off_is_refused(session: Session) -> None:
    def cut(raw: NDArray) -> NDArray:
        return np.where(np.arange(len(raw))[:, None] < 150, raw, 0).astype(raw.dtype)

    change(session, f"sample_{LAST}_*", cut)
    refused(session, rf"sample_{LAST}_0\.tif: 25 % of its pixels lie far below its dark")


def test_half_open_shutter_is_refused(session: Session) -> None:
    frames = session.path / "frames"
    dark = tifffile.imread(frames / f"sample_dark_{LAST}_0.tif")
    change(session, f"sample_{LAST}_*", lambda raw: np.where(np.arange(len(raw))[:, None] < 97, dark, raw))
    refused(session, rf"sample_{LAST}_0\.tif: shows (around pixel|1)")


def test_place_of_a_fault_is_that_in_the_frame_though_few_of_its_rows_are_compared() -> None:
    """Light that fails below row 3000 of a frame of which one row in ten is looked at."""
    rows = np.arange(0, 4000, 10)
    level = Level(1.0, ["frame.tif"], np.zeros(0, np.float32), 0.0, np.zeros(0), 1, rows)
    place = np.stack(np.meshgrid(np.arange(0, 400, 4), np.arange(0, 400, 4), indexing="ij"), axis=-1).reshape(-1, 2)
    log = np.where(rows[place[:, 0]] > 3000, np.log(4.0), 0.0)
    (line,) = uneven_light(level, level, LocalRatios(log, place), 0.0)
    assert re.search(r"around pixel \(198, 3\d\d\d\)", line)


def bright(rows: slice, columns: slice) -> Callable[[NDArray], NDArray]:
    """Saturated at a place."""

    def how(raw: NDArray) -> NDArray:
        out = raw.copy()
        out[rows, columns] = scene().sensor.white_dn
        return out

    return how


@pytest.mark.parametrize("kind", ["sample", "reference"])
def test_a_glint_that_saturates_throughout_is_left_out_and_said(session: Session, kind: str) -> None:
    change(session, f"{kind}_[0-9]*", bright(slice(40, 42), slice(60, 63)))
    found = measure_session(session).slice
    assert holds(found)
    assert found is not None
    assert "glint" in found.flags
    assert "saturated" not in found.flags


def test_a_pixel_that_is_stuck_at_white_in_the_dark_too_is_hot_and_no_glint(session: Session) -> None:
    change(session, "*", bright(slice(40, 41), slice(60, 61)))
    found = measure_session(session).slice
    assert holds(found)
    assert found is not None
    assert not {"glint", "saturated"} & set(found.flags)


def test_rows_that_are_dead_in_the_dark_too_tell_nothing(session: Session) -> None:
    change(session, "*", lambda raw: np.where(np.arange(len(raw))[:, None] % 50 == 7, 0, raw).astype(np.uint16))
    assert holds(measure_session(session).slice)


@pytest.mark.parametrize("gain", [1.26, 2.0])
@pytest.mark.parametrize("kind", ["sample", "reference"])
def test_kinds_of_frames_whose_noise_is_of_different_gains_are_refused(
    session: Session, kind: str, gain: float
) -> None:
    """Another ISO, in files that do not say it."""
    black, white = scene().sensor.black_dn, scene().sensor.white_dn
    rng = np.random.default_rng(0)

    def amplified(raw: NDArray) -> NDArray:
        return np.clip(np.floor(black + gain * (raw - float(black)) + rng.random(raw.shape)), 0, white).astype(
            np.uint16
        )

    change(session, f"{kind}_*", amplified)
    refused(session, rf"{kind}_0_0\.tif: a DN of the {kind} is .* electrons by its noise")


@pytest.mark.parametrize("kind", ["sample", "reference"])
def test_numbers_at_the_high_end_of_a_container_beside_others_at_its_low_end_are_refused(
    session: Session, kind: str
) -> None:
    change(session, f"{kind}_*", lambda raw: raw * 4)
    session = replace(session, camera=replace(session.camera, black=None, white=None))
    refused(session, "or their numbers were scaled|beyond what a sample can reflect")


@pytest.mark.parametrize("boils", [0.01, 0.015, 0.02, 0.03])
def test_light_that_boils_is_no_other_gain(session: Session, boils: float) -> None:
    """Speckle of a laser on milk: its noise rises with the square of the light."""
    black, white = scene().sensor.black_dn, scene().sensor.white_dn
    rng = np.random.default_rng(0)

    def boiling(raw: NDArray) -> NDArray:
        light = (raw - float(black)) * (1 + boils * rng.standard_normal(raw.shape))
        return np.where(raw >= white, white, np.clip(np.rint(black + light), 0, white)).astype(np.uint16)

    change(session, "sample_[0-9]*", boiling)
    assert holds(measure_session(session).slice)


def test_a_glint_in_the_spot_itself_is_saturation(session: Session) -> None:
    height, width = scene().sensor.shape
    change(session, "sample_[0-9]*", bright(slice(height // 2, height // 2 + 1), slice(width // 2, width // 2 + 1)))
    found = measure_session(session).slice
    assert found is not None
    assert not found.total_r
    assert "saturated" in found.flags


def test_spot_that_lies_beside_that_of_a_coplanar_tile_is_refused(session: Session) -> None:
    change(session, "reference_*", lambda raw: np.roll(raw, 3, axis=1))
    refused(session, r"sample: its spot lies 0\.4\d mm across the view")


@pytest.mark.parametrize("power", [0.9, 1.1])
def test_mild_gamma_is_named(session: Session, power: float) -> None:
    black, white = float(session.camera.black or 0), float(session.camera.white or 0)

    def coded(raw: NDArray) -> NDArray:
        share = np.clip((raw - black) / (white - black), 0, None)
        return np.rint(black + (white - black) * share**power).astype(np.uint16)

    change(session, "[sr]*_[0-9]_0.tif", coded)
    refused(session, rf"rise as the power {power:.1f}")


@pytest.mark.parametrize("scale", [65535 / 1023, 65535 / 4095, 16.0, 1.0])
def test_step_of_data_scaled_to_a_container_is_that_of_the_camera(scale: float) -> None:
    rng = np.random.default_rng(0)
    camera = np.clip(np.rint(rng.normal(64, 2.0, (200, 300)) + rng.exponential(20, (200, 300))), 0, 1023)
    stored = np.rint(scale * camera).astype(np.uint16)
    stored[5, 5:15] = np.rint(stored[5, 4:14] / 2.0 + stored[5, 6:16] / 2.0)  # pixels interpolated by the camera
    assert step_dn(stored) == pytest.approx(scale, abs=1)
    assert step_dn(stored.astype(np.float32) / 65535) == pytest.approx(scale / 65535, rel=0.02, abs=1 / 65535)


def test_the_whiter_a_medium_the_less_its_total_tells_of_its_decay() -> None:
    around = Surroundings(1.35, 0.0, 45.0, 0.0)
    darker, brighter, white = (around.attenuation_rel_sd(total) for total in (0.2, 0.9, 1.01))
    assert darker < brighter / 2 < white == np.inf


def test_floor_deeper_than_the_curve_is_found() -> None:
    """Darks with more dark current than the frames lower each pixel by the same radiance."""
    r = np.linspace(0.5, 20, 80)
    boundary = Boundary(2.5, 0.9)
    true = Tail(1.0, 0.5, 0.6, 0.0, boundary)
    depth = -5 * float(true(r)[40])
    sd = 1e-3 * np.abs(depth) * np.ones_like(r)
    value = true(r) + depth + np.random.default_rng(0).normal(size=r.size) * sd
    fit = fit_tail(RadialProfile(r - 0.1, r + 0.1, value, sd, np.ones_like(r)), 20.0, boundary, with_floor=True)
    assert fit is not None
    floor = fit.estimate(lambda tail: tail.floor)
    assert abs(floor.value - depth) < 3 * floor.sd < 0.05 * abs(depth)


MM, VIEW = 0.1, 45.0


def spot_image(name: str, layout: str, radius_mm: float, share: float, centre: tuple[float, float]) -> Image:
    y, x = np.mgrid[:120, :160].astype(float)
    r = MM * np.hypot(x - centre[0], (y - centre[1]) / np.cos(np.radians(VIEW)))
    light = (share * np.exp(-2 * (r / radius_mm) ** 2) / radius_mm**2).astype(np.float32)
    none = np.zeros(light.shape, np.uint8)
    hdr = Hdr(light, (1e-4 * light) ** 2 + np.float32(1e-12), none.astype(np.uint16), none)
    return Image(name, hdr, layout, ("R", "G", "B"), Surface(Geometry(MM, view_angle_deg=VIEW)))


@pytest.mark.parametrize("layouts", [("RGGB", "RGGB"), ("RGGB", "BGGR"), ("GRBG", "GBRG")])
@pytest.mark.parametrize("centre", [(80.3, 60.1), (79.9, 60.9)])
def test_error_of_a_spot_between_the_filters_is_stated(layouts: tuple[str, str], centre: tuple[float, float]) -> None:
    sample = spot_image("sample", layouts[0], 0.5, 0.6, centre)
    reference = spot_image("reference", layouts[1], 0.24, 1.0, centre)
    session = Session(
        Path(),
        Camera(layouts[0]),
        Material("wax", 1.4),
        Geometry(MM, mm_per_px_rel_sd=1e-3, view_angle_deg=VIEW, view_angle_sd_deg=0.1),
        Beam(spot_radius_mm=0.24),
        Reference("tile", (0.8,), (1e-6,)),
    )
    found = measure_slice(session, sample, reference, {}, Exposures(), SliceOptions())
    for channel, total in found.total_r.items():
        assert abs(total - 0.6 * 0.8) < 2.5 * found.total_r_sd[channel]
    assert "narrow_spot" in found.flags


def frame(kind: str, label_s: float, file_s: float | None, measured_s: float | None = None) -> Frame:
    name = f"{kind}_{label_s}.dng"
    return Frame(name, kind, label_s, measured_s, card=Card(file_exposure_s=file_s))  # type: ignore[arg-type]


def bracket(kind: str, factor: float) -> list[Frame]:
    return [frame(kind, t, factor * t) for t in (0.001, 0.004, 0.016)]


def test_darks_of_another_exposure_by_their_files_are_refused() -> None:
    frames = [*bracket("sample", 1.0), *bracket("sample_dark", 0.25)]
    with pytest.raises(InputError, match=re.escape("sample_dark_0.001.dng: was exposed for 0.00025 s by its own file")):
        check_constant(frames, Path())
    check_constant([*bracket("sample", 1.03), *bracket("sample_dark", 1.0)], Path())


def test_labels_that_all_differ_from_the_files_are_refused() -> None:
    frames = [*bracket("sample", 2.0), *bracket("dark", 2.0)]
    with pytest.raises(InputError, match=re.escape("sample_0.001.dng: was exposed for 0.002 s by its own file")):
        check_constant(frames, Path())


def test_shutter_before_the_lens_decides_the_exposure_and_not_the_camera() -> None:
    """The camera is open for one long time, the shutter for the label, or for the time that it measured."""
    check_constant([frame("sample", t, 10.0) for t in (0.001, 0.01, 0.1)], Path())
    check_constant([frame("sample", t, 2 * t, measured_s=t) for t in (0.001, 0.01, 0.1)], Path())


def test_image_in_its_own_unit_is_not_compared_with_frames(session: Session, whole: tuple[Path, Session]) -> None:
    """An EXR of another tool is refused beside frames; one that was measured, in DN/s as they are, serves."""
    measure_session(session)
    lines = (session.path / "frames.csv").read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if ",reference" not in line]
    (session.path / "frames.csv").write_text("\n".join([*kept, "tile.exr,reference_hdr,1", ""]), encoding="utf-8")
    shutil.copy(session.path / "measured/reference.exr", session.path / "tile.exr")
    assert holds(measure_session(session).slice)
    light = oiio.ImageBuf(str(session.path / "tile.exr"))
    assert light.write(str(session.path / "other.exr"))
    frames = (session.path / "frames.csv").read_text(encoding="utf-8").replace("tile.exr", "other.exr")
    (session.path / "frames.csv").write_text(frames, encoding="utf-8")
    refused(session, r"other\.exr: is in a unit of the tool that merged it")


@pytest.mark.parametrize(("height", "width", "cause"), [(1, 300, "too small"), (200, 1, "too small"), (16, 16, "ends")])
def test_a_frame_that_shows_next_to_nothing_but_the_spot_is_refused(
    session: Session, height: int, width: int, cause: str
) -> None:
    rows, columns = slice(100 - height // 2, 100 + -(-height // 2)), slice(150 - width // 2, 150 + -(-width // 2))
    change(session, "*", lambda raw: raw[rows, columns])
    refused(replace(session, camera=Camera("mono")), cause)


def test_light_beyond_a_small_frame_is_flagged_and_its_error_stated(session: Session) -> None:
    change(session, "*", lambda raw: raw[84:116, 134:166])
    found = measure_session(replace(session, camera=Camera("mono"))).slice
    assert holds(found)
    assert found is not None
    assert "light_lost" in found.flags
    assert 0.005 < found.total_r_sd["G"] < 0.05
