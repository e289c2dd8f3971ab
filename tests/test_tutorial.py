"""The pages that lead by the hand: each command runs as it stands, and prints what the page says."""

from __future__ import annotations

import json
import re
import runpy
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from filmed import film, marble

import bssrdf
from bssrdf.report.left_out import left_out
from bssrdf.session.frames_csv import read_frames

ROOT = Path(__file__).resolve().parents[1]
SESSION = ROOT / "docs" / "tutorial" / "marble"
SHOWN = runpy.run_path(str(ROOT / "docs" / "shown.py"))
GIVEN = {"R": (0.0021, 2.19), "G": (0.0041, 2.62), "B": (0.0071, 3.00)}


def words(text: str) -> str:
    """What was printed, but for numbers, whose last digits differ between machines, and the widths that follow them."""
    return " ".join(re.sub(r"\d+(\.\d+)?(e-?\d+)?", "#", re.sub("--+", "-", text)).split())


def run_page(name: str, folder: Path) -> None:
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    SHOWN["as_in_a_clone"](folder, text)
    blocks = list(SHOWN["shown"](text, folder))
    assert blocks
    for block, printed in blocks:
        if block["printed"] is not None:
            assert words(printed) == words(block["printed"]), f"{block['commands']}\nmake docs-shown writes it anew"


def test_tutorial_runs_as_it_stands_and_finds_what_the_light_was_made_with(tmp_path: Path) -> None:
    run_page("tutorial.md", tmp_path)
    fit: dict[str, Any] = json.loads((tmp_path / "marble" / "fit.json").read_text(encoding="utf-8"))
    for channel, (sigma_a, sigma_sp) in GIVEN.items():
        found = fit["channels"][channel]
        assert (found["status"], found["flags"]) == ("converged", [])
        assert abs(found["sigma_a_per_mm"] - sigma_a) < 3 * found["sigma_a_sd_per_mm"]
        assert abs(found["sigma_sp_per_mm"] - sigma_sp) < 3 * found["sigma_sp_sd_per_mm"]
    assert (tmp_path / "marble" / "report.html").is_file()
    assert (tmp_path / "marble.py").is_file()
    assert_every_exposure_is_predicted_by_the_others(tmp_path / "marble")


def assert_every_exposure_is_predicted_by_the_others(session: Path) -> None:
    """Also across the steps of eight of this bracket, where the shorter ones are much noisier."""
    merged = bssrdf.read_slice(session / "measured" / "slice.csv").provenance
    found = left_out(bssrdf.read_session(session), read_frames(session), merged)
    assert len(found) == 10
    assert [each for each in found if isinstance(each, str) or not each.holds] == []


def test_a_curve_from_elsewhere_runs_as_it_stands(tmp_path: Path) -> None:
    run_page("curves.md", tmp_path)


def test_frames_of_a_camera_of_your_own_run_as_it_stands(tmp_path: Path) -> None:
    film(marble(), tmp_path / "photos")
    run_page("dslr.md", tmp_path)
    fit = json.loads((tmp_path / "marble" / "fit.json").read_text(encoding="utf-8"))
    assert {channel: found["status"] for channel, found in fit["channels"].items()} == dict.fromkeys("RGB", "converged")
    assert (tmp_path / "marble" / "report.html").is_file()


def test_session_of_the_tutorial_is_what_its_script_films(tmp_path: Path) -> None:
    script = runpy.run_path(str(ROOT / "docs" / "tutorial_session.py"))
    script["main"](tmp_path / "marble")
    files = sorted(file.relative_to(SESSION) for file in SESSION.rglob("*") if file.is_file())
    assert files == sorted(file.relative_to(tmp_path / "marble") for file in tmp_path.rglob("*") if file.is_file())
    assert (tmp_path / "marble" / "session.toml").read_text() == (SESSION / "session.toml").read_text()
    assert sum((SESSION / file).stat().st_size for file in files) < 2e6
    for frame in (SESSION / "frames").iterdir():
        assert digest_of_pixels(tmp_path / "marble" / "frames" / frame.name) == digest_of_pixels(frame), frame.name


def digest_of_pixels(file: Path) -> str:
    tifffile = pytest.importorskip("tifffile")
    return sha256(tifffile.imread(file).tobytes()).hexdigest()
