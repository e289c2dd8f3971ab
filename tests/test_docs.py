"""What the documents show is run as it stands there."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from builders import OF_TWO_CODES, curve_file

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import DeviceError
from bssrdf.rig.ports import CameraPort, ShutterPort

ROOT = Path(__file__).resolve().parents[1]
CURVES = ROOT / "docs" / "curves.md"


def convert(source: Path, folder: Path) -> Path:
    """The slice that the script in docs/curves.md makes of a curve."""
    script = re.search(r"```python\n(.*?)```", CURVES.read_text(encoding="utf-8"), re.DOTALL)
    assert script
    (folder / "convert.py").write_text(script[1])
    done = subprocess.run(
        [sys.executable, "convert.py", source], cwd=folder, capture_output=True, text=True, check=True
    )
    out = folder / f"{source.stem}.csv"
    out.write_text(done.stdout)
    return out


def test_curves_from_elsewhere_are_converted_and_fitted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On exact light of marble the dipole of 2001 is off by +2 ± 2 % in σs′ and −7 ± 4 % in σa."""
    slices = [convert(source, tmp_path) for source in map(curve_file, OF_TWO_CODES[:3])]
    options = ["--model", "dipole", "--constraint", "exact", "--json"]
    assert run(cli, ["fit", *map(str, slices), *options]) == 0
    fits = {Path(fit["input"]["path"]).stem: fit for fit in map(json.loads, capsys.readouterr().out.splitlines())}
    marble = fits["marbleG_g0"]["channels"]["X"]
    assert marble["sigma_sp_per_mm"] / 2.62 - 1 == pytest.approx(0.02, abs=0.02)
    assert marble["sigma_a_per_mm"] / 0.0041 - 1 == pytest.approx(-0.07, abs=0.04)
    assert marble["window_mm"] == pytest.approx([1 / 2.62, 24 / 2.62], rel=0.1)


def test_shutter_and_camera_to_start_from_have_what_the_engine_asks_of_one(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    exec("\n".join(re.findall(r"```python\n(.*?)```", page, re.DOTALL)), names)
    assert set(dir(names["CURTAIN"].make(None, {"port": "/dev/rail"}))) >= members_of(ShutterPort)
    (tmp_path / "old.tif").write_bytes(b"a frame")
    archive = names["Archive"]({0.5: tmp_path / "old.tif"})
    assert set(dir(archive)) >= members_of(CameraPort)
    assert archive.take(0.5, tmp_path / "new", lambda: None) == tmp_path / "new.tif"
    with pytest.raises(DeviceError, match="no frame of 2 s"):
        archive.take(2.0, tmp_path / "new", lambda: None)


def members_of(port: type) -> set[str]:
    return {name for name in vars(port) if not name.startswith("_")}


def test_tables_of_keys_and_flags_say_what_is_declared() -> None:
    """`make docs-tables` writes them."""
    tables = runpy.run_path(str(ROOT / "docs" / "tables.py"))
    named = []
    for page in (ROOT / "docs").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        assert tables["written_anew"](text) == text, page.name
        named += [name for _, name, _ in tables["PLACE"].findall(text)]
    keys = [f"keys of {file}" for file in ("fit.json", "frames.csv", "plan.toml", "session.toml", "slice.csv")]
    assert sorted(named) == ["flags of fit", "flags of measure", *keys]


@pytest.mark.parametrize("page", sorted({*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")}), ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    headings = {
        re.sub(r"[^\w -]", "", line).strip().lower().replace(" ", "-") for line in re.findall("^#+ (.*)$", text, re.M)
    }
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith("#"):
            assert target[1:] in headings, target
        elif "://" not in target:
            assert (page.parent / target.split("#")[0]).exists(), target
