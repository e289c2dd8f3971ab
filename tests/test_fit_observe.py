"""What annuli, spot and camera make of a model's curve, against plain means over pixels and radii."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from builders import slice_of

from bssrdf.fit.layout import curves_of, sight_of
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.dipole import Medium
from bssrdf.transport.forward import DipoleModel
from bssrdf.transport.light import dipole, shape_of
from bssrdf.transport.observed import averaged, azimuths, nodes, seen_at


@pytest.mark.parametrize("growth", [1.01, 1.1, 2.0])
def test_an_annulus_is_the_model_s_mean_over_its_area(growth: float) -> None:
    """Narrow ones, wide ones, and a disc about the beam, in one slice."""
    sigma_a, sigma_sp = 0.17, 0.88
    edges = np.concatenate([[0.0, 0.3], 0.3 * growth ** np.arange(1, 9)])
    lo, hi = edges[:-1], edges[1:]
    piece = slice_of((lo + hi) / 2, lo + hi, edges=(lo, hi))
    curves = curves_of([piece], ["G"], None)
    sight = sight_of(piece, curves, blurred=False)
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(sigma_a, sigma_sp))
    at = nodes(NUMPY, sight, curves)
    found = averaged(NUMPY, sight, at, dipole(1.3).look(NUMPY, q, np.exp(log_sigma) * at.r))[0]
    with jax.enable_x64(True):
        expected = np.asarray(DipoleModel(1.3).bin_average(Medium(sigma_a, sigma_sp, 1.3), lo, hi))
    np.testing.assert_allclose(np.exp(2 * log_sigma[0]) * found[0], expected, rtol=2e-5)


def test_the_spots_blur_is_the_mean_over_the_spot() -> None:
    sigma_a, sigma_sp = 0.4**2 / 3, 1 - 0.4**2 / 3
    model, r = dipole(1.3), np.array([0.5, 1.0, 3.0])
    piece = slice_of(r, r, spot_radius_mm=0.3)
    curves = curves_of([piece], ["G"], None)
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(sigma_a, sigma_sp))
    sight = sight_of(piece, curves, blurred=True)
    ratio = np.exp(seen_at(NUMPY, sight, model, curves, log_sigma, q).log_ratio[0])
    rng = np.random.default_rng(0)
    offset = 0.3 / 2 * rng.standard_normal((400_000, 2))  # 1/e² radius is two standard deviations
    for at, found in zip(r, ratio, strict=True):
        distance = np.hypot(at + offset[:, 0], offset[:, 1])
        expected = model.look(NUMPY, q, distance[None])[0].mean() / model.look(NUMPY, q, np.array([[at]]))[0][0, 0]
        assert found == pytest.approx(expected, rel=1e-3)


def test_azimuths_are_those_of_the_pixels_in_a_band() -> None:
    """Against pixels drawn along the arc, and light that enters beside the beam."""
    arc, turn = 0.9, 0.5
    azimuth = np.pi / 2 + np.linspace(-arc, arc, 100_001) + turn
    found = azimuths(NUMPY, np.array([arc]), np.array([np.sin(turn)]))
    other = azimuths(NUMPY, np.array([arc]), np.array([-np.sin(turn)]))
    both = np.concatenate([azimuth, azimuth - 2 * turn])
    assert float(found.cos_2[0] + other.cos_2[0]) / 2 == pytest.approx(np.cos(2 * both).mean(), abs=1e-4)
    assert float(found.along[0]) == 0
    whole = azimuths(NUMPY, np.array([np.pi / 2]), np.array([0.0]))
    assert (float(whole.cos_2[0]), float(whole.along[0])) == pytest.approx((0, 1), abs=1e-6)
    wide, turned = 1.3, np.pi / 2 - 1.0
    near = np.abs(np.pi / 2 + np.linspace(-wide, wide, 100_001) + turned - np.pi) < 0.01
    share = near.mean() / (0.02 / np.pi)
    assert float(azimuths(NUMPY, np.array([wide]), np.array([np.sin(turned)])).along[0]) == pytest.approx(
        share, rel=0.02
    )
