"""`validate`: what is measured over rings is compared over the same rings."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from bssrdf.bench import finite_light
from bssrdf.fit import FitOptions, fit_slice
from bssrdf.report import validation
from bssrdf.report.validation import validate
from bssrdf.session.records import ChannelFit, ChannelSlice, Fit, Slice
from bssrdf.transport.dipole import Medium
from bssrdf.transport.white.store import table_model

SIGMA_A, SIGMA_SP, ETA = 0.4, 1.0, 1.3


def a_fit() -> Fit:
    channel = ChannelFit(
        model="mc",
        sigma_a_per_mm=SIGMA_A,
        sigma_a_sd_per_mm=0.004,
        sigma_a_interval95_per_mm=(0.39, 0.41),
        sigma_sp_per_mm=SIGMA_SP,
        sigma_sp_sd_per_mm=0.01,
        sigma_sp_interval95_per_mm=(0.98, 1.02),
        correlation=0.0,
        total_r_measured=0.1,
        total_r_model=0.1,
        window_mm=(0.0, 8.0),
        n=8,
        chi2_reduced=1.0,
        status="converged",
    )
    return Fit("0", "slice.csv", "", {}, None, ETA, 0.0, {"G": channel})


def a_slice(edges: np.ndarray) -> Slice:
    """The table's light of the fit's medium, as means over wide rings."""
    with jax.enable_x64(True):
        rd = np.asarray(table_model(ETA, 0.0).bin_average(Medium(SIGMA_A, SIGMA_SP, ETA), edges[:-1], edges[1:]))
    middle = (edges[1:] + edges[:-1]) / 2
    part = ChannelSlice(middle, rd, 0.01 * rd, edges[:-1], edges[1:])
    return Slice({"G": part}, ETA, "entering", "hemisphere", g=0.0)


@pytest.fixture(autouse=True)
def few_photons(monkeypatch):
    monkeypatch.setattr(validation, "PHOTONS", 40_000)


def test_wide_rings_are_compared_as_rings():
    rings = a_slice(np.arange(0, 8.5, 1.0))
    [check] = validate(a_fit(), rings)
    assert abs(check.median_departure) < 0.01
    as_points = replace(rings.channels["G"], r_lo_mm=None, r_hi_mm=None)
    [wrong] = validate(a_fit(), replace(rings, channels={"G": as_points}))
    assert wrong.median_departure > 0.05


def test_without_a_shipped_table_the_dipole_carries_the_simulation(monkeypatch):
    monkeypatch.setattr(validation, "tabulated", lambda eta, g: False)
    [check] = validate(a_fit(), a_slice(np.arange(0, 8.5, 0.5)))
    assert abs(check.median_departure) < 0.02


def test_a_thin_sample_is_simulated_as_it_was_held() -> None:
    case = next(c for c in finite_light.slabs() if c.material == "Skimmilk" and 7 < c.depth_mfp < 9 and c.back == 0.0)
    piece = finite_light.slice_of(case)
    fit = replace(a_fit(), eta=case.eta, g=case.g, channels=fit_slice(piece, FitOptions(model="mc", tables="shipped")))
    [check] = validate(fit, piece, photons=40_000)
    assert check.total_r == pytest.approx(piece.total_r[case.channel], abs=4 * check.total_r_se + 0.003)
    assert abs(check.median_departure) < 0.03
    [deep] = validate(fit, replace(piece, thickness_mm=None, backing=None), photons=40_000)
    assert deep.total_r > check.total_r + 0.05
