"""`bssrdf bench render`: what it knows without rendering, how it tells bias from noise, and that it runs."""

from __future__ import annotations

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from bssrdf.bench.render import Effort, _bias, run_render_bench
from bssrdf.bench.render_cases import MATERIALS, cases
from bssrdf.bench.render_truth import cut_share, sky_radiance
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import UsageError
from bssrdf.render.material import find_medium
from bssrdf.transport.bssrdf import brdf_diffuse, brdf_single
from bssrdf.transport.dipole import Medium
from bssrdf.transport.fresnel import fresnel_r


@pytest.mark.parametrize("albedo", [1.0, 0.9999, 0.998])
def test_what_a_cut_off_path_carries_follows_its_power_law(albedo: float) -> None:
    n = np.arange(1, 4_000_000, dtype=float)
    light = n**-1.5 * albedo**n
    beyond = light[1000:].sum() + (2 / np.sqrt(n[-1]) if albedo == 1 else 0)
    assert cut_share(albedo, 1000) == pytest.approx(beyond / light[500:1000].sum(), rel=2e-3)


def test_without_scattering_left_nothing_is_cut_off() -> None:
    assert cut_share(0.5, 1000) < 1e-9


@pytest.mark.parametrize("paper", [False, True])
def test_the_sky_seen_in_a_slab_is_its_brdf_over_the_hemisphere(paper: bool, x64: None) -> None:
    material = find_medium("Skin1", g=0.4)
    nodes, weights = np.polynomial.legendre.leggauss(200)
    mu = (1 + nodes) / 2
    down = jnp.asarray(np.stack([np.sqrt(1 - mu**2), np.zeros_like(mu), mu], axis=1))
    up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), down.shape)
    expected = []
    for a, sp in zip(material.sigma_a, material.sigma_sp, strict=True):
        medium = Medium(a, sp, material.eta)
        values = brdf_diffuse(medium, down, up, paper=paper) + brdf_single(medium, material.g, down, up)
        expected.append(float(fresnel_r(material.eta, 1.0)) + np.sum(np.pi * np.asarray(values) * mu * weights))
    terms, truth = sky_radiance(material, paper=paper)
    np.testing.assert_allclose(terms, expected, rtol=1e-3)
    assert np.all(truth < sky_radiance(material)[0])


def test_bias_is_told_from_noise() -> None:
    rng = np.random.default_rng(1)
    truth = np.full((5, 5, 3), 2.0)
    reference = truth + rng.normal(0, 0.3, (400, 5, 5, 3))
    same = truth + rng.normal(0, 0.3, (400, 5, 5, 3))
    assert _bias(same, reference) == pytest.approx(0, abs=2e-4)
    assert _bias(1.1 * same, reference) == pytest.approx(0.01 / 1.01, rel=0.05)


def test_every_scene_is_made_of_every_material() -> None:
    names = {(case.scene_name, case.material) for case in cases(8)}
    scenes = {scene for scene, _ in names}
    assert len(names) == len(scenes) * len(MATERIALS)
    assert {"slab, sky", "slab, edge", "slab, beam", "thin slab", "bust", "ball 1", "ball 30"} <= scenes


def test_a_scene_that_is_not_in_the_bench_is_one_line() -> None:
    with pytest.raises(UsageError, match='no scene "bal 3" in the bench; use slab, sky; slab, edge;'):
        run_render_bench(None, effort=Effort(scenes=("bal 3",)))


@pytest.mark.usefixtures("renderer")
def test_the_quick_bench_writes_table_numbers_and_plot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(cli, ["bench", "render", "--quick", "--quiet", "--out", str(tmp_path / "bench")]) == 0
    said = capsys.readouterr().out
    assert {path.name for path in (tmp_path / "bench").iterdir()} == {"render.json", "render.md", "render.png"}
    found = json.loads((tmp_path / "bench" / "render.json").read_text())
    assert [len(case["rows"]) for case in found["cases"]] == [4, 4]
    for case in found["cases"]:
        assert all(row["variance_x_time"] > 0 for row in case["rows"])
        assert all(0 < share < 1 for share in case["cut"])
    assert "| ball 3 | Marble | mc |" in said
    assert "closed form" in said
    assert run(cli, ["bench", "render", "--quick", "--quiet", "--out", str(tmp_path / "bench")]) == 2


@pytest.mark.usefixtures("renderer")
def test_the_sky_on_a_slab_is_the_closed_form_of_the_table() -> None:
    effort = Effort(
        pixels=16,
        runs=4,
        samples=64,
        mc_samples=1,
        reference_s=0.1,
        mc_depth=20,
        materials=("Marble",),
        scenes=("slab, sky",),
    )
    (result,) = run_render_bench(None, effort=effort)
    _, truth = sky_radiance(find_medium("Marble"))
    for row in result.rows:
        if row.method != "mc":
            np.testing.assert_allclose(row.mean, truth, rtol=0.006)
