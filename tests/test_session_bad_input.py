"""Bad input to the readers of a session: one line that names the file, the value and the remedy."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bssrdf.errors import InputError
from bssrdf.session.fit_json import read_fit
from bssrdf.session.frame_files import read_frame_file, read_linear_image
from bssrdf.session.frames_csv import dark_for, read_frames
from bssrdf.session.hdr_image import read_hdr_exr
from bssrdf.session.records import Frame
from bssrdf.session.session_toml import read_calibration, read_session
from bssrdf.session.slice_csv import read_slice

FRAMES_HEADER = "file,kind,exposure_s\n"
SLICE_HEADER = '# eta = 1.5\n# flux = "incident"\n# exit = "fresnel"\n'
COLUMNS = "channel,r_mm,rd_per_mm2,sd_per_mm2\n"


def refusal(read: Callable[..., Any], *args: Any) -> str:
    """The one line with which `read` refuses its input."""
    with pytest.raises(InputError) as caught:
        read(*args)
    line = str(caught.value)
    assert len(line.splitlines()) == 1
    assert len(line) < 600
    return line


SESSION_CASES = {
    "malformed TOML": ("[camera\n", ["is not TOML", "line 1"]),
    "a format of the future": ("format = 2\n[camera]\n", ["format = 2", "update bssrdf"]),
    "a format that is no number": ('format = "1"\n[camera]\n', ["format = '1'"]),
    "no camera": ("[beam]\n", ["lacks [camera]"]),
    "a table that is a value": ("camera = 3\n", ["camera = 3", "[camera]"]),
    "a misspelt table": ("[camera]\n[materiel]\n", ["materiel", "material"]),
    "a misspelt key": ("[camera]\nblak = 3\n", ["[camera] blak", "black"]),
    "a misspelt key at the top": ('calibraton = "c.toml"\n[camera]\n', ["calibraton", "calibration"]),
    "a layout that is no pattern": ('[camera]\nlayout = "RGB"\n', ["layout = 'RGB'", "RGGB"]),
    "black above white": ("[camera]\nblack = 9\nwhite = 8\n", ["black = 9", "white = 8"]),
    "a negative black level": ("[camera]\nblack = -1\n", ["black = -1", ">= 0"]),
    "a true number": ("[camera]\nwhite = true\n", ["white = True", "number"]),
    "gain 0": ("[camera]\ngain_e_per_dn = 0\n", ["gain_e_per_dn = 0", "> 0"]),
    "eta not finite": ('[camera]\n[material]\nname = "x"\neta = inf\n', ["[material] eta = inf", "finite"]),
    "eta negative": ('[camera]\n[material]\nname = "x"\neta = -1.5\n', ["eta = -1.5", "> 0"]),
    "no eta": ('[camera]\n[material]\nname = "x"\n', ["lacks [material] eta", "eta = 1.3"]),
    "g of 1": ('[camera]\n[material]\nname = "x"\neta = 1.3\ng = 1.0\n', ["g = 1.0", "< 1"]),
    "an unknown cover": ('[camera]\n[material]\nname = "x"\neta = 1.3\ncover = "foil"\n', ["cover = 'foil'", "glass"]),
    "no scale": ("[camera]\n[geometry]\n", ["lacks [geometry] mm_per_px"]),
    "two scales": (
        "[camera]\n[geometry]\nmm_per_px = 1.0\nhomography = [[1,0,0],[0,1,0],[0,0,1]]\n",
        ["mm_per_px", "homography", "keep one"],
    ),
    "a singular homography": ("[camera]\n[geometry]\nhomography = [[1,2,0],[2,4,0],[0,0,1]]\n", ["homography", "3x3"]),
    "a homography of two rows": ("[camera]\n[geometry]\nhomography = [[1,0,0],[0,1,0]]\n", ["homography", "3"]),
    "a grazing view": ("[camera]\n[geometry]\nmm_per_px = 1\nview_angle_deg = 90\n", ["view_angle_deg = 90", "< 90"]),
    "an unknown axis": ('[camera]\n[geometry]\nmm_per_px = 1\nview_axis = "z"\n', ["view_axis = 'z'", "x, y"]),
    "an unknown beam": ('[camera]\n[beam]\nkind = "sun"\n', ["kind = 'sun'", "white, led, laser"]),
    "a kind that is a list": ("[camera]\n[beam]\nkind = []\n", ["kind = []"]),
    "a channel twice": ('[camera]\n[beam]\nchannels = ["R", "R"]\n', ["channels", "twice"]),
    "no channel": ("[camera]\n[beam]\nchannels = []\n", ["channels = []"]),
    "reflectance 0": ('[camera]\n[reference]\nname = "x"\nreflectance = [0.0]\n', ["reflectance = [0.0]", "> 0"]),
    "reflectance in percent": (
        '[camera]\n[reference]\nname = "x"\nreflectance = [99]\n',
        ["[99]", "not per cent: give 0.99"],
    ),
    "errors of other channels": (
        '[camera]\n[reference]\nname = "x"\nreflectance = [0.9]\nreflectance_sd = [0.1, 0.1]\n',
        ["reflectance_sd", "2 values", "1"],
    ),
    "a calibration outside": ('calibration = "../c.toml"\n[camera]\n', ["'../c.toml'", "outside"]),
    "a calibration that is not there": ('calibration = "c.toml"\n[camera]\n', ["c.toml", "cannot be read"]),
}


@pytest.mark.parametrize("name", SESSION_CASES)
def test_session_toml(tmp_path: Path, name: str) -> None:
    content, words = SESSION_CASES[name]
    (tmp_path / "session.toml").write_text(content)
    line = refusal(read_session, tmp_path)
    assert line.startswith(str(tmp_path))
    for word in words:
        assert word in line


FRAMES_CASES = {
    "empty": ("", ["holds no table", "file,kind,exposure_s"]),
    "no frame": (FRAMES_HEADER, ["no frame"]),
    "a missing column": ("file,kind\na.tif,sample\n", ["exposure_s"]),
    "an unknown column": ("file,kind,exposure\na.tif,sample,1\n", ["exposure", "exposure_s"]),
    "a column twice": ("file,kind,exposure_s,kind\na.tif,sample,1,sample\n", ["twice"]),
    "an unknown kind": (FRAMES_HEADER + "a.tif,simple,1\n", ["line 2", "'simple'", "sample"]),
    "exposure 0": (FRAMES_HEADER + "a.tif,sample,0\n", ["line 2", "'0'", "> 0 [s]"]),
    "exposure negative": (FRAMES_HEADER + "a.tif,sample,-1\n", ["'-1'"]),
    "exposure not a number": (FRAMES_HEADER + "a.tif,sample,1/250\n", ["'1/250'", "a finite number > 0 [s]"]),
    "exposure NaN": (FRAMES_HEADER + "a.tif,sample,nan\n", ["'nan'"]),
    "exposure infinite": (FRAMES_HEADER + "a.tif,sample,inf\n", ["'inf'"]),
    "a measured exposure below 0": (
        "file,kind,exposure_s,exposure_measured_s\na.tif,sample,1,-1\n",
        ["exposure_measured_s '-1'"],
    ),
    "a short row": (FRAMES_HEADER + "a.tif,sample\n", ["line 2", "2 fields"]),
    "a hash cut short": ("file,kind,exposure_s,sha256\na.tif,sample,1,abc\n", ["sha256 'abc'", "64"]),
    "a time that is none": ("file,kind,exposure_s,utc\na.tif,sample,1,noon\n", ["utc 'noon'"]),
    "a missing frame": (FRAMES_HEADER + "b.tif,sample,1\n", ["b.tif", "not there"]),
    "a frame twice": (FRAMES_HEADER + "a.tif,sample,1\na.tif,sample,1\n", ["a.tif", "twice"]),
    "a path outside": (FRAMES_HEADER + "../a.tif,sample,1\n", ["'../a.tif'", "outside"]),
    "an absolute path": (FRAMES_HEADER + "/etc/hostname,sample,1\n", ["'/etc/hostname'", "outside"]),
    "a link that leads outside": (FRAMES_HEADER + "frames/link.tif,sample,1\n", ["'frames/link.tif'", "outside"]),
    "a link that leads to itself": (FRAMES_HEADER + "loop/a.tif,sample,1\n", ["loop/a.tif"]),
    "a comment first": (
        "# mine\n" + FRAMES_HEADER + "a.tif,sample,1\n",
        ["begins with a comment", "file,kind,exposure_s"],
    ),
    "no file": (FRAMES_HEADER + ",sample,1\n", ["line 2", "file ''"]),
    "a quote left open": (FRAMES_HEADER + '"a.tif,sample,1\n', ["CSV"]),
    "binary rubbish": (b"\xff\xfe\x00\x81\x00", ["UTF-8"]),
    "a NUL": (FRAMES_HEADER + "a\0.tif,sample,1\n", ["file 'a\\x00.tif'"]),
}


@pytest.mark.parametrize("name", FRAMES_CASES)
def test_frames_csv(tmp_path: Path, name: str) -> None:
    content, words = FRAMES_CASES[name]
    session = tmp_path / "s"
    (session / "frames").mkdir(parents=True)
    (session / "a.tif").touch()
    (tmp_path / "out.tif").touch()
    (session / "frames" / "link.tif").symlink_to(tmp_path / "out.tif")
    (session / "loop").symlink_to(session / "loop")
    (session / "frames.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    line = refusal(read_frames, session)
    assert str(session) in line
    for word in words:
        assert word in line


def test_no_dark_for_an_exposure() -> None:
    frames = [Frame("s.tif", "sample", 0.25), Frame("d.tif", "sample_dark", 0.2505), Frame("e.tif", "flat_dark", 0.25)]
    line = refusal(dark_for, frames[0], frames)
    assert "s.tif" in line
    assert "0.25 s" in line
    assert "take one" in line


SLICE_CASES = {
    "empty": ("", ["holds no table", "channel,r_mm"]),
    "no rows": (SLICE_HEADER + COLUMNS, ["no row"]),
    "no table": (SLICE_HEADER, ["no table"]),
    "a format of the future": ("# format = 7\n" + SLICE_HEADER + COLUMNS + "G,1,1,1\n", ["format = 7", "update"]),
    "malformed TOML": ("# eta = \n# g = 0.5\n" + COLUMNS + "G,1,1,1\n", ["is not TOML", "line 1"]),
    "no eta": ('# flux = "incident"\n# exit = "fresnel"\n' + COLUMNS + "G,1,1,1\n", ["lacks eta", "--eta"]),
    "no flux": ('# eta = 1.3\n# exit = "fresnel"\n' + COLUMNS + "G,1,1,1\n", ["lacks flux", "incident"]),
    "an unknown flux": (
        '# flux = "all"\n# eta = 1.3\n' + COLUMNS + "G,1,1,1\n",
        ["flux = 'all'", "incident, entering"],
    ),
    "an unknown exit": ('# exit = "all"\n# eta = 1.3\n' + COLUMNS + "G,1,1,1\n", ["exit = 'all'", "lambertian"]),
    "a misspelt key": (SLICE_HEADER + "# totalr = 0.5\n" + COLUMNS + "G,1,1,1\n", ["totalr", "total_r"]),
    "a missing column": (SLICE_HEADER + "channel,r_mm,rd_per_mm2\nG,1,1\n", ["sd_per_mm2"]),
    "an unknown column": (SLICE_HEADER + "channel,r,rd_per_mm2,sd_per_mm2\nG,1,1,1\n", ["column r", "r_mm"]),
    "a short row": (SLICE_HEADER + COLUMNS + "G,1,1\n", ["line 5", "3 fields"]),
    "no channel": (SLICE_HEADER + COLUMNS + ",1,1,1\n", ["line 5", "channel"]),
    "a value NaN": (SLICE_HEADER + COLUMNS + "G,1,nan,1\n", ["line 5", "rd_per_mm2 = 'nan'", "finite"]),
    "a radius NaN": (SLICE_HEADER + COLUMNS + "G,nan,1,1\n", ["r_mm = 'nan'"]),
    "an sd NaN": (SLICE_HEADER + COLUMNS + "G,1,1,nan\n", ["sd_per_mm2 = 'nan'"]),
    "a value missing": (SLICE_HEADER + COLUMNS + "G,1,,1\n", ["rd_per_mm2 = ''"]),
    "a value infinite": (SLICE_HEADER + COLUMNS + "G,1,-inf,1\n", ["rd_per_mm2 = '-inf'"]),
    "a value that is text": (SLICE_HEADER + COLUMNS + "G,1,1,1\nG,2,x,\n", ["line 6", "'x'"]),
    "a negative radius": (SLICE_HEADER + COLUMNS + "G,-1,1,1\n", ["r_mm = -1.0"]),
    "a negative sd": (SLICE_HEADER + COLUMNS + "G,1,1,-0.5\n", ["sd_per_mm2 = -0.5", "empty"]),
    "unsorted radii": (SLICE_HEADER + COLUMNS + "G,1,1,1\nR,0,1,1\nG,0.5,1,1\n", ["line 7", "r_mm = 0.5", "sort"]),
    "half a bin": (SLICE_HEADER + "r_lo_mm," + COLUMNS + "0,G,1,1,1\n", ["r_lo_mm", "both"]),
    "an empty bin": (
        SLICE_HEADER + "r_lo_mm,r_hi_mm," + COLUMNS + "1,1,G,1,1,1\n",
        ["r_hi_mm = 1.0", "above r_lo_mm"],
    ),
    "a radius outside its bin": (
        SLICE_HEADER + "r_lo_mm,r_hi_mm," + COLUMNS + "1,2,G,3,1,1\n",
        ["r_mm = 3.0", "between"],
    ),
    "a side of 0": (SLICE_HEADER + "side," + COLUMNS + "0,G,1,1,1\n", ["side = 0.0", "-1 or 1"]),
    "a total above 1.1": (SLICE_HEADER + "# total_r = { G = 1.2 }\n" + COLUMNS + "G,1,1,1\n", ["1.2", "<= 1.1"]),
    "a total of 0": (SLICE_HEADER + "# total_r = { G = 0 }\n" + COLUMNS + "G,1,1,1\n", ["total_r", "0", "> 0"]),
    "a negative error of the total": (
        SLICE_HEADER + "# total_r_sd = { G = -0.1 }\n" + COLUMNS + "G,1,1,1\n",
        ["total_r_sd", "-0.1"],
    ),
    "a total for a channel that is not there": (
        SLICE_HEADER + "# total_r = { B = 0.5 }\n" + COLUMNS + "G,1,1,1\n",
        ["total_r", "B", "G"],
    ),
    "a total that is no number": (
        SLICE_HEADER + "# total_r = '0.5'\n" + COLUMNS + "G,1,1,1\n",
        ["total_r = '0.5'", "number"],
    ),
    "all the light lost": (
        SLICE_HEADER + "# lost_fraction = 1\n" + COLUMNS + "G,1,1,1\n",
        ["lost_fraction = 1", "< 1"],
    ),
    "binary rubbish": (bytes(range(256)), ["UTF-8"]),
}


@pytest.mark.parametrize("name", SLICE_CASES)
def test_slice_csv(tmp_path: Path, name: str) -> None:
    content, words = SLICE_CASES[name]
    file = tmp_path / "slice.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    line = refusal(read_slice, file)
    assert line.startswith(str(file))
    for word in words:
        assert word in line


def test_slice_with_a_bad_value_on_the_command_line(tmp_path: Path) -> None:
    file = tmp_path / "slice.csv"
    file.write_text(SLICE_HEADER + COLUMNS + "G,1,1,1\n")
    with pytest.raises(InputError, match=r"slice.csv: eta = -1.0 must be a finite number > 0"):
        read_slice(file, eta=-1.0)


FIT_CASES = {
    "not JSON": ("{", ["is not JSON"]),
    "a list": ("[]", ["is not a fit"]),
    "a format of the future": ('{"format": 2}', ["format = 2", "update"]),
    "an input that failed": ('{"format": 1, "input": {}, "error": {"code": 3}}', ["lacks version"]),
    "deep nesting": ("[" * 100_000, ["is not JSON"]),
}


@pytest.mark.parametrize("name", FIT_CASES)
def test_fit_json(tmp_path: Path, name: str) -> None:
    content, words = FIT_CASES[name]
    file = tmp_path / "fit.json"
    file.write_text(content)
    line = refusal(read_fit, file)
    assert line.startswith(str(file))
    for word in words:
        assert word in line


@pytest.mark.parametrize("suffix", [".tif", ".exr", ".hdr", ".dng", ".nef", ".cr3", ".jpg", ""])
@pytest.mark.parametrize(
    "content", [b"", b"\0" * 64, b"II*\0", os.urandom(500)], ids=["empty", "zeros", "magic", "random"]
)
def test_image_that_is_rubbish(tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str, content: bytes) -> None:
    file = tmp_path / f"frame{suffix}"
    file.write_bytes(content)
    readers: list[Callable[[Path], Any]] = [read_frame_file, read_linear_image, read_hdr_exr]
    for read in readers:
        assert refusal(read, file).startswith(str(file))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "read", [read_frame_file, read_linear_image, read_hdr_exr, read_slice, read_fit, read_calibration]
)
@pytest.mark.parametrize("name", ["none.tif", "none.dng", "folder.tif"])
def test_file_that_is_not_there(tmp_path: Path, read: Callable[[Path], Any], name: str) -> None:
    (tmp_path / "folder.tif").mkdir()
    assert refusal(read, tmp_path / name).startswith(str(tmp_path / name))
