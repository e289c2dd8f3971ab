"""The five commands of the README, as they stand there, on a folder of RAW files with one edit of session.toml."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from filmed import edit, film, marble

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.rig.sim.scene import BenchScene

README = Path(__file__).resolve().parents[1] / "README.md"
PUBLISHED = {"R": (0.0021, 2.19), "G": (0.0041, 2.62), "B": (0.0071, 3.00)}


def commands() -> list[str]:
    section = README.read_text(encoding="utf-8").split("## Your own frames in five commands")[1]
    block = re.search(r"```\n(.*?)```", section, re.DOTALL)
    assert block
    return block[1].splitlines()


@pytest.fixture(scope="module")
def scene() -> BenchScene:
    return marble()


def test_five_commands_of_the_readme_give_the_published_marble(
    scene: BenchScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    film(scene, tmp_path / "photos")
    monkeypatch.chdir(tmp_path)
    lines = commands()
    assert len(lines) == 6
    for line in lines:
        program, *arguments = shlex.split(line, comments=True)
        if program == "$EDITOR":
            edit(Path(arguments[0]), scene)
        else:
            assert program == "bssrdf"
            assert run(cli, [*arguments, "--quiet"]) == 0, capsys.readouterr().err
    assert "Marble" in capsys.readouterr().out
    fit = json.loads(Path("marble/fit.json").read_text(encoding="utf-8"))
    for channel, (sigma_a, sigma_sp) in PUBLISHED.items():
        found = fit["channels"][channel]
        assert found["status"] == "converged"
        assert abs(found["sigma_sp_per_mm"] - sigma_sp) < 4 * found["sigma_sp_sd_per_mm"] + 0.01 * sigma_sp
        assert abs(found["sigma_a_per_mm"] - sigma_a) < 4 * found["sigma_a_sd_per_mm"] + 0.02 * sigma_a
        assert found["sigma_sp_sd_per_mm"] < 0.05 * sigma_sp
