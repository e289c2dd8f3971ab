"""Oblique beams and tilted cameras: what the side does is in the interval. The light is walked apart from tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bssrdf.bench.camera_light import CameraLight
from bssrdf.bench.oblique_light import oblique_lights, oblique_slices
from bssrdf.fit import FitOptions, fit_slices
from bssrdf.fit.layout import curves_of, sight_of
from bssrdf.rig import SampleMedium
from bssrdf.session.records import ChannelFit, Slice
from bssrdf.transport import shipped_table
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.discrete_ordinates import half_spaces
from bssrdf.transport.exit_radiance import transmittance
from bssrdf.transport.light import shape_of
from bssrdf.transport.light_errors import side_modes, side_of_total
from bssrdf.transport.observed import middles

MEDIA = {0.0: SampleMedium(0.1, 1.0, 1.33, 0.0), 0.8: SampleMedium(0.1, 1.0, 1.4, 0.8)}
BEAM_DEG, VIEW_DEG = 45.0, 30.0
SEEDS = 12


@pytest.fixture(scope="module", params=MEDIA)
def lights(request) -> list[CameraLight]:
    """From the normal, and from the side that the beam runs to and the other."""
    return oblique_lights(MEDIA[request.param], BEAM_DEG, (0.0, VIEW_DEG, -VIEW_DEG), range(SEEDS), photons=60_000)


def test_its_total_is_that_of_discrete_ordinates_over_both_sides(lights: list[CameraLight]) -> None:
    m = lights[0].medium
    sigma_s, sine = m.sigma_sp / (1 - m.g), np.sin(np.radians(BEAM_DEG))
    cosines = np.cos(np.radians([0.0, VIEW_DEG]))
    exact = half_spaces(np.array([sigma_s / (sigma_s + m.sigma_a)]), m.g, m.eta, cosines, sin_incidence=float(sine))
    seen = np.array([light.total.mean() for light in lights]) / transmittance(m.eta, np.cos(np.radians(BEAM_DEG)))
    assert seen[0] == pytest.approx(exact.radiance[0, 0], rel=0.01)
    assert seen[1:].mean() == pytest.approx(exact.radiance[0, 1], rel=0.01)


def departure(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.asarray((one - other) / (one + other))


def test_what_the_side_of_the_camera_does_is_stated_and_not_much_more(lights: list[CameraLight]) -> None:
    """Of the curve near the beam, where the sides differ by 5 to 30 %, and of R."""
    m, (_, ahead, behind) = lights[0].medium, lights
    piece = oblique_slices(ahead, BEAM_DEG, "perpendicular", 1)[0]
    curves = curves_of([piece], ["G"], None)
    sight = sight_of(piece, curves)
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(m.sigma_a, m.sigma_sp))
    table, x = shipped_table(m.eta, m.g), middles(NUMPY, curves, log_sigma)
    stated = side_modes(NUMPY, table, sight.cos_view, sight.slant, q, x, curves.arc)[0][0]
    n = min(stated.size, ahead.across.shape[1], behind.across.shape[1])
    near = np.flatnonzero(curves.r_lo[0, :n] < 1.5)
    seen = np.abs(departure(ahead.across.mean(axis=0)[near], behind.across.mean(axis=0)[near]))
    assert np.mean(seen) > 0.05
    assert 0.3 < np.mean(seen) / np.mean(stated[near]) < 1.1
    of_total = abs(departure(ahead.total.mean(), behind.total.mean()))
    told = float(np.linalg.norm(side_of_total(table, sight.slant, q)))
    assert of_total < told + 0.005
    assert told == 0 or of_total > 0.3 * told


def fits_of(pieces: list[Slice]) -> list[ChannelFit]:
    return [each["G"] for each in fit_slices(pieces, FitOptions(model="mc", tables="shipped"))]


def tilted(pieces: list[Slice], beam_deg: float) -> list[Slice]:
    return [replace(piece, incidence_deg=beam_deg) for piece in pieces]


def test_intervals_hold_on_whichever_side_of_a_beam_near_the_normal_the_camera_stands() -> None:
    """At 9° the table is that of a normal beam, and R differs by 1 % between the sides at 50°."""
    beam, view, m = 9.0, 50.0, MEDIA[0.8]
    _, ahead, behind = oblique_lights(m, beam, (0.0, view, -view), range(40, 40 + SEEDS), photons=60_000)
    pieces = [p for light in (ahead, behind) for p in oblique_slices(light, beam, "perpendicular", 3)]
    fits = fits_of(pieces)
    assert {fit.status for fit in fits} == {"converged"}
    for key in ("sigma_a", "sigma_sp"):
        ends = [getattr(fit, f"{key}_interval95_per_mm") for fit in fits]
        assert np.mean([lo <= getattr(m, key) <= hi for lo, hi in ends]) > 0.85
    assert all(fit.budget["sigma_a"]["side"] > 0.05 and "side_unknown" in fit.flags for fit in fits)
    for plain in fits_of(tilted(pieces[:2], 0.0)):
        assert "side" not in plain.budget["sigma_a"]
        assert "side_unknown" not in plain.flags


def test_a_camera_along_the_normal_has_no_side() -> None:
    [light] = oblique_lights(MEDIA[0.8], 9.0, (0.0,), range(SEEDS), photons=20_000)
    for fit in fits_of(oblique_slices(light, 9.0, "perpendicular", 4)[:2]):
        assert "side_unknown" not in fit.flags
        assert "side" not in fit.budget["sigma_sp"]


def test_light_scattered_once_lies_along_the_beam_of_a_camera_at_the_normal() -> None:
    """In a medium so dark that next to nothing is scattered twice."""
    m, beam = SampleMedium(5.0, 0.2, 1.33, 0.0), 45.0
    [light] = oblique_lights(m, beam, (0.0,), range(4), photons=100_000)
    sine = float(np.sin(np.radians(beam)))
    table = shipped_table(m.eta, m.g)._replace(sin_beam=sine / m.eta)
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(m.sigma_a, m.sigma_sp))
    middle = np.sqrt(light.r_edges_mm[1:] * light.r_edges_mm[:-1])[None]
    once = np.exp(2 * log_sigma) * table._first_radiance(NUMPY, q, np.exp(log_sigma) * middle, 1.0)[0]
    entering = float(transmittance(m.eta, np.cos(np.radians(beam))))
    seen, near = light.around.mean(axis=0) / entering, slice(0, 24)
    assert np.median(seen[near] / once[0, near]) == pytest.approx(1.03, abs=0.05)
    slopes = table._first_radiance(NUMPY, q, np.exp(log_sigma) * middle, 0.8)
    for k, (dx, dq) in enumerate(((1e-5, 0.0), (0.0, 1e-5)), start=1):
        ahead, back = (
            table._first_radiance(NUMPY, q + s * dq, np.exp(log_sigma + s * dx) * middle, 0.8)[0] for s in (1, -1)
        )
        np.testing.assert_allclose(slopes[k], (ahead - back) / 2e-5, rtol=1e-5, atol=1e-9)
