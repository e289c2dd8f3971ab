"""`bssrdf bench render`: what it knows without rendering, how it tells bias from noise, and that it runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bssrdf.bench.render import Effort, _bias, run_render_bench
from bssrdf.bench.render_cases import MATERIALS, cases
from bssrdf.bench.render_truth import cut_share, edge_radiance, media
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import UsageError
from bssrdf.render.material import find_medium
from bssrdf.transport import table_model


@pytest.mark.parametrize("albedo", [1.0, 0.9999, 0.998])
def test_what_a_cut_off_path_carries_follows_its_power_law(albedo: float) -> None:
    n = np.arange(1, 4_000_000, dtype=float)
    light = n**-1.5 * albedo**n
    beyond = light[1000:].sum() + (2 / np.sqrt(n[-1]) if albedo == 1 else 0)
    assert cut_share(albedo, 1000) == pytest.approx(beyond / light[500:1000].sum(), rel=2e-3)


def test_without_scattering_left_nothing_is_cut_off() -> None:
    assert cut_share(0.5, 1000) < 1e-9


def test_an_edge_is_half_a_half_space_at_the_middle_and_all_of_it_far_out(x64: None) -> None:
    material = find_medium("Skin1", g=0.4)
    far = 150 * max(material.mean_free_path)
    dark, middle, lit = edge_radiance(material, np.array([-far, 0.0, far]))
    np.testing.assert_allclose(middle, lit / 2, rtol=1e-9)
    assert np.all(dark < 1e-4 * lit)
    np.testing.assert_allclose(lit - dark, lit, rtol=1e-4)


def test_light_at_an_edge_is_the_table_summed_over_the_lit_half(x64: None) -> None:
    material = find_medium("Marble")
    place = 1.28
    medium = media(material)[1]
    model = table_model(material.eta, material.g)
    x = np.linspace(0, 40, 1001)[1:] - 0.02
    y = np.linspace(-40, 40, 2001) + 0.02
    r = np.hypot(x[:, None] - place, y[None, :])
    total = np.asarray(model.rd(medium, np.maximum(r, 1e-3).ravel())).sum() * 0.04**2
    share = edge_radiance(material, np.array([place, 1e3]))[:, 1]
    assert share[0] / share[1] == pytest.approx(total / float(model.total(medium)), rel=0.02)


def test_bias_is_told_from_noise() -> None:
    rng = np.random.default_rng(1)
    truth = np.full((5, 5, 3), 2.0)
    reference = truth + rng.normal(0, 0.3, (400, 5, 5, 3))
    same = truth + rng.normal(0, 0.3, (400, 5, 5, 3))
    assert _bias(same, reference) == pytest.approx(0, abs=2e-4)
    assert _bias(1.1 * same, reference) == pytest.approx(0.01 / 1.01, rel=0.05)


def test_every_scene_is_made_of_every_material() -> None:
    names = {(case.scene_name, case.material) for case in cases(8)} - {("furnace", "white")}
    scenes = {scene for scene, _ in names}
    assert len(names) == len(scenes) * len(MATERIALS)
    assert {"sky", "edge", "bust", "ball 1", "ball 10", "ball 3, matched"} <= scenes


def test_a_scene_that_is_not_in_the_bench_is_one_line() -> None:
    with pytest.raises(UsageError, match='no scene "bal 3" in the bench; use furnace; sky; edge;'):
        run_render_bench(None, effort=Effort(scenes=("bal 3",)))


@pytest.mark.usefixtures("renderer")
def test_the_quick_bench_is_near_what_is_known_and_writes_table_numbers_and_plot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(cli, ["bench", "render", "--quick", "--quiet", "--out", str(tmp_path / "bench")]) == 0
    said = capsys.readouterr().out
    assert {path.name for path in (tmp_path / "bench").iterdir()} == {"render.json", "render.md", "render.png"}
    found = json.loads((tmp_path / "bench" / "render.json").read_text())
    assert len(found["cases"]) == 3
    ratios = {(row["scene"], row["method"]): row["ratio"] for case in found["cases"] for row in case["rows"]}
    np.testing.assert_allclose(ratios["furnace", "walks"], 1, atol=0.02)
    np.testing.assert_allclose(ratios["edge", "points"], 1, atol=0.02)
    assert min(ratios["furnace", "points"]) < 0.93  # R_d of a half space is too dark on a ball
    assert "volpath is sure to" in said
    assert run(cli, ["bench", "render", "--quick", "--quiet", "--out", str(tmp_path / "bench")]) == 2
