"""What the documents show is run as it stands there."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from builders import OF_TWO_CODES, curve_file

from bssrdf.cli import cli
from bssrdf.commands.console import run

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
