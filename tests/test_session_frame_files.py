"""Frames, RAW and TIFF, and HDR images: bit-exact when whole, one line when damaged."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile
from builders import real_data
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.fit_json import read_fit
from bssrdf.session.frame_files import read_card, read_frame_file, read_linear_image
from bssrdf.session.frames_csv import read_frames
from bssrdf.session.hdr_image import read_hdr_exr, write_hdr_exr
from bssrdf.session.raw_frame import positive
from bssrdf.session.session_toml import read_session, write_template
from bssrdf.session.slice_csv import read_slice

RNG = np.random.default_rng(1)
DN = RNG.integers(0, 16384, (48, 64)).astype(np.uint16)
PATTERNS = {"RGGB": (0, 1, 1, 2), "GBRG": (1, 2, 0, 1), "BGGR": (2, 1, 1, 0), "GRBG": (1, 0, 2, 1)}


def write_dng(
    path: Path, dn: NDArray[np.uint16], *extra: tuple[Any, ...], pattern: tuple[int, ...] = (0, 1, 1, 2)
) -> None:
    side = int(len(pattern) ** 0.5)
    tags = [
        (272, "s", 0, "Model 1", True),
        (33421, "H", 2, (side, side), True),
        (33422, "B", side**2, bytes(pattern), True),
        (33434, "2I", 1, (1, 250), True),
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),
        (50717, "H", 1, 16383, True),
        *extra,
    ]
    tifffile.imwrite(path, dn, photometric=32803, extratags=tags, metadata=None)


@pytest.mark.parametrize("layout", PATTERNS)
def test_dng_is_read_bit_exactly(tmp_path: Path, layout: str) -> None:
    levels = (50713, "H", 2, (2, 2), True), (50714, "H", 4, (512, 513, 514, 515), True)
    write_dng(tmp_path / "a.dng", DN, *levels, pattern=PATTERNS[layout])
    frame = read_frame_file(tmp_path / "a.dng")
    assert frame.data.dtype == np.uint16
    np.testing.assert_array_equal(frame.data, DN)
    assert frame.layout == layout == read_card(tmp_path / "a.dng").card.layout
    np.testing.assert_array_equal(frame.black, [[512, 513], [514, 515]])
    assert (frame.white, frame.exposure_s, frame.card.camera) == (16383.0, 0.004, "Model 1")


def test_dng_layout_is_that_of_the_visible_area(tmp_path: Path) -> None:
    """LibRaw moves an odd corner inwards by one, and what is read begins there."""
    write_dng(tmp_path / "a.dng", DN, (50829, "I", 4, (1, 1, 41, 61), True))
    frame = read_frame_file(tmp_path / "a.dng")
    np.testing.assert_array_equal(frame.data, DN[2:41, 2:61])
    assert frame.layout == "BGGR"
    card = read_card(tmp_path / "a.dng").card
    assert (card.layout, card.width_px, card.height_px) == ("BGGR", 59, 39)


def test_raw_of_a_mono_camera(tmp_path: Path) -> None:
    tags = [(50706, "B", 4, bytes([1, 4, 0, 0]), True), (50714, "H", 1, 100, True)]
    tifffile.imwrite(tmp_path / "m.dng", DN, photometric="minisblack", extratags=tags, metadata=None)
    with tifffile.TiffFile(tmp_path / "m.dng", mode="r+b") as tif:
        tif.pages.first.tags[262].overwrite(34892)
    frame = read_frame_file(tmp_path / "m.dng")
    np.testing.assert_array_equal(frame.data, DN)
    assert (frame.layout, frame.black) == ("mono", 100.0)


def test_raw_without_a_2x2_mosaic_is_refused(tmp_path: Path) -> None:
    write_dng(tmp_path / "x.dng", DN, pattern=(1, 1, 0, 1, 1, 2, 1, 1, 2, 1, 1, 0, 2, 0, 1, 0, 2, 1) * 2)
    with pytest.raises(InputError, match=r"x\.dng: .*X-Trans"):
        read_frame_file(tmp_path / "x.dng")


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "uint32", "int32", "float16", "float32", "float64"])
@pytest.mark.parametrize("shape", [(9, 7), (9, 7, 3)], ids=["one channel", "rgb"])
def test_tiff_keeps_its_numbers(tmp_path: Path, dtype: str, shape: tuple[int, ...]) -> None:
    values = RNG.integers(0, 200, shape).astype(dtype)
    photometric = "rgb" if len(shape) == 3 else "minisblack"
    tags = [(33434, "2I", 1, (1, 250), True)]
    tifffile.imwrite(tmp_path / "a.tif", values, photometric=photometric, extratags=tags)
    frame = read_frame_file(tmp_path / "a.tif")
    assert frame.data.dtype == (dtype if dtype in ("uint8", "uint16") else "float32")
    np.testing.assert_array_equal(frame.data, values)
    assert frame.layout == ("rgb" if len(shape) == 3 else None)
    assert (frame.black, frame.white, frame.exposure_s) == (None, None, 0.004)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        (np.zeros((4, 4), np.complex64), "complex64"),
        (np.zeros((4, 4, 2), np.uint8), "2 channels"),
        (np.zeros((4, 4, 4), np.uint8), "4 channels"),
    ],
)
def test_tiff_of_another_kind_is_refused(tmp_path: Path, values: NDArray[Any], named: str) -> None:
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="minisblack", planarconfig="contig")
    with pytest.raises(InputError, match=rf"a\.tif: .*{named}"):
        read_frame_file(tmp_path / "a.tif")


def test_frame_of_a_real_camera() -> None:
    file = real_data("flea3_bracket") / "frames/d1_disks32cmV2_600nm_100ms_2019-02-08-183741-0004.tif"
    frame = read_frame_file(file)
    assert frame.data.dtype == np.uint8
    np.testing.assert_array_equal(frame.data, tifffile.imread(file))
    assert frame.data.shape == (344, 408)


def test_two_threads_read_what_one_reads(tmp_path: Path) -> None:
    files = [tmp_path / f"{i}.{kind}" for i in range(8) for kind in ("dng", "tif")]
    for i, file in enumerate(files):
        write_dng(file, DN + np.uint16(i))
    with ThreadPoolExecutor(2) as pool:
        for i, frame in enumerate(pool.map(read_frame_file, files)):
            np.testing.assert_array_equal(frame.data, DN + np.uint16(i))


def hdr_parts(channels: tuple[int, ...]) -> dict[str, NDArray[np.float32]]:
    shape = (11, 13)
    radiance = RNG.normal(size=shape + channels).astype(np.float32)
    radiance[0, 0] = np.nan
    one = np.ones(shape + channels, np.float32)
    return {"radiance": radiance, "variance": one * 1e-30, "count": one * 13, "mask": np.full(shape, 5, np.float32)}


@pytest.mark.parametrize("channels", [(), (3,)], ids=["mosaic", "rgb"])
def test_hdr_image_is_read_back_bit_exactly(tmp_path: Path, channels: tuple[int, ...]) -> None:
    parts, provenance = hdr_parts(channels), {"exposures_s": [0.1, 1 / 3], "σ": 'a\n"b"', "software": {"version": "1"}}
    write_hdr_exr(tmp_path / "sample.exr", parts, provenance)
    back, read_provenance = read_hdr_exr(tmp_path / "sample.exr")
    assert read_provenance == provenance
    assert list(back) == list(parts)
    for name, plane in parts.items():
        np.testing.assert_array_equal(back[name], plane)
    np.testing.assert_array_equal(read_linear_image(tmp_path / "sample.exr"), parts["radiance"])
    assert [file.name for file in tmp_path.iterdir()] == ["sample.exr"]


def write_with_oiio(path: Path, values: NDArray[np.float32], names: tuple[str, ...]) -> None:
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], len(names), "float")
    spec.channelnames = names
    output: Any = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(values)
    assert output.close()


def test_linear_image_of_another_tool(tmp_path: Path) -> None:
    rgba = RNG.random((6, 8, 4)).astype(np.float32)
    write_with_oiio(tmp_path / "rgba.exr", rgba, ("R", "G", "B", "A"))
    np.testing.assert_array_equal(read_linear_image(tmp_path / "rgba.exr"), rgba[:, :, :3])
    write_with_oiio(tmp_path / "rgb.hdr", rgba[:, :, :3].copy(), ("R", "G", "B"))
    np.testing.assert_allclose(read_linear_image(tmp_path / "rgb.hdr"), rgba[:, :, :3], rtol=0, atol=1 / 128)
    tifffile.imwrite(tmp_path / "grey.tif", rgba[:, :, 0])
    np.testing.assert_array_equal(read_linear_image(tmp_path / "grey.tif"), rgba[:, :, 0])


def test_image_that_is_not_linear_float_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", DN)
    with pytest.raises(InputError, match=r"a\.tif: .*uint16.*float"):
        read_linear_image(tmp_path / "a.tif")
    write_with_oiio(tmp_path / "xy.exr", np.zeros((4, 4, 2), np.float32), ("X", "Y"))
    with pytest.raises(InputError, match=r"xy\.exr: .*'X', 'Y'"):
        read_linear_image(tmp_path / "xy.exr")


def test_exr_of_another_tool_lacks_our_parts(tmp_path: Path) -> None:
    write_with_oiio(tmp_path / "a.exr", np.zeros((4, 4, 3), np.float32), ("R", "G", "B"))
    with pytest.raises(InputError, match=r"a\.exr: lacks the part radiance"):
        read_hdr_exr(tmp_path / "a.exr")


def test_header_that_claims_more_than_the_file_can_hold_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", DN, metadata=None)
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+b") as tif:
        for tag in (256, 257, 278):
            tif.pages.first.tags[tag].overwrite(60_000)
    with pytest.raises(InputError, match=r"a\.tif: .*claims a 6866 MB image"):
        read_frame_file(tmp_path / "a.tif")


def mutations(content: bytes, seed: int) -> list[bytes]:
    """The file cut at many lengths, and with bytes changed anywhere, at its start and at its end."""
    rng = np.random.default_rng(seed)
    size = len(content)
    mutated = [content[:cut] for cut in {*range(20), *rng.integers(0, size, 30).tolist(), size - 1}]
    for low, high in [(0, size), (0, min(size, 600)), (max(size - 600, 0), size)]:
        for _ in range(30):
            changed = bytearray(content)
            for at in rng.integers(low, high, rng.integers(1, 6)):
                changed[at] = rng.integers(256)
            mutated.append(bytes(changed))
    return mutated


def refusal_is_one_line(file: Path, read: Callable[[Path], Any], path: Path) -> bool:
    """Whether `path` is refused, in one line about `file`; any exception but ours gets through."""
    try:
        read(path)
    except InputError as error:
        line = str(error)
    else:
        return False
    assert line.startswith(str(file))
    assert len(line.splitlines()) == 1
    return True


def make_dng(path: Path) -> None:
    write_dng(path, DN)


def make_tiff(path: Path) -> None:
    tifffile.imwrite(path, np.stack([DN] * 3, -1), photometric="rgb", compression="zlib")


def make_exr(path: Path) -> None:
    write_hdr_exr(path, hdr_parts((3,)), {"exposures_s": [0.1]})


def make_radiance_hdr(path: Path) -> None:
    write_with_oiio(path, RNG.random((20, 30, 3)).astype(np.float32), ("R", "G", "B"))


def make_flea3(path: Path) -> None:
    path.write_bytes(min((real_data("flea3_bracket") / "frames").iterdir()).read_bytes())


def make_slice(path: Path) -> None:
    header = '# eta = 1.5\n# flux = "incident"\n# exit = "fresnel"\n# total_r = { G = 0.5 }\n'
    path.write_text(
        header + "channel,r_mm,rd_per_mm2,sd_per_mm2\n" + "".join(f"G,{i},{1 / (i + 1)},\n" for i in range(9))
    )


def make_fit(path: Path) -> None:
    path.write_text(
        '{"format": 1, "version": "1", "input": {"path": "a", "sha256": "b"}, "options": {}, "channels": {}}'
    )


@pytest.mark.parametrize(
    ("name", "make", "read"),
    [
        ("a.dng", make_dng, read_frame_file),
        ("a.tif", make_tiff, read_frame_file),
        ("flea3.tif", make_flea3, read_frame_file),
        ("a.exr", make_exr, read_hdr_exr),
        ("a.exr", make_exr, read_linear_image),
        ("a.hdr", make_radiance_hdr, read_linear_image),
        ("slice.csv", make_slice, read_slice),
        ("fit.json", make_fit, read_fit),
    ],
)
def test_damaged_file_is_read_or_refused(
    tmp_path: Path, name: str, make: Callable[[Path], None], read: Callable[[Path], Any]
) -> None:
    file = tmp_path / name
    make(file)
    refused = 0
    for content in mutations(file.read_bytes(), seed=len(name)):
        file.write_bytes(content)
        refused += refusal_is_one_line(file, read, file)
    assert refused > 20


@pytest.mark.parametrize(("name", "read"), [("session.toml", read_session), ("frames.csv", read_frames)])
def test_damaged_session_is_read_or_refused(tmp_path: Path, name: str, read: Callable[[Path], Any]) -> None:
    write_template(tmp_path)
    (tmp_path / "frames.csv").write_text("file,kind,exposure_s\nsession.toml,sample,0.25\nframes.csv,dark,0.25\n")
    for content in mutations((tmp_path / name).read_bytes(), seed=3):
        (tmp_path / name).write_bytes(content)
        refusal_is_one_line(tmp_path / name, read, tmp_path)


@pytest.mark.parametrize(
    ("name", "make", "read"),
    [("a.dng", make_dng, read_frame_file), ("a.tif", make_tiff, read_frame_file), ("a.exr", make_exr, read_hdr_exr)],
)
def test_truncated_image_is_refused_without_noise(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    name: str,
    make: Callable[[Path], None],
    read: Callable[[Path], Any],
) -> None:
    """Cut in the pixels as in the header; LibRaw would print a line of its own on stderr."""
    make(tmp_path / name)
    content = (tmp_path / name).read_bytes()
    for cut in range(0, len(content) - 1, len(content) // 40):
        (tmp_path / name).write_bytes(content[:cut])
        with pytest.raises(InputError, match=name):
            read(tmp_path / name)
    assert capfd.readouterr() == ("", "")


def test_a_number_of_a_file_is_the_same_however_numpy_is_set_to_print() -> None:
    with np.printoptions(legacy="1.13"):
        assert positive(1 / 60) == 0.016666668
