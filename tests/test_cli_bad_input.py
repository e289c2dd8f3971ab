"""Bad input through the public commands: exit code 3, one line with file, value and remedy, nothing left behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from bssrdf.cli import cli
from bssrdf.commands.console import run

EXPOSURES = {"10ms": 0.01, "40ms": 0.04}
SHAPE = (16, 20)
TOML = """format = 1
[material]
name = "wax"
eta = 1.4
[camera]
layout = "mono"
[geometry]
mm_per_px = 0.1
[beam]
channels = ["633nm"]
[reference]
name = "tile"
reflectance = [0.99]
"""
SLICE = """# eta = 1.4
# flux = "entering"
# exit = "hemisphere"
# total_r = { G = 0.5 }
channel,r_mm,rd_per_mm2,sd_per_mm2
G,1,0.03,0.001
G,2,0.01,0.001
"""


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A session with two exposures of each kind, complete but for its beam: two even grey frames."""
    path = tmp_path / "session"
    (path / "frames").mkdir(parents=True)
    (path / "session.toml").write_text(TOML)
    rng = np.random.default_rng(1)
    rows = ["file,kind,exposure_s"]
    for kind in ("sample", "sample_dark", "reference", "reference_dark"):
        for label, exposure_s in EXPOSURES.items():
            level = 100 if kind.endswith("dark") else 1000
            frame = rng.poisson(level, SHAPE).astype(np.uint16)
            tifffile.imwrite(path / "frames" / f"{kind}_{label}.tif", frame)
            rows.append(f"frames/{kind}_{label}.tif,{kind},{exposure_s}")
    (path / "frames.csv").write_text("\n".join(rows) + "\n")
    return path


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line on stderr of a command that ends with exit code 3 and changes nothing on disk."""
    folder = Path(str(arguments[1])).parent
    before = tree(folder)
    capsys.readouterr()
    assert run(cli, ["--quiet", *map(str, arguments)]) == 3
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if line.strip()]
    assert len(lines) == 1, captured.err
    assert captured.out == ""
    assert tree(folder) == before
    return lines[0]


def tree(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def in_frames(old: str, new: str) -> Callable[[Path], None]:
    def spoil(session: Path) -> None:
        text = (session / "frames.csv").read_text()
        assert old in text
        (session / "frames.csv").write_text(text.replace(old, new, 1))

    return spoil


def in_toml(old: str, new: str) -> Callable[[Path], None]:
    def spoil(session: Path) -> None:
        assert old in TOML
        (session / "session.toml").write_text(TOML.replace(old, new))

    return spoil


def of_frame(name: str, change: Callable[[Path], object]) -> Callable[[Path], None]:
    return lambda session: change(session / "frames" / name) and None


def lead_outside(file: Path) -> None:
    outside = file.parents[2] / "elsewhere.tif"
    file.rename(outside)
    file.symlink_to(outside)


def saturate(session: Path) -> None:
    for label in EXPOSURES:
        tifffile.imwrite(session / "frames" / f"sample_{label}.tif", np.full(SHAPE, 65535, np.uint16))


FRAME = "sample_10ms.tif"
SESSIONS: dict[str, tuple[Callable[[Path], None], list[str]]] = {
    "missing frame": (of_frame(FRAME, Path.unlink), [FRAME, "not there", "take its line out"]),
    "missing column": (in_frames("exposure_s", "time"), ["frames.csv", "time", "exposure_s"]),
    "unknown kind": (in_frames(",sample,", ",specimen,"), ["frames.csv", "'specimen'", "one of sample"]),
    "exposure of 0": (in_frames(",sample,0.01", ",sample,0"), ["frames.csv", "'0'", "> 0"]),
    "exposure that is no number": (in_frames(",sample,0.01", ",sample,fast"), ["frames.csv", "'fast'", "> 0 [s]"]),
    "path outside": (in_frames("frames/sample_10ms.tif", "../x.tif"), ["frames.csv", "'../x.tif'", "copy the file"]),
    "link that leads outside": (of_frame(FRAME, lead_outside), ["frames.csv", FRAME, "copy the file"]),
    "no dark": (in_frames("frames/sample_dark_10ms.tif,sample_dark,0.01\n", ""), [FRAME, "0.01 s", "take one"]),
    "all saturated": (saturate, ["sample", "saturated"]),
    "another size": (
        of_frame("sample_40ms.tif", lambda f: tifffile.imwrite(f, np.zeros((12, 17), np.uint16))),
        ["sample_40ms.tif", "17 x 12"],
    ),
    "truncated TIFF": (of_frame(FRAME, lambda f: f.write_bytes(f.read_bytes()[:300])), [FRAME]),
    "rubbish for a TIFF": (of_frame(FRAME, lambda f: f.write_bytes(bytes(range(256)))), [FRAME]),
    "empty frames.csv": (lambda s: (s / "frames.csv").write_text("") and None, ["frames.csv", "holds no table"]),
    "malformed TOML": (in_toml('"wax"', '"wax'), ["session.toml", "line 3", "fix it there"]),
    "format of the future": (in_toml("format = 1", "format = 2"), ["session.toml", "format = 2", "update"]),
    "rubbish for a TOML": (
        lambda s: (s / "session.toml").write_bytes(b"\xff\xfe\x00") and None,
        ["session.toml", "UTF-8"],
    ),
    "no tables": (in_toml("[material]", "[distortion]"), ["session.toml", "distortion"]),
    "unknown key": (in_toml("mm_per_px", "mm_per_pixel"), ["session.toml", "mm_per_pixel", "mm_per_px?"]),
}


@pytest.mark.parametrize("name", SESSIONS)
def test_measure(session: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    spoil, named = SESSIONS[name]
    spoil(session)
    line = refused(capsys, "measure", session)
    assert all(text in line for text in named), line


def test_measure_of_a_truncated_raw(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw = session / "frames" / "sample_10ms.dng"
    (session / "frames" / FRAME).rename(raw)
    raw.write_bytes(raw.read_bytes()[:200])
    in_frames(FRAME, raw.name)(session)
    assert raw.name in refused(capsys, "measure", session)


SLICES: dict[str, tuple[str, str, list[str]]] = {
    "empty": (SLICE, "", ["holds no table"]),
    "no rows": ("G,1,0.03,0.001\nG,2,0.01,0.001\n", "", ["no row"]),
    "missing column": ("rd_per_mm2", "rd", ["rd", "rd_per_mm2"]),
    "NaN": ("0.03", "nan", ["line 6", "'nan'", "finite"]),
    "unsorted radii": ("G,2", "G,0.5", ["line 7", "r_mm = 0.5", "sort"]),
    "negative sd": ("0.001\nG,2", "-0.001\nG,2", ["line 6", "sd_per_mm2 = -0.001", "empty"]),
    "R above 1.1": ("0.5", "1.2", ["total_r", "1.2", "<= 1.1"]),
    "R of 0": ("0.5", "0", ["total_r", "0", "> 0"]),
    "total of another channel": ("{ G", "{ X", ["total_r", "X", "G"]),
    "malformed TOML": ('"entering"', '"entering', ["TOML", "line 2"]),
    "format of the future": ("# eta", "# format = 9\n# eta", ["format = 9", "update"]),
}


@pytest.mark.parametrize("name", SLICES)
def test_fit(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    old, new, named = SLICES[name]
    assert old in SLICE
    file = tmp_path / "slice.csv"
    file.write_text(SLICE.replace(old, new, 1))
    line = refused(capsys, "fit", file)
    assert all(text in line for text in ["slice.csv", *named]), line


def test_fit_of_binary_rubbish(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "slice.csv"
    file.write_bytes(bytes(range(256)))
    assert "UTF-8" in refused(capsys, "fit", file)


def test_fit_with_a_bad_value_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "slice.csv"
    file.write_text(SLICE)
    assert "1.5" in refused(capsys, "fit", file, "--total-r", "1.5")
    assert "red" in refused(capsys, "fit", file, "--total-r", "red=0.5")


def test_fit_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "slice.csv"
    file.write_text(SLICE)
    assert "cannot be written" in refused(capsys, "fit", file, "--out", tmp_path / "nowhere" / "fit.json")


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b"\xff\x00", b'{"format": 2}'])
def test_table(tmp_path: Path, content: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "fit.json"
    file.write_bytes(content)
    assert "fit.json" in refused(capsys, "table", file)


@pytest.mark.parametrize("command", ["measure", "verify", "fit", "table"])
def test_what_is_not_there(tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert "nowhere" in refused(capsys, command, tmp_path / "nowhere")


def test_init_where_a_file_stands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").write_text("")
    assert "taken" in refused(capsys, "init", tmp_path / "taken" / "session")
