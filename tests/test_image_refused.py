"""Image files that are not light, or are damaged: refused in one line that names the cause."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from image_files import (
    CFA,
    DN,
    DNG,
    FLOATS,
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
    png,
    profile,
    radiance,
    tiff,
)

from bssrdf.errors import InputError
from bssrdf.session.frame_files import read_frame_file, read_frames_of

QUAD = (33421, "H", 2, (4, 4), True), (33422, "B", 16, bytes((0, 0, 1, 1) * 2 + (1, 1, 2, 2) * 2), True)
COLOURS = np.zeros((3, 256), np.uint16)
RAMP = np.arange(65536, dtype=np.uint16)
S_CURVE = np.linspace(0, 1, 256) - 0.1 * np.sin(np.linspace(0, 2 * np.pi, 256))
"""Whose middle is straight."""


@pytest.mark.parametrize(
    ("name", "write", "cause"),
    [
        ("a.tif", tiff(DN.astype(np.uint8), photometric="palette", colormap=COLOURS), "a palette picture"),
        ("a.tif", tiff(np.dstack([RGB, DN]), photometric="separated"), "a CMYK picture"),
        ("a.tif", tiff(RGB, photometric="cielab"), "a CIELAB picture"),
        ("a.tif", tiff(RGB.astype(np.uint8), photometric="ycbcr"), "a YCbCr picture"),
        ("a.tif", tiff(DN, photometric="miniswhite"), "an inverted picture"),
        ("a.tif", tiff(RGB, iccprofile=icc(2.2)), "gamma encoded"),
        ("a.tif", tiff(np.dstack([RGB, DN]), extrasamples=["unassalpha"]), "4 channels, the last not opaque"),
        ("a.tif", tiff(np.zeros((4, 4), np.complex64)), "complex64"),
        ("a.tif", tiff(DN, photometric=32803, extratags=QUAD), "quad Bayer"),
        ("a.dng", tiff(DN, photometric=32803, extratags=[*DNG, *QUAD]), "quad Bayer"),
        ("a.png", lambda path: png(path, (b"sRGB", b"\0")), "gamma encoded"),
        ("a.png", lambda path: png(path, (b"gAMA", struct.pack(">I", 45_455))), "gamma encoded"),
        ("a.png", lambda path: png(path, iccp(icc(2.2))), "gamma encoded"),
        ("a.png", lambda path: png(path, iccp(icc(1, 2.2, 1))), "gamma encoded"),
        ("a.png", lambda path: png(path, iccp(icc_table(S_CURVE))), "gamma encoded"),
        ("a.png", lambda path: png(path, iccp(icc_formula(3, 2.4, 0.948, 0.052, 0.0774, 0.04045))), "gamma encoded"),
        ("a.png", lambda path: png(path, iccp(profile(bytes(16), names=(b"A2B0",)))), "without a tone curve"),
        ("a.png", lambda path: png(path, iccp(b"no profile")), "without a tone curve"),
        ("a.png", lambda path: png(path, (b"iCCP", b"x\0\0not packed")), "without a tone curve"),
        ("a.png", lambda path: png(path, (b"cICP", bytes([9, 16, 0, 1]))), "gamma encoded"),
        ("a.tif", tiff(RGB, iccprofile=profile(bytes(16), names=(b"A2B0",))), "without a tone curve"),
        (
            "a.tif",
            tiff(DN, extratags=[(301, "H", 65536, (RAMP / 65535.0 * RAMP).astype(np.uint16), True)]),
            "its transfer function says",
        ),
        ("a.tif", tiff(DN, extratags=[(291, "H", 65536, RAMP, True)]), "optical densities"),
        ("a.png", lambda path: png(path, data=DN.astype(np.uint8)), "8 bits"),
        ("a.pgm", content(b"P2 16 12 4095\n1 2 3"), "its numbers are not 12 x 16 x 1"),
        ("a.npy", lambda path: np.save(path, DN > 5), "not an array of numbers"),
        ("a.fits", content(fits(DN.astype(">i2"), unit="XTENSION= 'BINTABLE'")), "no picture"),
        ("a.exr", lambda path: exr(path, [("", ("X", "Y", "Z"), FLOATS)]), "'X', 'Y', 'Z'"),
        ("a.exr", lambda path: exr(path, [("", ("R", "G", "B"), FLOATS)], code="dwaa"), r"with loss \(dwaa\)"),
        ("a.tif", tiff(DN.astype(np.uint8), compression="jpeg"), "with loss"),
        ("a.dng", tiff(DN, photometric=32803, compression="jpeg", extratags=[*DNG, *CFA]), "with loss"),
        ("a.dng", tiff(DN, photometric=32803, extratags=[*DNG, *CFA, (50711, "H", 1, 2, True)]), "set off"),
        ("a.fits", content(gzip.compress(fits(DN.astype(">i2")))), "packed archive"),
        ("a.npy", lambda path: np.save(path, DN[:0]), "not an array of numbers"),
        ("a.npy", lambda path: np.save(path, np.moveaxis(RGB, 2, 0)), "three planes may be colours or frames"),
        ("a.fits", content(fits(np.moveaxis(RGB, 2, 0).astype(">i2"))), "three planes may be colours or frames"),
        ("a.fits", content(fits(RGB.astype(">i2"))), "three planes may be colours or frames"),
    ],
)
def test_what_is_not_light_is_refused_by_name(
    tmp_path: Path, name: str, write: Callable[[Path], None], cause: str
) -> None:
    write(tmp_path / name)
    with pytest.raises(InputError, match=cause):
        read_frame_file(tmp_path / name)


@pytest.mark.parametrize(
    ("channels", "exposures_ms", "is_refused"),
    [
        ({"EmissionWavelength": [450, 550, 650]}, [1, 4, 16], True),
        ({"Name": ["red", "green", "blue"]}, [5, 5, 5], True),
        ({"Name": ["1 ms", "4 ms", "16 ms"]}, [1, 4, 16], False),
    ],
)
def test_pictures_of_several_colours_are_no_bracket(
    tmp_path: Path, channels: dict[str, Any], exposures_ms: list[float], is_refused: bool
) -> None:
    told = {"ExposureTime": exposures_ms, "ExposureTimeUnit": ["ms"] * 3}
    tifffile.imwrite(tmp_path / "a.ome.tif", STACK, metadata={"axes": "CYX", "Channel": channels, "Plane": told})
    if is_refused:
        with pytest.raises(InputError, match=r"a picture for each of .*; save each channel"):
            list(read_frames_of(tmp_path / "a.ome.tif"))
    else:
        assert [frame.exposure_s for frame in read_frames_of(tmp_path / "a.ome.tif")] == [0.001, 0.004, 0.016]
    tifffile.imwrite(tmp_path / "b.tif", STACK, imagej=True, metadata={"axes": "CYX"})
    with pytest.raises(InputError, match="a picture for each of channel 0, channel 1, channel 2; save each channel"):
        list(read_frames_of(tmp_path / "b.tif"))


def test_raw_whose_last_rows_no_sensor_could_have_read_is_cut_short(tmp_path: Path) -> None:
    """What LibRaw leaves of a cut file of a kind whose tables tell no end, such as RW2."""
    cut = np.tile(DN + np.uint16(600), (4, 4))
    cut[40:] = 0
    tags = [*DNG, *CFA, (50714, "H", 1, 512, True)]
    tiff(cut, photometric=32803, extratags=tags)(tmp_path / "a.rw2")
    with pytest.raises(InputError, match="cut short: its last rows are empty"):
        read_frame_file(tmp_path / "a.rw2")


@pytest.mark.parametrize("name", ["a.tif", "a.dng"])
def test_stack_or_planes_that_are_cut_are_refused(tmp_path: Path, name: str) -> None:
    tags = DNG if name == "a.dng" else []
    data, kind = (RGB, 34892) if name == "a.dng" else (STACK, "minisblack")
    tiff(data, photometric=kind, extratags=tags, rowsperstrip=2)(tmp_path / name)
    with tifffile.TiffFile(tmp_path / name) as tif:
        end = tif.pages[-1].dataoffsets[-1] + tif.pages[-1].databytecounts[-1]
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: end - 3])
    with pytest.raises(InputError, match="cut short"):
        list(read_frames_of(tmp_path / name))


@pytest.mark.parametrize(
    ("name", "data", "cause"),
    [
        ("a.tif", b"", "is empty"),
        ("a.dng", b"\xff\xd8\xff\xe0" + bytes(60), r"is a \.jpg file by its content, named \.dng; name it a\.jpg"),
        ("a.png", b"II*\0" + bytes(60), r"is a \.tif file by its content, named \.png"),
        ("a.nef", b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
        ("a.cr2", b"<!DOCTYPE html>", "a web page"),
        ("a.fits", bytes(5000), "begins with zeros"),
        ("a.arw", b"no such format " * 9, "LibRaw .* does not read; convert it to DNG"),
        ("a.heic", b"anything", "is not a kind of frame"),
    ],
)
def test_unreadable_file_says_what_it_is(tmp_path: Path, name: str, data: bytes, cause: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=cause):
        read_frame_file(tmp_path / name)


@pytest.mark.parametrize("name", ["a.tif", "a.dng", "a.npy", "a.exr", "a.png"])
def test_file_that_is_not_there_is_said_to_be_missing(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="is not there"):
        read_frame_file(tmp_path / name)


@pytest.mark.parametrize("suffix", [".pgm", ".fits", ".npy", ".png", ".tif", ".exr", ".hdr"])
def test_rubbish_of_any_name_is_refused_in_one_line(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(7)
    writers: dict[str, Callable[[Path], Any]] = {
        ".pgm": content(b"P5 16 12 4095\n" + DN.astype(">u2").tobytes()),
        ".fits": content(fits(DN.astype(">i2"), "BZERO   =                32768")),
        ".npy": lambda path: np.save(path, DN),
        ".png": png,
        ".tif": tiff(STACK, photometric="minisblack", metadata=None)
        if False
        else tiff(STACK, photometric="minisblack"),
        ".exr": lambda path: exr(path, [("", ("R", "G", "B"), FLOATS)]),
        ".hdr": lambda path: radiance(path, np.tile(RGBE, (8, 8, 1))),
    }
    path, lines = tmp_path / f"a{suffix}", []
    writers[suffix](path)
    whole = path.read_bytes()
    for i in range(120):
        damaged = bytearray(whole[: rng.integers(len(whole))] if i % 3 == 0 else whole)
        for at in rng.integers(0, max(1, min(len(damaged), 300)), 3 if i % 3 else 0):
            damaged[at] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            list(read_frames_of(path))
        except InputError as error:
            lines.append(str(error).splitlines())
    assert len(lines) > 20
    assert {len(line) for line in lines} == {1}
