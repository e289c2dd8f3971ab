"""Where light that leaves runs to, by a literal walk: photons exit or are reflected, and each exit is looked at."""

from __future__ import annotations

from itertools import pairwise

import jax
import numpy as np
import pytest
from numba import njit

from bssrdf.bench.camera_light import camera_lights
from bssrdf.rig.sim.light import SeenLight
from bssrdf.rig.sim.media import SampleMedium, r_edges_mfp
from bssrdf.rig.sim.walked_light import walked
from bssrdf.transport.dipole import Medium
from bssrdf.transport.exit_radiance import transmittance
from bssrdf.transport.forward import ACROSS, WHOLE_CIRCLE
from bssrdf.transport.photon import reflectance_inside
from bssrdf.transport.white.store import table_model

ALBEDO, ETA = 0.6779, 1.4
R_EDGES = np.array([0.0, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0])
MU2 = (0.4, 0.6)
HALF_SECTOR_DEG = 15.0
BATCHES = 16


@njit
def exits(n_photons: int, seed: int, r_edges: np.ndarray, sine_of_sector: float) -> np.ndarray:
    """All light, that within MU2, and that within MU2 at a right angle to the radius, in every annulus."""
    np.random.seed(seed)  # noqa: NPY002
    out = np.zeros((3, r_edges.size - 1))
    for _ in range(n_photons):
        x = y = z = ux = uy = 0.0
        uz = weight = 1.0
        inside = True
        while inside and weight > 1e-4:
            d = -np.log(1 - np.random.random())  # noqa: NPY002
            while z + d * uz < 0:
                b = -z / uz
                x, y, z, d = x + ux * b, y + uy * b, 0.0, d - b
                reflected, mu = reflectance_inside(1.4, -uz)
                if np.random.random() >= reflected:  # noqa: NPY002
                    i = np.searchsorted(r_edges, np.hypot(x, y)) - 1
                    if i < r_edges.size - 1:
                        out[0, i] += weight
                        if 0.4 < mu * mu < 0.6:
                            out[1, i] += weight
                            if abs(x * ux + y * uy) < sine_of_sector * np.hypot(x, y) * np.hypot(ux, uy):
                                out[2, i] += weight
                    inside = False
                    break
                uz = -uz
            x, y, z = x + ux * d, y + uy * d, z + uz * d
            weight *= 0.6779
            uz = 2 * np.random.random() - 1  # noqa: NPY002
            phi, s = 2 * np.pi * np.random.random(), np.sqrt(1 - uz * uz)  # noqa: NPY002
            ux, uy = s * np.cos(phi), s * np.sin(phi)
    return out


@pytest.fixture(scope="module")
def seen() -> tuple[np.ndarray, np.ndarray]:
    """Radiance factors of the literal walk, all azimuths and perpendicular, and their standard errors."""
    sine = np.sin(np.radians(HALF_SECTOR_DEG))
    light = np.stack([exits(150_000, seed, R_EDGES, sine) for seed in range(BATCHES)])
    share = np.array([1, 180 / (2 * HALF_SECTOR_DEG)]) / (MU2[1] - MU2[0])
    factors = light[:, 1:] * share[:, None] / light[:, :1].mean(0)
    return factors.mean(0), factors.std(0, ddof=1) / np.sqrt(BATCHES)


def of_the_table(perpendicular: bool) -> np.ndarray:
    """The table's factor over each annulus and the window of exit angles."""
    mu = np.sqrt(np.linspace(*MU2, 21)[None, 1::2])
    factors = []
    with jax.enable_x64(True):
        model, medium = table_model(ETA, 0.0), Medium(1 - ALBEDO, ALBEDO, ETA)
        for lo, hi in pairwise(R_EDGES):
            r = np.linspace(lo, hi, 17)[1::2, None]
            flux = np.asarray(model.rd(medium, r)) * r
            seen = np.asarray(model.radiance(medium, r, mu, ACROSS if perpendicular else WHOLE_CIRCLE)) * r
            factors.append(seen.mean() / flux.mean())
    return np.array(factors)


def test_the_mean_over_all_azimuths_is_that_of_the_walk(seen: tuple[np.ndarray, np.ndarray]) -> None:
    assert np.abs(of_the_table(False) - seen[0][0]) == pytest.approx(0, abs=0.005 + 3 * seen[1][0].max())


def test_across_the_radius_less_is_seen(seen: tuple[np.ndarray, np.ndarray]) -> None:
    """To 2 % from one mean free path on; the sector of ±15° lets 5 % of the second harmonic through."""
    factors, errors = seen
    far = R_EDGES[:-1] >= 1
    assert np.all(factors[1, far] < 0.95 * factors[0, far])
    gap = np.abs(of_the_table(True) - factors[1])
    assert np.all(gap[far] < 0.02 + 3 * errors[1, far])
    assert np.all(gap[~far] < 0.05 + 3 * errors[1, ~far])


def test_the_simulated_camera_sees_the_same(seen: tuple[np.ndarray, np.ndarray]) -> None:
    beyond, line_beyond, *harmonics = walked(SampleMedium(1 - ALBEDO, ALBEDO, ETA), 45.0, photons=600_000, seed=8)
    light = SeenLight(r_edges_mfp(), beyond, np.array(harmonics)[:, :-1], line_beyond)
    across = np.cos(np.arange(1, 13) * np.pi / 2) @ light.harmonics
    annulus = -np.diff(light.beyond)
    for i, (lo, hi) in enumerate(pairwise(R_EDGES)):
        inside = (light.r_edges_mm[:-1] >= lo) & (light.r_edges_mm[1:] <= hi)
        if lo >= 1:
            ratio = np.sum((annulus * (1 + across))[inside]) / np.sum((annulus - np.diff(light.line_beyond))[inside])
            assert ratio == pytest.approx(seen[0][1, i] / seen[0][0, i], abs=0.02 + 3 * seen[1][1, i])


def test_across_the_view_of_forward_scattering_media_the_table_is_a_walk_scored_there() -> None:
    """Skin at g 0.8, where light still runs outwards far from the beam; single radii within what a fit allows for."""
    medium = SampleMedium(0.17, 0.88, 1.3, 0.8)
    sigma_tp = medium.sigma_a + medium.sigma_sp
    for light in camera_lights(medium, (45.0, 60.0), range(5), photons=60_000):
        rings = light.r_edges_mm * sigma_tp
        mu = np.cos(np.radians(light.view_angle_deg))
        with jax.enable_x64(True):
            model, entered = table_model(1.3, 0.8), Medium(medium.sigma_a, medium.sigma_sp, 1.3)
            r = np.sqrt(light.r_edges_mm[1:] * light.r_edges_mm[:-1])
            seen = np.asarray(model.radiance(entered, r, mu, ACROSS)) * transmittance(1.3, np.array(1.0))
        gap = np.mean(light.across, axis=0) / seen - 1
        error = light.noise / np.sqrt(5)
        far = (rings[:-1] > 1.5) & (rings[1:] < 6)
        assert abs(gap[far].mean()) < 0.005 + 2.5 * np.sqrt(np.square(error[far]).sum()) / far.sum()
        near = (rings[:-1] > 0.3) & (rings[1:] < 1.5)
        assert np.all(np.abs(gap[near]) < 0.12 + 4 * error[near])
