"""One door for images: numbers as they are stored whatever the container."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from image_files import (
    CFA,
    CUBE,
    DN,
    DNG,
    FLOATS,
    MOSAICS,
    RGB,
    RGBE,
    STACK,
    content,
    exr,
    fits,
    icc,
    icc_formula,
    icc_table,
    iccp,
    packed,
    png,
    radiance,
    tiff,
    with_thumbnail,
)
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.frame_files import read_card, read_frame_file, read_frames_of, read_linear_image

HOLES = np.random.default_rng(0).random(DN.shape) < 0.1
HOLED = np.where(HOLES, np.nan, DN).astype(np.float32)


@pytest.mark.parametrize(
    ("name", "write", "expected"),
    [
        ("a.pgm", content(b"P5\n# a comment\n16 12\n4095\n" + DN.astype(">u2").tobytes()), DN),
        ("a.ppm", content(b"P6 16 12 4095\n" + RGB.astype(">u2").tobytes()), RGB),
        ("a.pgm", content(b"P2 16 12 4095\n" + " ".join(map(str, DN.ravel())).encode()), DN),
        ("a.pfm", content(b"PF\n16 12\n-1.0\n" + FLOATS[::-1].astype("<f4").tobytes()), FLOATS),
        (
            "a.pgm",
            content(b"P2 16 12 4095\n" + b" # a row\n".join(b" ".join(b"%d" % v for v in row) for row in DN)),
            DN,
        ),
        ("a.npy", lambda path: np.save(path, DN), DN),
        ("a.npy", lambda path: np.save(path, DN[..., None]), DN),
        ("a.npy", lambda path: np.save(path, np.dstack([RGB, np.full_like(DN, 65535)])), RGB),
        ("a.npy", lambda path: np.save(path, np.asfortranarray(RGB.astype(">u2"))), RGB),
        ("a.fits", content(fits((DN.astype(int) - 32768).astype(">i2"), "BZERO   =                32768")), DN),
        ("a.fits", content(fits((DN.astype(int) - 32768).astype(">i2"), "BZERO   =           3.2768D+04")), DN),
        (
            "a.fits",
            content(fits(np.where(HOLES, -9, DN.astype(int)).astype(">i2"), "BLANK   =                   -9")),
            HOLED,
        ),
        ("a.fits", content(fits(FLOATS[..., 0].astype(">f4"), "BSCALE  =                  2.0")), 2 * FLOATS[..., 0]),
        ("a.png", png, DN),
        ("a.png", lambda path: png(path, (b"gAMA", struct.pack(">I", 100_000)), data=RGB), RGB),
        ("a.png", lambda path: png(path, iccp(icc(1, 1, 1))), DN),
        ("a.png", lambda path: png(path, iccp(icc_table(np.linspace(0, 1, 1024)))), DN),
        ("a.png", lambda path: png(path, iccp(icc_formula(0, 1.0))), DN),
        ("a.png", lambda path: png(path, (b"cICP", bytes([1, 8, 0, 1])), (b"sRGB", b"\0")), DN),
        ("straight.tif", tiff(DN, extratags=[(301, "H", 65536, np.arange(65536, dtype=np.uint16), True)]), DN),
        ("a10.tif", packed(DN & 1023, 10), DN & 1023),
        ("a12.tif", packed(DN, 12), DN),
        ("a14.tif", packed(DN * 3, 14), DN * 3),
        ("planar.tif", tiff(RGB.transpose(2, 0, 1).copy(), planarconfig="separate", photometric="rgb"), RGB),
        ("alpha.tif", tiff(np.dstack([RGB, np.full_like(DN, 65535)]), extrasamples=["unassalpha"]), RGB),
        ("thumb.tif", with_thumbnail, DN),
        ("big.tif", tiff(DN, bigtiff=True, byteorder=">"), DN),
        (
            "tiles.tif",
            tiff(np.tile(DN, (4, 4)), tile=(16, 32), compression="zlib", predictor=True),
            np.tile(DN, (4, 4)),
        ),
        ("lzma.tif", tiff(DN, compression="lzma"), DN),
        ("linear.dng", tiff(RGB, photometric=34892, extratags=DNG), RGB),
        ("deflate.dng", tiff(DN, photometric=32803, compression="zlib", extratags=[*DNG, *CFA]), DN),
        ("a.exr", lambda path: exr(path, [("", ("R", "G", "B"), FLOATS)]), FLOATS),
        ("float_cfa.dng", tiff(FLOATS[..., 0], photometric=32803, extratags=[*DNG, *CFA]), FLOATS[..., 0]),
    ],
)
def test_numbers_are_those_that_were_stored(
    tmp_path: Path, name: str, write: Callable[[Path], None], expected: NDArray[Any]
) -> None:
    write(tmp_path / name)
    frame = read_frame_file(tmp_path / name)
    np.testing.assert_array_equal(frame.data, expected)
    assert (frame.card.height_px, frame.card.width_px) == expected.shape[:2]
    assert frame.layout == ("rgb" if expected.ndim == 3 else "RGGB" if name in MOSAICS else None)
    assert read_card(tmp_path / name).card == frame.card


@pytest.mark.parametrize("compression", ["zstd", "lzw", "jpegxl", "jpegxr"])
def test_codes_of_the_extra_are_read(tmp_path: Path, compression: str) -> None:
    pytest.importorskip("imagecodecs", reason="the extra `formats` is not installed")
    data = DN if compression != "jpegxr" else DN.astype(np.uint8)
    options = {"compressionargs": {"level": 0.0, "lossless": True}} if compression == "jpegxl" else {}
    tifffile.imwrite(tmp_path / "a.tif", data, compression=compression, metadata=None, **options)
    frame = read_frame_file(tmp_path / "a.tif")
    assert frame.data.shape == data.shape
    if compression != "jpegxr":
        np.testing.assert_array_equal(frame.data, data)
        tifffile.imwrite(
            tmp_path / "a.dng", data, compression=compression, photometric=32803, extratags=[*DNG, *CFA], **options
        )
        if compression == "jpegxl":
            np.testing.assert_array_equal(read_frame_file(tmp_path / "a.dng").data, data)


@pytest.mark.parametrize("error", [ValueError, NotImplementedError, ModuleNotFoundError])
@pytest.mark.parametrize("name", ["a12.tif", "lzw.tif", "zstd.tif"])
def test_without_the_extra_lzw_and_packed_bits_are_read_and_others_name_it(
    tmp_path: Path, name: str, error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What tifffile raises depends on the code and on the version of Python."""
    if name == "a12.tif":
        packed(DN, 12)(tmp_path / name)
    else:
        pytest.importorskip("imagecodecs", reason="the extra `formats` writes these files")
        tifffile.imwrite(tmp_path / name, DN, compression=name.split(".")[0], metadata=None)

    def refuse(*_: Any, **__: Any) -> None:
        raise error("<COMPRESSION> requires the 'imagecodecs' package")

    monkeypatch.setattr(tifffile.TiffPage, "asarray", refuse)
    if name == "zstd.tif":
        with pytest.raises(InputError, match=r"compressed by ZSTD; `pip install 'bssrdf\[formats\]'`"):
            read_frame_file(tmp_path / name)
    else:
        np.testing.assert_array_equal(read_frame_file(tmp_path / name).data, DN)


