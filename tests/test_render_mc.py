"""volpath as we set it up is the Monte Carlo of `transport`: totals, single scattering, and R_d by radius."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bssrdf.errors import BssrdfError
from bssrdf.render.material import RenderMaterial
from bssrdf.render.picture import load_stage, render_pass
from bssrdf.render.plugins import Options
from bssrdf.render.scenes.blocks import slab
from bssrdf.render.variant import use_variant
from bssrdf.transport.engine import MonteCarloMedium, simulate
from bssrdf.transport.fresnel import fresnel_r
from bssrdf.transport.single import first_order_total

SIGMA_A, SIGMA_SP, ETA = 0.3, 1.0, 1.4


@pytest.fixture(autouse=True)
def _renderer() -> None:
    try:
        use_variant("mono")
    except BssrdfError as error:
        pytest.skip(str(error))


def runs(light: str, *, eta: float, depth: int, pixels: int, samples: int, n: int = 6) -> np.ndarray:
    """Pictures of a thick slab of (0.3, 1.0)/mm from straight above, 12 mm wide, shape (n, pixels, pixels)."""
    grey = RenderMaterial("grey", (SIGMA_A,) * 3, (SIGMA_SP,) * 3, eta)
    scene = slab(grey, light=light)
    scene = replace(scene, camera=replace(scene.camera, width_mm=12.0, pixels=(pixels, pixels)))
    stage = load_stage(scene, Options("mc", mc_depth=depth), "mono")
    return np.stack([render_pass(stage, samples, seed)[..., 0] for seed in range(n)]).astype(float)


def mean_and_se(values: np.ndarray) -> tuple[float, float]:
    means = values.reshape(len(values), -1).mean(axis=1)
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means)))


def test_the_sky_seen_in_a_slab_is_the_total_of_our_monte_carlo() -> None:
    """By reciprocity the radiance along the normal is what leaves of light that entered along it."""
    mean, se = mean_and_se(runs("sky", eta=ETA, depth=300, pixels=8, samples=256))
    tally = simulate(MonteCarloMedium.reduced(SIGMA_A, SIGMA_SP, 0.0, ETA), n_photons=40_000, r_edges_mm=[0, 1], seed=1)
    total, total_se = tally.total_r()
    mirror = float(fresnel_r(ETA, 1.0))
    assert mean == pytest.approx(mirror + (1 - mirror) * total, abs=4 * np.hypot(se, total_se))
    assert se < 0.01 * mean


def test_paths_of_one_scattering_are_first_order_light(x64: None) -> None:
    mean, se = mean_and_se(runs("sky", eta=ETA, depth=4, pixels=8, samples=512))
    mirror = float(fresnel_r(ETA, 1.0))
    single = (1 - mirror) * float(first_order_total(SIGMA_SP, SIGMA_A, 0.0, ETA))
    assert mean - mirror == pytest.approx(single, abs=4 * se)
    assert se < 0.05 * single


@pytest.mark.slow
def test_a_narrow_beam_spreads_as_in_our_monte_carlo() -> None:
    """Between matched media, where volpath finds the beam by next event estimation."""
    pixels = 48
    images = runs("beam", eta=1.0, depth=120, pixels=pixels, samples=128, n=10)
    edges = np.linspace(0, 5, 51)
    tally = simulate(
        MonteCarloMedium.reduced(SIGMA_A, SIGMA_SP, 0.0, 1.0), n_photons=2_000_000, r_edges_mm=edges, seed=1
    )
    seen, _ = tally.radiance(0.0)
    axis = (np.arange(pixels) + 0.5) * 12 / pixels - 6
    radius = np.hypot(*np.meshgrid(axis, axis))
    expected = np.interp(radius, (edges[1:] + edges[:-1]) / 2, seen) / np.pi
    for low, high in ((0.75, 1.5), (1.5, 2.5), (2.5, 4.0)):
        inside = (radius > low) & (radius < high)
        mean, se = mean_and_se(images[:, inside])
        assert mean == pytest.approx(expected[inside].mean(), abs=4 * se, rel=0.02)
