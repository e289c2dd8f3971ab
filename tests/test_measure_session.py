"""`measure_session` on sessions made here with plain numpy noise."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from wax_session import (
    BLACK,
    EXPOSURES_S,
    GAIN,
    MM_PER_PX,
    RHO,
    SHAPE,
    TOTAL,
    VIEW_DEG,
    WHITE,
    falloff,
    picture,
    tile,
    write_session,
)

from bssrdf.bench.measure import write_large
from bssrdf.errors import InputError
from bssrdf.measure.session import measure_session
from bssrdf.measure.total_errors import polarisation_rel_sd
from bssrdf.session.hdr_image import read_hdr_exr
from bssrdf.session.keys import keys_of
from bssrdf.session.records import Session
from bssrdf.session.session_toml import TABLES
from bssrdf.session.slice_csv import read_slice


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Session:
    return write_session(tmp_path_factory.mktemp("measure") / "wax")


@pytest.fixture(scope="module")
def measured(session):
    return measure_session(session)


PLANE = ((0.06, 0.0, 0.0), (0.0, 0.08, 0.0), (0.0, 0.0, 1.0))
PINHOLE = ((100.0, 0.0, 80.0), (0.0, 100.0, 60.0), (0.0, 0.0, 1.0))
OBLIQUE = {"beam": {"incidence_deg": 30.0}}
LASER = {"beam": {"kind": "laser"}}
LENS = {"distortion": {"camera_matrix": PINHOLE, "coefficients": (0.01, 0.0, 0.0, 0.0)}}
OTHER = {
    "material": {
        **{"eta": 1.5, "g": 0.9, "finish": "rough", "cover": "glass", "backing": 0.9, "backing_sd": 0.1},
        **{"thickness_mm": 1.0, "thickness_sd_mm": 0.1, "width_mm": 2.0, "wall": "air"},
    },
    "camera": {
        "layout": "GRBG",
        "black": 490.0,
        "white": 16000.0,
        "gain_e_per_dn": 4.5,
        "read_noise_e": 6.0,
        "exposure_rel_sd": 0.001,
        "aperture_mm": 3.0,
        "response": "debevec",
    },
    "geometry": {
        "mm_per_px": 0.06,
        "homography": PLANE,
        "mm_per_px_rel_sd": 0.01,
        "distance_mm": 500.0,
        "view_angle_deg": 40.0,
        "view_angle_sd_deg": 1.0,
        "view_axis": "x",
    },
    "beam": {"kind": "laser", "polarised": True, "incidence_deg": 30.0, "spot_radius_mm": 0.5, "channels": ("G",)},
    "reference": {"reflectance": (0.9,), "reflectance_sd": (0.02,), "coplanar": True},
    "distortion": {
        "camera_matrix": ((200.0, 0.0, 80.0), (0.0, 200.0, 60.0), (0.0, 0.0, 1.0)),
        "coefficients": (0.05, 0.0, 0.0, 0.0),
    },
}
"""For each key that counts, a value that it does not have in `session`."""
BESIDE = {"polarised": OBLIQUE, "aperture_mm": LASER, "distance_mm": LASER, "camera_matrix": LENS, "coefficients": LENS}
"""What it takes for a key to matter."""


def changed(session, tables):
    """The session with other values of keys, by table."""
    records = {name: replace(getattr(session, name) or TABLES[name](**keys), **keys) for name, keys in tables.items()}
    if records.get("geometry") and records["geometry"].homography:
        records["geometry"] = replace(records["geometry"], mm_per_px=None)
    return replace(session, **records)


def outcome(session):
    """What is found, or why nothing is."""
    try:
        found = measure_session(session).slice
    except InputError as error:
        return str(error)
    arrays = [array.tobytes() for part in found.channels.values() for array in (part.r_mm, part.rd_per_mm2)]
    return arrays, repr(replace(found, channels={}, provenance={}))


def test_every_key_of_a_session_changes_the_slice_or_says_why_not():
    declared = {(table, name): key for table, record in TABLES.items() for name, key in keys_of(record).items()}
    reasons = {place: key.key.informational for place, key in declared.items() if key.key.informational}
    print("informational:", *(f"[{table}] {name}: {why}" for (table, name), why in reasons.items()), sep="\n  ")
    assert {*reasons, *((table, name) for table, keys in OTHER.items() for name in keys)} == declared.keys()


@pytest.mark.parametrize(
    ("table", "name"),
    [
        pytest.param(table, name, marks=() if name == "polarised" else pytest.mark.slow)
        for table, keys in OTHER.items()
        for name in keys
    ],
)
def test_a_key_of_a_session_that_counts_changes_what_is_found(session, table, name):
    before = changed(session, BESIDE.get(name, {}))
    assert outcome(before) != outcome(changed(before, {table: {name: OTHER[table][name]}}))


def area_mm2():
    return MM_PER_PX**2 / np.cos(np.radians(VIEW_DEG))


def true_rd(part, curve=falloff):
    """The bin averages that a perfect measurement would give."""
    scale = RHO / (picture(tile, (80, 60)).sum() * area_mm2())
    nodes, weights = np.polynomial.legendre.leggauss(8)
    r = (part.r_hi_mm + part.r_lo_mm) / 2 + np.outer(nodes, part.r_hi_mm - part.r_lo_mm) / 2
    return scale * np.sum(weights[:, None] * r * curve(r), 0) / np.sum(weights[:, None] * r, 0)


def test_the_curve_is_the_samples_radiance_over_what_the_beam_carries(measured):
    for part in measured.slice.channels.values():
        z = (part.rd_per_mm2 - true_rd(part)) / part.sd_per_mm2
        assert np.abs(np.mean(z)) < 0.5
        assert np.mean(z**2) == pytest.approx(1, abs=0.5)


def test_the_total_holds_the_light_beyond_the_frame(measured):
    in_the_frame = RHO * picture(falloff).sum() / picture(tile, (80, 60)).sum()
    assert in_the_frame < 0.985 * TOTAL
    for channel, total in measured.slice.total_r.items():
        assert total == pytest.approx(TOTAL, abs=4 * measured.slice.total_r_sd[channel])
        assert total == pytest.approx(TOTAL, rel=0.003)
        assert measured.slice.lost_fraction[channel] == pytest.approx(1 - in_the_frame / TOTAL, abs=0.003)


def test_the_slice_states_what_the_camera_saw(measured):
    curve = measured.slice
    assert (curve.flux, curve.exit, curve.view_angle_deg) == ("incident", "fresnel", VIEW_DEG)
    assert curve.scale_rel_sd == pytest.approx(0.005, rel=0.02)


def test_stated_errors_are_those_of_repeated_sessions(tmp_path):
    """Pulls of R and of R_d(r) over seeds; the error of scale that a session's curve has in common is stated apart.

    The spots fall on another place of the mosaic each time, as that error goes with the place.
    """

    def inside(r_mm):
        return 0.8 * np.exp(-((r_mm / 0.5) ** 2)) + 0.05 * np.exp(-(r_mm**2))

    total, curve = [], []
    for seed in range(8):
        aside = np.random.default_rng(1000 + seed).uniform(-1, 1, 2)
        path = tmp_path / str(seed)
        measured = measure_session(write_session(path, seed=seed, sample=inside, sd=0.0, aside=aside)).slice
        for channel, part in measured.channels.items():
            total.append((measured.total_r[channel] / (np.pi * 0.25) - 1) / measured.total_r_sd[channel] * np.pi * 0.25)
            truth = true_rd(part, inside)
            clear = part.sd_per_mm2 < 0.1 * truth
            sd = np.hypot(part.sd_per_mm2, (measured.scale_rel_sd or 0.0) * truth)
            curve.append(((part.rd_per_mm2 - truth) / sd)[clear])
    assert abs(np.mean(total)) < 0.7
    assert 0.6 < np.std(total) < 1.4
    assert abs(np.mean(np.concatenate(curve))) < 0.2
    assert np.std(np.concatenate(curve)) == pytest.approx(1, abs=0.2)


def test_a_dim_beam_widens_the_error_of_the_curves_scale(tmp_path):
    bright = 0.3 * (WHITE - BLACK) * GAIN / EXPOSURES_S[0]
    curves = [
        measure_session(write_session(tmp_path / f"{share:g}", e_per_s=share * bright, sd=0.0)).slice
        for share in (1, 1e-5)
    ]
    assert curves[1].scale_rel_sd > 3 * curves[0].scale_rel_sd


def test_the_spots_radius_comes_from_the_tile_where_it_is_not_given(measured):
    """This tile spreads nothing: its image is a Gaussian of the radius √(1/3) mm."""
    assert measured.slice.spot_radius_mm == pytest.approx(3**-0.5, rel=0.01)
    assert 0 < measured.slice.spot_radius_sd_mm < 0.1


def test_the_folder_measured_holds_images_and_slice_that_read_back(session, measured):
    folder = session.path / "measured"
    assert sorted(file.name for file in folder.iterdir()) == [
        "reference.exr",
        "reference.npz",
        "sample.exr",
        "sample.npz",
        "scene.png",
        "slice.csv",
        "slice.png",
    ]
    parts, provenance = read_hdr_exr(folder / "sample.exr")
    np.testing.assert_array_equal(parts["radiance"], measured.images["sample"].radiance)
    assert len(provenance["sha256"]) == 4 * len(EXPOSURES_S)
    assert read_slice(folder / "slice.csv").total_r == measured.slice.total_r


def test_hdr_only_needs_the_camera_only(session, tmp_path):
    bare = write_session(tmp_path / "bare")
    measure_session(Session(bare.path, bare.camera), hdr_only=True)
    assert sorted(file.name for file in (bare.path / "measured").iterdir()) == ["reference.exr", "sample.exr"]


def test_a_monochrome_camera_measures_its_one_named_channel(tmp_path):
    curve = measure_session(write_session(tmp_path / "mono", layout="mono")).slice
    assert list(curve.channels) == ["633nm"]
    assert curve.total_r["633nm"] == pytest.approx(TOTAL, rel=0.003)


def test_the_radial_curve_is_the_same_with_smaller_errors(session, measured):
    radial = measure_session(session, radial=True).slice.channels["G"]
    part = measured.slice.channels["G"]
    assert radial.side is None
    assert np.median(radial.sd_per_mm2 / true_rd(radial)) < 0.5 * np.median(part.sd_per_mm2 / true_rd(part))
    np.testing.assert_allclose(radial.rd_per_mm2, true_rd(radial), rtol=0.01)


def spoil_size(session):
    for kind in ("sample", "sample_dark"):
        tifffile.imwrite(session.path / f"frames/{kind}_3.tif", np.zeros((50, 40), np.uint16))


def spoil_saturated(session):
    for number in range(len(EXPOSURES_S)):
        tifffile.imwrite(session.path / f"frames/sample_{number}.tif", np.full(SHAPE, WHITE, np.uint16))


def spoil_truncated(session):
    file = session.path / "frames/sample_2.tif"
    file.write_bytes(file.read_bytes()[:10_000])


def spoil_dark(session):
    lines = (session.path / "frames.csv").read_text().splitlines(keepends=True)
    (session.path / "frames.csv").write_text("".join(line for line in lines if "sample_dark_4" not in line))


def spoil_reference(session):
    lines = (session.path / "frames.csv").read_text().splitlines(keepends=True)
    (session.path / "frames.csv").write_text("".join(line for line in lines if ",reference," not in line))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_size, "sample_3.tif"),
        (spoil_saturated, "sample.*saturated"),
        (spoil_truncated, "sample_2.tif"),
        (spoil_dark, r"sample_4.tif: no sample_dark or dark of 0.256 s"),
        (spoil_reference, "no frame of kind reference"),
    ],
)
def test_bad_frames_give_one_line_and_leave_nothing_behind(tmp_path, spoil, message):
    session = write_session(tmp_path / "bad")
    spoil(session)
    with pytest.raises(InputError, match=message) as error:
        measure_session(session)
    assert "\n" not in str(error.value)
    assert not (session.path / "measured").exists()


def test_a_spot_narrower_than_the_mosaic_widens_the_error_of_red_and_blue(tmp_path):
    def narrow(r_mm):
        return 5.0 * np.exp(-((r_mm / 0.06) ** 2)) + 0.05 * np.exp(-(r_mm**2))

    curve = measure_session(write_session(tmp_path / "narrow", sample=narrow, sd=0.0)).slice
    error = {channel: abs(total / curve.total_r["G"] - 1) for channel, total in curve.total_r.items()}
    for channel in "RB":
        assert curve.total_r_sd[channel] > 3 * curve.total_r_sd["G"]
        assert 0 < error[channel] < 4 * curve.total_r_sd[channel] / curve.total_r[channel]


@pytest.mark.parametrize("eta", [1.3, 1.5])
def test_a_polarised_beam_enters_by_fresnel_in_a_direction_that_is_drawn(eta):
    theta_i = np.radians(40.0)
    theta_t = np.arcsin(np.sin(theta_i) / eta)
    across = (np.sin(theta_i - theta_t) / np.sin(theta_i + theta_t)) ** 2
    along = (np.tan(theta_i - theta_t) / np.tan(theta_i + theta_t)) ** 2
    psi = np.random.default_rng(0).uniform(0, 2 * np.pi, 100_000)
    entering = 1 - across * np.cos(psi) ** 2 - along * np.sin(psi) ** 2
    assert polarisation_rel_sd(40.0, eta) == pytest.approx(entering.std() / entering.mean(), rel=0.01)
    assert polarisation_rel_sd(0.0, eta) == 0


def test_measuring_waits_for_no_library_that_it_can_do_without(tmp_path):
    """Their imports took longer than all that was done with them."""
    write_large(tmp_path / "s", times=1)
    measured = (
        "import sys; from bssrdf.cli import cli; from bssrdf.commands.console import run;"
        "code = run(cli, sys.argv[1:]);"
        "print(code, *({'jax', 'matplotlib', 'numba', 'scipy'} & sys.modules.keys()), file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", measured, "measure", str(tmp_path / "s"), "--quiet"], capture_output=True, text=True
    )
    assert done.stderr.strip() == "0"