def test_profile_that_says_linear_is_believed(tmp_path: Path) -> None:
    tiff(RGB, iccprofile=icc(1.0))(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_frame_file(tmp_path / "a.tif").data, RGB)


@pytest.mark.parametrize(
    ("name", "write", "pages"),
    [
        ("a.tif", tiff(STACK, photometric="minisblack"), STACK),
        ("a.npy", lambda path: np.save(path, CUBE), CUBE),
        ("a.fits", content(fits(CUBE.astype(">i2"))), CUBE),
        (
            "a.fits",
            content(
                fits(DN.astype(">i2")) + b"".join(fits(x.astype(">i2"), unit="XTENSION= 'IMAGE'") for x in STACK[1:])
            ),
            STACK,
        ),
        ("a.pgm", content(b"".join(b"P5 16 12 4095\n" + page.astype(">u2").tobytes() for page in STACK)), STACK),
    ],
)
def test_a_stack_is_read_whole_and_never_taken_for_its_first_picture(
    tmp_path: Path, name: str, write: Callable[[Path], None], pages: np.ndarray
) -> None:
    write(tmp_path / name)
    np.testing.assert_array_equal([frame.data for frame in read_frames_of(tmp_path / name)], pages)
    with pytest.raises(InputError, match=r"holds several pictures; a stack is a bracket"):
        read_frame_file(tmp_path / name)


def test_pictures_of_different_sizes_are_no_stack(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "a.tif") as writer:
        for data in (DN, DN[:6]):
            writer.write(data, metadata=None)
    with pytest.raises(InputError, match="different sizes"):
        list(read_frames_of(tmp_path / "a.tif"))


