"""Mitsuba's own volumetric path tracer against our Monte Carlo: both are full transport."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import mitsuba as mi
from mitsuba_scenes import SKY, across_spot, beam, leaving_annulus, radiance, towards_origin

from bssrdf.transport.engine import MonteCarloMedium, simulate
from bssrdf.transport.fresnel import fresnel_t

Floats = NDArray[np.float64]


pytestmark = pytest.mark.usefixtures("mitsuba_mono")


def slab_for_volpath(sigma_a: float, sigma_s: float, g: float, eta: float) -> dict[str, Any]:
    surface = {"type": "dielectric", "int_ior": eta, "ext_ior": 1.0} if eta > 1 else {"type": "null"}
    return {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -50]).scale([200, 200, 50]),
        "bsdf": surface,
        "interior": {
            "type": "homogeneous",
            "albedo": sigma_s / (sigma_a + sigma_s),
            "sigma_t": sigma_a + sigma_s,
            "phase": {"type": "hg", "g": g} if g else {"type": "isotropic"},
        },
    }


def test_volpath_under_an_even_sky_reflects_what_our_monte_carlo_does() -> None:
    """Seen along the normal: by reciprocity the light that comes back of a beam along the normal."""
    sigma_a, sigma_s, g, eta = 0.2, 2.0, 0.4, 1.4
    scene = mi.load_dict({"type": "scene", "slab": slab_for_volpath(sigma_a, sigma_s, g, eta), "sky": SKY})
    n = 1 << 15
    value, error = radiance(scene, towards_origin(n, 1.0), n, type="volpath", max_depth=400, rr_depth=401)
    tally = simulate(MonteCarloMedium(sigma_a, sigma_s, g, eta), r_edges_mm=[0, 1], n_photons=40_000, seed=1)
    entering, entering_error = tally.total_r()
    transmitted = float(fresnel_t(eta, 1.0))
    expected = 1 - transmitted + transmitted * entering
    assert abs(value[0] - expected) < 4 * math.hypot(error[0], transmitted * entering_error)


@pytest.mark.parametrize(("order", "depth"), [("first", 2), ("all", 200)])
def test_volpath_around_a_beam_is_our_monte_carlo(order: Any, depth: int) -> None:
    """Index-matched, since no light sampling finds a beam through a refracting surface."""
    sigma_a, sigma_s, spot = 0.3, 1.0, 1.0
    scene = mi.load_dict({"type": "scene", "slab": slab_for_volpath(sigma_a, sigma_s, 0.0, 1.0), "beam": beam(spot)})
    fine = np.concatenate([[0], np.geomspace(0.02, 8, 40)])
    tally = simulate(MonteCarloMedium(sigma_a, sigma_s), r_edges_mm=fine, n_photons=400_000, seed=2)
    profile, _ = tally.rd(order)
    n = 1 << 16
    for low, high in ((0.0, 1.0), (1.0, 2.0), (2.0, 4.0)):
        rays = leaving_annulus(low, high, n, seed=6)
        value, error = radiance(scene, rays, n, type="volpath", max_depth=depth, rr_depth=depth + 1)
        distance = across_spot(low, high, spot)
        bins = np.searchsorted(fine, distance, side="right") - 1
        expected = np.append(profile, 0)[bins].mean()
        assert math.pi * value[0] == pytest.approx(expected, rel=0.02, abs=4 * math.pi * error[0])
