"""Files that exist already become a session: kinds, exposures, checksums; a real bracket up to its HDR image."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from builders import bent_bracket, real_data

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError, UsageError
from bssrdf.session.frame_files import read_frame_file
from bssrdf.session.frames_csv import read_frames
from bssrdf.session.hdr_image import read_hdr_exr
from bssrdf.session.ingest import ingest_folder
from bssrdf.session.session_toml import read_session, write_template
from bssrdf.session.verify import verify_session


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Frames of a sample and of a tile, with darks, exposures in the names."""
    path = tmp_path / "photos"
    for name in (
        *("wax/a_10ms_1.tif", "wax/a_0.25s_1.tif", "tile/b_10ms.tif", "tile/b_0.25s.tif"),
        *("lid/c_10ms.tif", "lid/c_0.25s.tif"),
    ):
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(path / name, np.full((4, 6), len(name), np.uint16))
    (path / "notes.txt").write_text("not a frame")
    return path


RULES = ("wax/*=sample", "tile/*=reference", "lid/*=dark")


def test_every_image_is_listed_with_kind_exposure_and_checksum(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "session"
    frames = ingest_folder(folder, out, kinds=RULES, camera={"layout": "mono", "white": 65535.0})
    assert read_frames(out) == frames
    assert [(frame.file, frame.kind, frame.exposure_s) for frame in frames] == [
        ("frames/lid/c_0.25s.tif", "dark", 0.25),
        ("frames/lid/c_10ms.tif", "dark", 0.01),
        ("frames/tile/b_0.25s.tif", "reference", 0.25),
        ("frames/tile/b_10ms.tif", "reference", 0.01),
        ("frames/wax/a_0.25s_1.tif", "sample", 0.25),
        ("frames/wax/a_10ms_1.tif", "sample", 0.01),
    ]
    assert (out / "frames/wax/a_10ms_1.tif").read_bytes() == (folder / "wax/a_10ms_1.tif").read_bytes()
    assert read_session(out).camera.layout == "mono"


def test_session_that_is_started_is_the_template_with_the_keys_that_were_given(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "session"
    ingest_folder(folder, out, kinds=RULES, camera={"layout": "mono", "white": 4095.0})
    write_template(tmp_path / "new")
    started, template = ((path / "session.toml").read_text().splitlines() for path in (out, tmp_path / "new"))
    changed = [line for line in started if line not in template]
    assert [line.split("#")[0].strip() for line in changed] == ['layout = "mono"', "white = 4095.0"]
    assert [line.partition("#")[2] for line in changed if "#" in line]
    assert len(started) == len(template)
    assert sum("aperture_mm" in line for line in started) == 1
    session = read_session(out, complete=True)
    assert (session.camera.layout, session.camera.white, session.camera.aperture_mm) == ("mono", 4095.0, 6.25)


def test_the_last_rule_that_matches_wins(folder: Path, tmp_path: Path) -> None:
    frames = ingest_folder(folder, tmp_path / "s", kinds=("*=sample", "lid/*=dark", "c_10ms*=sample_dark"))
    assert [frame.kind for frame in frames] == ["dark", "sample_dark", *["sample"] * 4]


def test_a_kind_in_the_path_needs_no_rule(tmp_path: Path) -> None:
    for name in ("reference/a_1s.tif", "reference_dark/a_1s.tif", "x_sample_1s.tif", "x-dark_1s.tif"):
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(tmp_path / "in" / name, np.zeros((4, 6), np.uint16))
    kinds = {frame.file: frame.kind for frame in ingest_folder(tmp_path / "in", tmp_path / "s")}
    assert kinds == {
        "frames/reference/a_1s.tif": "reference",
        "frames/reference_dark/a_1s.tif": "reference_dark",
        "frames/x_sample_1s.tif": "sample",
        "frames/x-dark_1s.tif": "dark",
    }


STACK = np.stack([np.full((6, 8), level, np.uint16) for level in (110, 140, 260)])


def test_a_stack_becomes_a_file_for_each_picture(tmp_path: Path) -> None:
    (tmp_path / "in" / "sample").mkdir(parents=True)
    plane = {"ExposureTime": [1.0, 4.0, 16.0], "ExposureTimeUnit": ["ms"] * 3}
    tifffile.imwrite(tmp_path / "in/sample/a.ome.tif", STACK, metadata={"axes": "TYX", "Plane": plane})
    frames = ingest_folder(tmp_path / "in", tmp_path / "s")
    assert [(frame.file, frame.kind, frame.exposure_s, frame.exposure_rel_sd) for frame in frames] == [
        (f"frames/sample/a.ome_page{page}.tif", "sample", exposure_s, 0.001)
        for page, exposure_s in enumerate((0.001, 0.004, 0.016), 1)
    ]
    for frame, data in zip(frames, STACK, strict=True):
        np.testing.assert_array_equal(read_frame_file(tmp_path / "s" / frame.file).data, data)
    assert verify_session(tmp_path / "s").frames == frames


def test_a_stack_that_does_not_tell_its_exposures_needs_a_table(tmp_path: Path) -> None:
    (tmp_path / "in" / "dark").mkdir(parents=True)
    (tmp_path / "in" / "sample").mkdir(parents=True)
    for kind in ("sample", "dark"):
        tifffile.imwrite(tmp_path / "in" / kind / "a_250ms.tif", STACK, metadata=None, photometric="minisblack")
    with pytest.raises(InputError, match="stack of pictures that does not tell the exposure of each"):
        ingest_folder(tmp_path / "in", tmp_path / "s")
    lines = [f"{kind}/a_250ms.tif,{page},{page} ms" for kind in ("sample", "dark") for page in (1, 2, 3)]
    (tmp_path / "times.csv").write_text("\n".join(["file,page,exposure_s", *lines]))
    frames = ingest_folder(tmp_path / "in", tmp_path / "s", exposure_from=str(tmp_path / "times.csv"))
    assert [frame.exposure_s for frame in frames] == [0.001, 0.002, 0.003] * 2
    with pytest.raises(InputError, match="--exposure-from"):
        ingest_folder(tmp_path / "in", tmp_path / "t", exposure_from="_(x)")


def test_a_page_of_a_stack_and_a_file_never_share_a_name(tmp_path: Path) -> None:
    folder = tmp_path / "in" / "sample"
    folder.mkdir(parents=True)
    for name, data in (("a.tif", STACK), ("a_page1.tif", STACK[0])):
        tifffile.imwrite(folder / name, data, metadata=None, photometric="minisblack")
    with pytest.raises(InputError, match=r"a_page1.tif: a page of a stack would take the name of another file"):
        ingest_folder(tmp_path / "in", tmp_path / "s", exposure_from=str(listed(tmp_path, "sample/a.tif,,1")))


def test_a_table_of_exposures_with_two_for_one_picture_is_refused(tmp_path: Path) -> None:
    (tmp_path / "in" / "sample").mkdir(parents=True)
    tifffile.imwrite(tmp_path / "in" / "sample" / "a.tif", STACK[0], metadata=None, photometric="minisblack")
    with pytest.raises(InputError, match=r"line 3: lists 'sample/a.tif' again"):
        ingest_folder(tmp_path / "in", tmp_path / "s", exposure_from=str(listed(tmp_path, "sample/a.tif,,7")))


def listed(folder: Path, line: str) -> Path:
    table = folder / "times.csv"
    table.write_text("\n".join(["file,page,exposure_s", "sample/a.tif,,1", line, "sample/a_page1.tif,,1"]))
    return table


def test_hidden_files_and_sidecars_are_no_frames(folder: Path, tmp_path: Path) -> None:
    for name in ("wax/._a_10ms_1.tif", ".Trashes/a_1s.tif", "__MACOSX/wax/a_1s.tif", "wax/.hidden_1s.tif"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"sidecar")
    assert len(ingest_folder(folder, tmp_path / "s", kinds=RULES)) == 6


def test_png_of_16_bits_is_a_frame_and_one_of_8_a_preview(folder: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(folder / "wax/a_0.5s.png"), np.full((4, 6), 900, np.uint16))
    cv2.imwrite(str(folder / "wax/preview.png"), np.full((4, 6), 90, np.uint8))
    frames = [frame.file for frame in ingest_folder(folder, tmp_path / "s", kinds=RULES)]
    assert "frames/wax/a_0.5s.png" in frames
    assert len(frames) == 7
    for file in folder.rglob("*"):
        if file.is_file() and file.name != "preview.png":
            file.unlink()
    with pytest.raises(InputError, match="ask for JPEG or PNG by --response"):
        ingest_folder(folder, tmp_path / "t", kinds=RULES)


@pytest.mark.parametrize("name", [b"caf\xe9_1s.tif", b"a\nb_1s.tif"])
def test_a_name_that_frames_csv_cannot_hold_is_refused_in_one_line(
    folder: Path, tmp_path: Path, name: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        Path(os.fsdecode(bytes(folder / "wax") + b"/" + name)).write_bytes((folder / "wax/a_10ms_1.tif").read_bytes())
    except OSError:
        pytest.skip("the file system does not take such a name")
    kinds = [word for rule in RULES for word in ("--kind", rule)]
    assert run(cli, ["ingest", str(folder), "--out", str(tmp_path / "s"), *kinds]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert "whose name is not plain text; rename it" in line
    assert not (tmp_path / "s").exists()


def test_merged_images_are_taken_with_exposure_1(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).random((9, 7, 3)).astype(np.float32)
    for name in ("sample_hdr/a.tif", "reference-hdr_b.pfm"):
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
    tifffile.imwrite(tmp_path / "in/sample_hdr/a.tif", picture, photometric="rgb")
    (tmp_path / "in/reference-hdr_b.pfm").write_bytes(b"PF\n7 9\n-1.0\n" + picture.astype("<f4").tobytes())
    frames = ingest_folder(tmp_path / "in", tmp_path / "s")
    assert [(frame.kind, frame.exposure_s) for frame in frames] == [("reference_hdr", 1.0), ("sample_hdr", 1.0)]
    rgbe = np.full((2, 3, 4), 130, np.uint8)
    (tmp_path / "radiance").mkdir()
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n"
    for kind in ("sample", "reference"):
        (tmp_path / "radiance" / f"{kind}.hdr").write_bytes(head + rgbe.tobytes())
    assert [frame.kind for frame in ingest_folder(tmp_path / "radiance", tmp_path / "t")] == [
        "reference_hdr",
        "sample_hdr",
    ]


def test_select_leaves_out_light_frames_but_no_darks(folder: Path, tmp_path: Path) -> None:
    frames = ingest_folder(folder, tmp_path / "s", kinds=RULES, select="10ms")
    assert [frame.kind for frame in frames] == ["dark", "dark", "reference", "sample"]


def test_a_session_inside_the_folder_is_not_read_again(folder: Path) -> None:
    first = ingest_folder(folder, folder / "session", kinds=RULES)
    assert ingest_folder(folder, folder / "session", kinds=RULES) == first


@pytest.mark.parametrize("out", [".", ".."])
def test_the_folder_that_is_read_is_never_replaced(folder: Path, out: str) -> None:
    with pytest.raises(UsageError, match="would replace"):
        ingest_folder(folder, folder / out, kinds=RULES)
    assert (folder / "wax/a_10ms_1.tif").exists()


@pytest.mark.parametrize(
    ("rules", "message"),
    [(("wax",), "GLOB=kind"), (("wax/*=specimen",), "specimen"), (("waxx/*=sample",), "matches none of the 6")],
)
def test_rules_that_cannot_be_meant_are_refused(
    folder: Path, tmp_path: Path, rules: tuple[str, ...], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        ingest_folder(folder, tmp_path / "s", kinds=rules)


def test_what_is_unclear_is_refused_and_leaves_nothing(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "s"
    with pytest.raises(InputError, match=r"b_0\.25s\.tif: its kind is unclear; .*'tile/\*=sample'"):
        ingest_folder(folder, out, kinds=("wax/*=sample", "lid/*=dark"))
    with pytest.raises(InputError, match="no light frame has 'zzz' in its path"):
        ingest_folder(folder, out, kinds=RULES, select="zzz")
    with pytest.raises(InputError, match="'RGBX' must be a 2x2"):
        ingest_folder(folder, out, kinds=RULES, camera={"layout": "RGBX"})
    (folder / "wax/a_10ms_1.tif").rename(folder / "wax/a.tif")
    with pytest.raises(InputError, match=r"a\.tif: has no exposure"):
        ingest_folder(folder, out, kinds=RULES)
    (folder / "wax/a.tif").rename(folder / "wax/a_2s.tif")
    (folder / "wax/a_2s.tif").write_bytes(b"rubbish")
    with pytest.raises(InputError, match=r"a_2s\.tif"):
        ingest_folder(folder, out, kinds=RULES)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["photos"]


@pytest.mark.parametrize(("name", "agrees"), [("a_250ms", False), ("a_1-250s", True), ("a_4.2ms", True), ("a", True)])
def test_a_name_that_contradicts_the_metadata_is_asked_about(tmp_path: Path, name: str, agrees: bool) -> None:
    """A shutter before a camera that is set to another time: which one holds, only its user knows."""
    (tmp_path / "in/sample").mkdir(parents=True)
    file = tmp_path / f"in/sample/{name}.tif"
    tifffile.imwrite(file, np.ones((8, 8), np.uint16), extratags=[(33434, "2I", 1, (1, 250), True)])
    if agrees:
        (frame,) = ingest_folder(tmp_path / "in", tmp_path / "out")
        assert frame.exposure_s == pytest.approx(0.004)
    else:
        with pytest.raises(InputError, match=r"0\.004 s by its metadata and 0\.25 s by its name"):
            ingest_folder(tmp_path / "in", tmp_path / "out")
        rule = r"_(?P<ms>\d+)ms"
        (frame,) = ingest_folder(tmp_path / "in", tmp_path / "out", exposure_from=rule)
        assert frame.exposure_s == 0.25


def test_verify_finds_everything_that_changed(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "s"
    ingest_folder(folder, out, kinds=RULES, camera={"layout": "mono"})
    (out / "frames/wax/a_10ms_1.tif").unlink()
    with (out / "frames/tile/b_0.25s.tif").open("ab") as file:
        file.write(b"x")
    table = out / "frames.csv"
    table.write_text("".join(line for line in table.read_text().splitlines(True) if "lid/c_10ms" not in line))
    faults = verify_session(out).faults
    for text in ('"unnamed"', "a_10ms_1.tif: is not there", "b_0.25s.tif: has changed"):
        assert sum(text in fault for fault in faults) == 1
    assert sum("no sample_dark or dark of 0.01 s" in fault for fault in faults) == 1
    assert sum("no reference_dark or dark of 0.01 s" in fault for fault in faults) == 1
    assert len(faults) == 5


def test_verify_names_a_file_by_hand_that_cannot_be_read(folder: Path, tmp_path: Path) -> None:
    ingest_folder(folder, tmp_path / "s", kinds=RULES, camera={"layout": "mono"})
    table = tmp_path / "s/frames.csv"
    table.write_text("".join(f"{','.join(line.split(',')[:3])}\n" for line in table.read_text().splitlines()))
    (tmp_path / "s/frames/lid/c_10ms.tif").write_bytes(b"<html>")
    assert [fault for fault in verify_session(tmp_path / "s").faults if "c_10ms.tif: is a web page" in fault]


def test_verify_passes_a_session_that_is_complete(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "s"
    ingest_folder(folder, out, kinds=RULES, camera={"layout": "mono"})
    tables = '[material]\nname = "wax"\neta = 1.4\n[geometry]\nmm_per_px = 1.0\n[reference]\nname = "tile"\n'
    (out / "session.toml").write_text(f"[camera]\n{tables}reflectance = [0.99]\n")
    (fault,) = verify_session(out).faults
    assert "a_0.25s_1.tif: does not tell its layout" in fault or "b_0.25s.tif: does not tell its layout" in fault
    (out / "session.toml").write_text(f'[camera]\nlayout = "mono"\n{tables}reflectance = [0.99]\n')
    assert verify_session(out).faults == []
    assert run(cli, ["verify", str(out)]) == 0


@pytest.mark.parametrize("rules", [["*dark*=dark"], ["*dark*=dark", "*600nm*=sample"]])
@pytest.mark.parametrize("camera", ["simulated", "flea3"])
def test_a_bracket_of_8_bits_from_folder_to_hdr_image(camera: str, tmp_path: Path, rules: list[str]) -> None:
    out = tmp_path / "s"
    folder = tmp_path / "in" if camera == "simulated" else real_data("flea3_bracket")
    if camera == "simulated":
        bent_bracket(folder, 600)
        bent_bracket(folder, 450)
    kinds = [word for rule in rules for word in ("--kind", rule)]
    source = str(folder)
    assert run(cli, ["ingest", source, "--out", str(out), "--select", "600nm", "--layout", "GBRG", *kinds]) == 0
    frames = read_frames(out)
    assert sorted(frame.exposure_s for frame in frames if frame.kind == "sample") == [
        *(0.025, 0.05, 0.1, 0.25, 0.5, 2.0, 3.916),
    ]
    assert sum(frame.kind == "dark" for frame in frames) == 14
    assert run(cli, ["ingest", source, "--out", str(out), "--select", "600nm", *kinds]) == 2
    assert run(cli, ["measure", str(out), "--hdr-only", "--quiet"]) == 0
    assert [file.name for file in (out / "measured").iterdir()] == ["sample.exr"]
    parts, _ = read_hdr_exr(out / "measured" / "sample.exr")
    assert parts["radiance"].shape == ((172, 204) if camera == "simulated" else (344, 408))
    assert np.isfinite(parts["radiance"]).mean() > 0.99


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint32", "float32"])
def test_frames_of_any_numbers_come_to_an_hdr_image_or_a_line(tmp_path: Path, dtype: str) -> None:
    """One frame and a dark that equals it: hardly a bracket, but no bug of ours either."""
    rng = np.random.default_rng(2)
    values = rng.integers(20, 200, (48, 64)) if dtype != "float32" else rng.random((48, 64))
    for kind in ("sample", "dark"):
        (tmp_path / "in" / kind).mkdir(parents=True)
        tifffile.imwrite(tmp_path / "in" / kind / "a_250ms.tif", values.astype(dtype))
    assert run(cli, ["ingest", str(tmp_path / "in"), "--out", str(tmp_path / "s"), "--layout", "mono"]) == 0
    assert run(cli, ["measure", str(tmp_path / "s"), "--hdr-only", "--quiet"]) in (0, 3)


def test_what_is_known_already_goes_into_session_toml(folder: Path, tmp_path: Path) -> None:
    kinds = [f"--kind={rule}" for rule in RULES]
    words = ["ingest", str(folder), *kinds, "--layout", "mono", "--white", "65535"]
    known = ["--material", "wax", "--eta", "1.44", "--mm-per-px", "0.04", "--view-angle-deg", "30"]
    tile = ["--reference", "0.98", "--reference-sd", "0.004"]
    assert run(cli, [*words, "--out", str(tmp_path / "told"), *known, *tile]) == 0
    session = read_session(tmp_path / "told", complete=True)
    assert session.material
    assert session.geometry
    assert session.reference
    assert (session.material.name, session.material.eta) == ("wax", 1.44)
    assert (session.geometry.mm_per_px, session.geometry.view_angle_deg) == (0.04, 30.0)
    assert (session.reference.reflectance, session.reference.reflectance_sd) == ((0.98,), (0.004,))
    for wrong in (["--eta", "-1"], ["--reference", "0.9,0.8", "--reference-sd", "0.1"]):
        assert run(cli, [*words, "--out", str(tmp_path / "wrong"), *wrong]) == 3
    assert run(cli, [*words, "--out", str(tmp_path / "wrong"), "--reference", "white"]) == 2
    assert not (tmp_path / "wrong").exists()


def test_links_are_followed_and_none_is_lost_or_read_twice(folder: Path, tmp_path: Path) -> None:
    for name in ("lid", "tile"):
        (folder / name).rename(tmp_path / name)
        (folder / name).symlink_to(tmp_path / name)
    (folder / "wax/up").symlink_to(folder)
    (folder / "again").symlink_to(folder / "wax")
    assert len(ingest_folder(folder, tmp_path / "s", kinds=RULES)) == 6
    (folder / "wax/a_2s.tif").symlink_to(tmp_path / "nowhere.tif")
    with pytest.raises(InputError, match=r"a_2s\.tif: is a link to what is not there"):
        ingest_folder(folder, tmp_path / "t", kinds=RULES)