@pytest.mark.parametrize("order", ["TZCYX", "CTZYX"])
def test_ome_tells_the_exposure_of_each_plane(tmp_path: Path, order: str) -> None:
    exposures = [1.0, 4.0, 16.0]
    shape = tuple(3 if axis == "T" else 1 for axis in order[:3])
    plane = {"ExposureTime": exposures, "ExposureTimeUnit": ["ms"] * 3}
    tifffile.imwrite(tmp_path / "a.ome.tif", STACK.reshape(*shape, 12, 16), metadata={"axes": order, "Plane": plane})
    frames = list(read_frames_of(tmp_path / "a.ome.tif"))
    assert [frame.exposure_s for frame in frames] == [0.001, 0.004, 0.016]
    assert [frame.exposure_rel_sd for frame in frames] == [0.001] * 3


def test_pages_tell_their_own_exposures(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "a.tif") as writer:
        for i, data in enumerate(STACK):
            writer.write(data, metadata=None, extratags=[(33434, "2I", 1, (1, 10 + i), True)])
        writer.write(DN, metadata=None, extratags=[(51123, "s", 0, '{"Exposure-ms": 2.5}', True)])
    assert [frame.exposure_s for frame in read_frames_of(tmp_path / "a.tif")] == [
        *(pytest.approx(1 / (10 + i)) for i in range(3)),
        0.0025,
    ]


def test_fits_tells_camera_exposure_and_pattern(tmp_path: Path) -> None:
    cards = ["BAYERPAT= 'RGGB    '", "YBAYROFF=                    1", "EXPTIME =                 0.25 / [s]"]
    cards += ["GAIN    =                  120", "CCD-TEMP=                -10.5", "DATE-OBS= '2024-01-02T03:04:05'"]
    cards += ["INSTRUME= 'ZWO ASI''s'"]
    (tmp_path / "a.fits").write_bytes(fits(DN.astype(">i2"), *cards))
    frame = read_frame_file(tmp_path / "a.fits")
    card = frame.card
    assert (card.layout, card.gain, card.temperature_c) == ("GBRG", 120.0, -10.5)
    assert (frame.exposure_s, frame.exposure_rel_sd, frame.utc) == (0.25, 0.001, "2024-01-02T03:04:05")


@pytest.mark.parametrize(
    ("card", "exposure_s"),
    [("EXPTIME =              1.5D-02", 0.015), ("EXPOSURE=                250.0 / [ms] open", 0.25)],
)
def test_fits_tells_exposure_in_any_unit_and_exponent(tmp_path: Path, card: str, exposure_s: float) -> None:
    (tmp_path / "a.fits").write_bytes(fits(DN.astype(">i2"), card))
    assert read_frame_file(tmp_path / "a.fits").exposure_s == exposure_s


def test_fits_whose_rows_run_upwards_leaves_its_pattern_to_the_user(tmp_path: Path) -> None:
    """Programs differ in whether the pattern is that of the first row or of the top one."""
    (tmp_path / "a.fits").write_bytes(fits(DN.astype(">i2"), "BAYERPAT= 'RGGB    '", "ROWORDER= 'BOTTOM-UP'"))
    assert read_frame_file(tmp_path / "a.fits").layout is None


def test_tiff_tells_exposure_iso_and_lens(tmp_path: Path) -> None:
    tags = [
        (272, "s", 0, "Model 1\n", True),
        (34855, "H", 1, 400, True),
        (33437, "2I", 1, (56, 10), True),
        (37386, "2I", 1, (50, 1), True),
        (42036, "s", 0, "50mm  f/1.8", True),
        (36867, "s", 0, "2024:01:02 03:04:05", True),
        (36881, "s", 0, "+02:00", True),
        (37888, "2i", 1, (-55, 10), True),
    ]
    tiff(DN, extratags=tags)(tmp_path / "a.tif")
    frame = read_card(tmp_path / "a.tif")
    card = frame.card
    assert (card.camera, card.lens, card.iso, card.f_number) == ("Model 1", "50mm f/1.8", 400.0, 5.6)
    assert (card.focal_mm, card.temperature_c, card.bits) == (50.0, -5.5, 16)
    assert frame.utc == "2024-01-02T03:04:05+02:00"


def test_png_tells_exposure(tmp_path: Path) -> None:
    to_exif = b"MM\0*" + struct.pack(">IHHHIII", 8, 1, 34665, 4, 1, 26, 0)
    exif = struct.pack(">HHHIII", 1, 33434, 5, 1, 44, 0) + struct.pack(">II", 1, 250)
    png(tmp_path / "a.png", (b"eXIf", to_exif + exif))
    assert read_frame_file(tmp_path / "a.png").exposure_s == 0.004


