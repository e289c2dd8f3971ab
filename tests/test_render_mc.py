"""The scenes' `mc` is the Monte Carlo of `transport`, in total and of one scattering."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bssrdf.errors import BssrdfError
from bssrdf.render.material import RenderMaterial
from bssrdf.render.picture import load_stage, render_pass
from bssrdf.render.plugins import RenderOptions
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
    stage = load_stage(scene, RenderOptions("mc", mc_depth=depth), "mono")
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
