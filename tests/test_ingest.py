"""Files that exist already become a session: kinds, exposures, checksums; a real bracket up to its HDR image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from bssrdf.cli import cli
from bssrdf.console import run
from bssrdf.errors import InputError, UsageError
from bssrdf.session.frames_csv import read_frames
from bssrdf.session.hdr_exr import read_hdr_exr
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


def test_verify_passes_a_session_that_is_complete(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "s"
    ingest_folder(folder, out, kinds=RULES, camera={"layout": "mono"})
    tables = '[material]\nname = "wax"\neta = 1.4\n[geometry]\nmm_per_px = 1.0\n[reference]\nname = "tile"\n'
    (out / "session.toml").write_text(f"[camera]\n{tables}reflectance = [0.99]\n")
    assert verify_session(out).faults == []
    assert run(cli, ["verify", str(out)]) == 0


@pytest.mark.parametrize("rules", [["*dark*=dark"], ["*dark*=dark", "*600nm*=sample"]])
def test_a_real_bracket_from_folder_to_hdr_image(shared_data: Path, tmp_path: Path, rules: list[str]) -> None:
    out = tmp_path / "flea3"
    kinds = [word for rule in rules for word in ("--kind", rule)]
    source = str(shared_data / "flea3_bracket")
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
    assert parts["radiance"].shape == (344, 408)
    assert np.isfinite(parts["radiance"]).mean() > 0.99