@pytest.mark.parametrize(("x", "y"), [(3, 2), (-4, -1), (0, 0)])
def test_data_window_is_put_in_its_place(tmp_path: Path, x: int, y: int) -> None:
    window = {"x": x + 5, "y": y + 7, "full_x": 5, "full_y": 7, "full_width": 20, "full_height": 15}
    exr(tmp_path / "a.exr", [("", ("R", "G", "B"), FLOATS)], **window)
    whole = np.full((40, 40, 3), np.nan, np.float32)
    whole[10 + y : 22 + y, 10 + x : 26 + x] = FLOATS
    np.testing.assert_array_equal(read_linear_image(tmp_path / "a.exr"), whole[10:25, 10:30])


def test_the_one_picture_of_layers_and_parts_is_found(tmp_path: Path) -> None:
    path, (red, green, blue) = tmp_path / "a.exr", np.moveaxis(FLOATS, -1, 0)
    layered = ("albedo.B", "albedo.G", "albedo.R", "R", "G", "B")
    exr(path, [("", layered, np.dstack([FLOATS + 1, FLOATS]))])
    np.testing.assert_array_equal(read_linear_image(path), FLOATS)
    exr(path, [("", ("beauty.R", "beauty.G", "beauty.B"), FLOATS)])
    np.testing.assert_array_equal(read_linear_image(path), FLOATS)
    exr(path, [(name, (name,), plane[..., None]) for name, plane in zip("GRB", (green, red, blue), strict=True)])
    np.testing.assert_array_equal(read_linear_image(path), FLOATS)
    exr(path, [("left", ("R", "G", "B"), FLOATS), ("depth", ("Z", "ZBack"), FLOATS[..., :2])])
    np.testing.assert_array_equal(read_linear_image(path), FLOATS)
    exr(path, [("left", ("R", "G", "B"), FLOATS), ("right", ("R", "G", "B"), FLOATS)])
    with pytest.raises(InputError, match=r"several pictures \(left, right\)"):
        read_linear_image(path)


def test_radiance_is_over_its_exposures(tmp_path: Path) -> None:
    radiance(tmp_path / "a.hdr", RGBE, "EXPOSURE=4", "EXPOSURE= 0.5", "COLORCORR=1 2 1")
    exact, half_step = np.array([0.5, 0.125, 0.125]), np.array([1, 0.5, 1]) / 512
    np.testing.assert_allclose(read_linear_image(tmp_path / "a.hdr")[0, 0], exact + half_step)
    radiance(tmp_path / "b.hdr", RGBE, "EXPOSURE=0")
    with pytest.raises(InputError, match="EXPOSURE"):
        read_linear_image(tmp_path / "b.hdr")
    radiance(tmp_path / "c.hdr", RGBE, rows="+X {1} -Y {0}")
    with pytest.raises(InputError, match="rows do not run down"):
        read_linear_image(tmp_path / "c.hdr")


def test_xyze_becomes_rgb_whose_white_is_white(tmp_path: Path) -> None:
    white = np.dstack([np.full((2, 3), value, np.uint8) for value in (128, 128, 128, 129)])
    radiance(tmp_path / "a.hdr", white, kind="xyze")
    np.testing.assert_allclose(read_linear_image(tmp_path / "a.hdr"), 1 + 1 / 256, rtol=1e-5)
    red = np.dstack([np.full((2, 3), value, np.uint8) for value in (128, 66, 6, 129)])  # x, y = 0.64, 0.33
    radiance(tmp_path / "b.hdr", red, kind="xyze")
    r, g, b = read_linear_image(tmp_path / "b.hdr")[0, 0]
    assert max(abs(g), abs(b)) < 0.02 * r


def test_numbers_that_radiance_cuts_off_come_back_without_bias(tmp_path: Path) -> None:
    light = np.random.default_rng(0).uniform(0.05, 1.0, (2000, 3)).astype(np.float64)
    top, exponent = np.frexp(light.max(axis=1))
    codes = np.floor(light * (256 * top / light.max(axis=1))[:, None])
    pixels = np.concatenate([codes, exponent[:, None] + 128], axis=1).astype(np.uint8).reshape(40, 50, 4)
    radiance(tmp_path / "a.hdr", pixels)
    off = read_linear_image(tmp_path / "a.hdr").reshape(-1, 3) - light
    assert np.all(np.abs(off.mean(axis=0)) < 3 * off.std(axis=0) / 2000**0.5)
