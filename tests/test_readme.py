"""The five commands of the README, as they stand there, on a folder of RAW files with one edit of session.toml."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.rig.sim.media import published_sample, white_tile
from bssrdf.rig.sim.picture import picture
from bssrdf.rig.sim.raw_files import dng_bytes
from bssrdf.rig.sim.scene import BenchScene
from bssrdf.rig.sim.sensor import SimSensor, expose, mosaic

README = Path(__file__).resolve().parents[1] / "README.md"
EXPOSURES_S = (1 / 1000, 1 / 250, 1 / 60, 1 / 15, 1 / 4, 1.0, 4.0)
PUBLISHED = {"R": (0.0021, 2.19), "G": (0.0041, 2.62), "B": (0.0071, 3.00)}


def commands() -> list[str]:
    section = README.read_text(encoding="utf-8").split("## Your own frames in five commands")[1]
    block = re.search(r"```\n(.*?)```", section, re.DOTALL)
    assert block
    return block[1].splitlines()


@pytest.fixture(scope="module")
def scene() -> BenchScene:
    return BenchScene(published_sample("marble"), white_tile(), SimSensor(height_px=300, width_px=400))


def film(scene: BenchScene, folder: Path) -> None:
    """A bracket of the marble and of the tile, and darks, with names as a camera gives them."""
    rng = np.random.default_rng(5)
    light = {}
    for name, sample in (("stone", scene.sample), ("tile", scene.tile)):
        powers = zip(scene.light(sample).items(), scene.channel_power, strict=True)
        light[name] = mosaic(
            scene.sensor, {channel: power * picture(seen, scene.view) for (channel, seen), power in powers}
        )
    scale = 0.1 * scene.sensor.full_well_e / (max(plane.max() for plane in light.values()) * EXPOSURES_S[0])
    for name, plane in (*light.items(), ("dark", np.zeros(scene.sensor.shape))):
        (folder / name).mkdir(parents=True)
        for number, exposure_s in enumerate(EXPOSURES_S):
            dn = expose(scene.sensor, scale * plane, exposure_s, rng)
            (folder / name / f"IMG_{number:04}.DNG").write_bytes(dng_bytes(dn, scene.sensor, exposure_s))


def edit(file: Path, scene: BenchScene) -> None:
    text = file.read_text(encoding="utf-8")
    values = {
        "name": ('"unnamed"', '"Marble"'),
        "eta": ("1.3", "1.5"),
        "mm_per_px": ("0.05", str(scene.mm_per_px)),
        "reflectance": ("[0.99, 0.99, 0.99]", str([round(factor, 4) for factor in scene.radiance_factors(scene.tile)])),
    }
    for key, (old, new) in values.items():
        assert f"\n{key} = {old}" in text
        text = text.replace(f"\n{key} = {old}", f"\n{key} = {new}")
    file.write_text(text.replace("\n# g = 0.0", "\ng = 0.0"), encoding="utf-8")


def test_five_commands_of_the_readme_give_the_published_marble(
    scene: BenchScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    film(scene, tmp_path / "photos")
    monkeypatch.chdir(tmp_path)
    lines = commands()
    assert len(lines) == 5
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
