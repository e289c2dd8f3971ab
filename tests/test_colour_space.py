"""Slices in a renderer's colours: simulated cameras and spectra; what the matrix cannot know is flagged."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wax_session import write_session

from bssrdf.calib import may_have_narrow_band, slice_matrix
from bssrdf.calib.colour import fit_matrix
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError
from bssrdf.measure import measure_session
from bssrdf.measure.colour_space import in_space
from bssrdf.session.flags import Flag
from bssrdf.session.records import Camera, ChannelSlice, Colour, Session, Slice
from bssrdf.session.slice_csv import read_slice, write_slice
from bssrdf.transport import half_space

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import colour

WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
MATRIX = ((1.9, -0.7, -0.1), (-0.3, 1.6, -0.4), (0.02, -0.6, 2.1))


def band(centre_nm: float, width_nm: float) -> np.ndarray:
    return np.exp(-0.5 * ((WAVELENGTHS - centre_nm) / width_nm) ** 2)


BLOOD = (
    12 * band(415, 15) + 1.25 * band(542, 11) + 1.35 * band(577, 9) + 0.6 * band(555, 18) + 0.25 * band(480, 40) + 0.02
)
MELANIN = (WAVELENGTHS / 500) ** -3.33

SMOOTH = {
    "milk": (0.0005 + 0.02 * band(430, 40), 2.9, 0.7),
    "marble": (0.0021 + 0.006 * (WAVELENGTHS / 400) ** -3, 2.6, 0.5),
    "jade": (0.02 + 0.08 * band(420, 60) + 0.15 * band(680, 60), 1.2, 0.3),
    "ketchup": (0.05 + 1.2 / (1 + np.exp((WAVELENGTHS - 590) / 20)), 0.3, 1.0),
    "juice": (0.005 + 0.6 / (1 + np.exp((WAVELENGTHS - 510) / 15)), 1.0, 0.8),
    "wax": (0.004 + 0.02 * (WAVELENGTHS / 400) ** -4, 1.5, 0.6),
    "blue dye": (0.01 + 0.3 * band(620, 50), 1.0, 0.3),
    "soap": (0.02 + 0.3 * band(660, 50) + 0.2 * band(420, 40), 1.0, 0.3),
}
NARROW = {
    "pale skin": (0.01 + 0.048 * BLOOD + 0.03 * MELANIN, 2.0, 1.2),
    "flushed skin": (0.01 + 0.16 * BLOOD + 0.03 * MELANIN, 1.5, 1.2),
    "dark skin": (0.01 + 0.08 * BLOOD + 0.4 * MELANIN, 2.0, 1.2),
    "meat": (0.02 + 0.4 * BLOOD, 0.6, 1.0),
}
NOT_WORTH_A_FLAG = ("milk", "marble", "jade", "wax", "soap")


def total_r(name: str) -> np.ndarray:
    """Total reflectance by wavelength of σa(λ), σs′ = s (λ/500 nm)^−b."""
    sigma_a, s, b = {**SMOOTH, **NARROW}[name]
    sigma_sp = s * (WAVELENGTHS / 500) ** -b
    one = np.array([1.0])
    return np.array([half_space(sp / (a + sp), 0, 1.3, one).total for a, sp in zip(sigma_a, sigma_sp, strict=True)])


class SeenBy:
    """A Nikon D5100 under a light, calibrated on a chart under the same light."""

    def __init__(self, light: str) -> None:
        shape = colour.SpectralShape(400, 700, 10)

        def aligned(spectrum: object) -> np.ndarray:
            return spectrum.copy().align(shape).values  # type: ignore[attr-defined]

        sensitivity = aligned(colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"])
        self.weights = sensitivity * aligned(colour.SDS_ILLUMINANTS[light])[:, None]
        observer = aligned(colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"])
        self.xyz = observer * aligned(colour.SDS_ILLUMINANTS["D65"])[:, None]
        self.xyz /= self.xyz[:, 1].sum()
        chart = [aligned(patch) for patch in colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"].values()]
        self.matrix = fit_matrix(np.array(chart) @ self.weights).matrix

    def over_a_tile(self, spectrum: np.ndarray) -> np.ndarray:
        return (spectrum @ self.weights) / self.weights.sum(0)

    def delta_e(self, spectrum: np.ndarray, linear: np.ndarray) -> float:
        white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
        true = colour.XYZ_to_Lab(spectrum @ self.xyz, white)
        seen = colour.XYZ_to_Lab(colour.RGB_to_XYZ(linear, "sRGB", apply_cctf_decoding=False), white)
        return float(colour.delta_E(true, seen, method="CIE 2000"))

    def errors(self, name: str) -> tuple[float, float]:
        """ΔE of the camera's own R, G, B, and of the converted."""
        spectrum = total_r(name)
        rgb = self.over_a_tile(spectrum)
        return self.delta_e(spectrum, rgb), self.delta_e(spectrum, slice_matrix(self.matrix, "lin_rec709") @ rgb)


@pytest.fixture(scope="module", params=["D65", "D50", "LED-B3"])
def camera(request: pytest.FixtureRequest) -> SeenBy:
    return SeenBy(request.param)


@pytest.mark.parametrize("name", SMOOTH)
def test_matrix_gets_smooth_spectra_within_one_and_a_half(camera: SeenBy, name: str) -> None:
    own, converted = camera.errors(name)
    assert converted <= 1.5
    assert converted < own


@pytest.mark.parametrize("name", [*SMOOTH, *NARROW])
def test_flag_is_raised_where_the_matrix_is_worse_than_none(camera: SeenBy, name: str) -> None:
    own, converted = camera.errors(name)
    flagged = may_have_narrow_band(camera.over_a_tile(total_r(name)))
    if converted > own:
        assert flagged
    if name in NARROW:
        assert flagged
    if name in NOT_WORTH_A_FLAG:
        assert not flagged


@pytest.mark.parametrize("space", ["lin_rec709", "acescg"])
def test_white_is_white_in_every_space(space: str) -> None:
    np.testing.assert_allclose(slice_matrix(np.array(MATRIX), space).sum(1), 1, atol=2e-4)


def test_gain_of_a_camera_channel_changes_nothing() -> None:
    """A chart seen with twice the blue has half of it in its matrix."""
    matrix = np.array(MATRIX)
    np.testing.assert_allclose(
        slice_matrix(matrix * [1, 1, 0.5], "lin_rec709"), slice_matrix(matrix, "lin_rec709"), rtol=1e-9
    )


def test_matrix_without_an_inverse_is_refused() -> None:
    with pytest.raises(InputError, match="no inverse"):
        slice_matrix(np.ones((3, 3)), "lin_rec709")


def curve_of(totals: tuple[float, float, float], reach_mm: tuple[float, float, float] = (3.0, 3.0, 3.0)) -> Slice:
    r = np.linspace(0.5, 10, 20)
    light = {
        name: ChannelSlice(r, total * np.exp(-r / reach), np.full(r.size, 1e-4))
        for name, total, reach in zip("RGB", totals, reach_mm, strict=True)
    }
    named = dict(zip("RGB", totals, strict=True))
    return Slice(light, 1.4, "incident", "fresnel", total_r=named, total_r_sd=dict.fromkeys("RGB", 0.002))


def session(path: Path, rms: float | None = 0.01) -> Session:
    return Session(path, Camera(), colour=Colour(MATRIX, rms))


def test_curve_and_total_are_converted_alike(tmp_path: Path) -> None:
    seen = curve_of((0.6, 0.5, 0.4))
    found = in_space(seen, session(tmp_path), "lin_rec709")
    matrix = slice_matrix(np.array(MATRIX), "lin_rec709")
    np.testing.assert_allclose(list(found.total_r.values()), matrix @ [0.6, 0.5, 0.4])
    for row in range(20):
        light = [seen.channels[name].rd_per_mm2[row] for name in "RGB"]
        np.testing.assert_allclose([found.channels[name].rd_per_mm2[row] for name in "RGB"], matrix @ light)
    np.testing.assert_allclose(found.channels["G"].sd_per_mm2[0], 1e-4 * np.hypot.reduce(matrix[1]))
    assert found.space == "lin_rec709"
    assert found.provenance["colour"]["rms"] == 0.01
    assert not found.flags


def test_slice_keeps_its_space_on_file(tmp_path: Path) -> None:
    write_slice(tmp_path / "slice.csv", in_space(curve_of((0.6, 0.5, 0.4)), session(tmp_path), "acescg"))
    assert read_slice(tmp_path / "slice.csv").space == "acescg"


def test_rows_that_come_out_negative_are_kept_and_flagged(tmp_path: Path) -> None:
    found = in_space(curve_of((0.6, 0.5, 0.4), (6.0, 1.0, 1.0)), session(tmp_path), "lin_rec709")
    assert Flag.NEGATIVE_LIGHT in found.flags
    assert found.channels["G"].rd_per_mm2.min() < 0
    assert found.channels["G"].r_mm.size == 20


def test_only_rows_that_all_channels_have_are_converted(tmp_path: Path) -> None:
    seen = curve_of((0.6, 0.5, 0.4))
    blue = seen.channels["B"]
    shorter = ChannelSlice(blue.r_mm[3:], blue.rd_per_mm2[3:], blue.sd_per_mm2[3:])
    found = in_space(replace(seen, channels={**seen.channels, "B": shorter}), session(tmp_path), "lin_rec709")
    assert {part.r_mm.size for part in found.channels.values()} == {17}


@pytest.mark.parametrize(
    ("seen", "calibrated", "words"),
    [
        (curve_of((0.6, 0.5, 0.4)), False, "calibrate colour"),
        (
            replace(curve_of((0.6, 0.5, 0.4)), channels={"633nm": curve_of((1, 1, 1)).channels["R"]}),
            True,
            "needs the channels",
        ),
        (curve_of((0.9, 0.05, 0.05)), True, "outside that space"),
    ],
)
def test_what_cannot_be_converted_is_refused_by_its_cause(
    tmp_path: Path, seen: Slice, calibrated: bool, words: str
) -> None:
    known = session(tmp_path) if calibrated else replace(session(tmp_path), colour=None)
    with pytest.raises(InputError, match=words):
        in_space(seen, known, "lin_rec709")


def test_grey_sample_stays_grey_from_its_frames_on(tmp_path: Path) -> None:
    made = replace(write_session(tmp_path / "s"), colour=Colour(MATRIX))
    found = measure_session(made, space="acescg").slice
    assert found is not None
    own = measure_session(made).slice
    assert own is not None
    np.testing.assert_allclose(list(found.total_r.values()), list(own.total_r.values()), rtol=0.02)
    assert found.provenance["colour"]["rms"] == "unknown"


def test_space_without_a_slice_is_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(cli, ["measure", str(tmp_path), "--hdr-only", "--space", "acescg"]) == 2
    assert "--space" in capsys.readouterr().err
