"""The table in the fit: an independent code's curves, g, the camera's angle, the spot, and what model error says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bssrdf.fit.free_g import fit_g
from bssrdf.fit.run import FitOptions, fit_slices
from bssrdf.fit.setting import setting_flags
from bssrdf.rig.sim.light import seen_light
from bssrdf.rig.sim.media import SampleMedium
from bssrdf.session.records import ChannelFit, ChannelSlice, Material, Slice
from bssrdf.transport.convention import camera_factor
from bssrdf.transport.dipole import Medium
from bssrdf.transport.forward import ACROSS, DipoleModel
from bssrdf.transport.white.store import table_model

CURVES = {
    "marbleG_g0": (0.0041, 2.62, 1.5, 0.0, 0.799482),
    "skin1G_g0.8": (0.17, 0.88, 1.3, 0.8, 0.193990),
    "ketchupR_g0": (0.061, 0.18, 1.3, 0.0, 0.147632),
}
"""σa, σs′, η, g and total of the shared Monte Carlo curves."""


@pytest.fixture(scope="module")
def pieces(shared_data: Path) -> dict[str, Slice]:
    return {name: _piece(shared_data, name) for name in CURVES}


def _piece(folder: Path, name: str) -> Slice:
    _, _, eta, g, total_r = CURVES[name]
    r_lo, r_hi, rd, se = np.loadtxt(folder / "mc" / f"{name}.csv", delimiter=",", skiprows=5).T
    return Slice(
        channels={"G": ChannelSlice((r_lo + r_hi) / 2, rd, np.hypot(se, 0.005 * rd), r_lo, r_hi)},
        eta=eta,
        g=g,
        flux="entering",
        exit="hemisphere",
        total_r={"G": total_r},
        total_r_sd={"G": 0.001 * total_r},
    )


@pytest.fixture(scope="module")
def auto(pieces: dict[str, Slice]) -> dict[str, ChannelFit]:
    fits = fit_slices(list(pieces.values()), FitOptions(model="auto"))
    return {name: fit["G"] for name, fit in zip(pieces, fits, strict=True)}


@pytest.mark.parametrize("name", CURVES)
def test_auto_takes_the_table_and_finds_the_coefficients_of_an_independent_code(
    name: str, auto: dict[str, ChannelFit]
) -> None:
    sigma_a, sigma_sp, *_ = CURVES[name]
    assert auto[name].model == "mc"
    assert auto[name].sigma_sp_per_mm == pytest.approx(sigma_sp, rel=0.01)
    assert auto[name].sigma_a_per_mm == pytest.approx(sigma_a, rel=0.01)
    assert auto[name].model_error["sigma_a"] < 0.02


def test_sensitivity_to_g_is_what_a_wrong_g_does(auto: dict[str, ChannelFit], pieces: dict[str, Slice]) -> None:
    wrong = fit_slices([replace(pieces["skin1G_g0.8"], g=0.79)], FitOptions(model="mc"))[0]["G"]
    right = auto["skin1G_g0.8"]
    for key in ("sigma_a", "sigma_sp"):
        shift = np.log(getattr(wrong, f"{key}_per_mm") / getattr(right, f"{key}_per_mm"))
        assert shift == pytest.approx(-0.01 * right.sensitivity[f"d_ln_{key}_d_g"], abs=0.002)


def test_g_is_found_from_the_shape_near_the_source(pieces: dict[str, Slice]) -> None:
    assert fit_g(pieces["skin1G_g0.8"], FitOptions()).g == pytest.approx(0.8, abs=0.05)
    assert fit_g(pieces["ketchupR_g0"], FitOptions()).g < 0.1


def test_a_wrong_g_is_suspected(pieces: dict[str, Slice]) -> None:
    fit = fit_slices([replace(pieces["skin1G_g0.8"], g=0.0)], FitOptions(model="mc"))[0]["G"]
    assert {"poor_fit", "g_suspect"} <= set(fit.flags)
    assert fit.status == "rejected"
    assert np.isnan(fit.sigma_a_per_mm)


def test_a_camera_at_an_angle_sees_the_tables_own_exit_law() -> None:
    medium, angle = Medium(0.48, 1.01, 1.3), 30.0
    mu = float(np.cos(np.radians(angle)))
    with jax.enable_x64(True):
        table = table_model(1.3, 0.8)
        r = jnp.linspace(0.3, 12, 64)
        seen = np.asarray(table.radiance(medium, r, mu, ACROSS))
        total = float(table.total(medium) * table.total_radiance_factor(medium, mu))
        fresnel = float(DipoleModel(1.3).total_radiance_factor(medium, mu))
    assert total / float(table.total(medium)) < 0.99 * fresnel
    entering = camera_factor(1.3, flux="incident", exit="hemisphere", view_angle_deg=angle, incidence_deg=0.0)
    piece = Slice(
        channels={"G": ChannelSlice(np.asarray(r), entering * seen, 0.01 * seen)},
        eta=1.3,
        g=0.8,
        flux="incident",
        exit="fresnel",
        view_angle_deg=angle,
        total_r={"G": entering * total},
        total_r_sd={"G": 0.002 * total},
    )
    fit = fit_slices([piece], FitOptions(model="mc"))[0]["G"]
    assert fit.sigma_a_per_mm == pytest.approx(0.48, rel=2e-3)
    assert fit.sigma_sp_per_mm == pytest.approx(1.01, rel=2e-3)


@pytest.mark.parametrize(("sigma_a", "sigma_sp"), [(0.97, 0.07), (0.061, 0.18), (0.015, 0.15)])
def test_the_exit_law_of_a_dark_medium_moves_with_the_coefficients(sigma_a: float, sigma_sp: float) -> None:
    """Within a mean free path the exit law changes with the radius as fast as the curve does; light of the bench."""
    light = seen_light(SampleMedium(sigma_a, sigma_sp, 1.3), 45.0, photons=1, seed=1)
    assert light.harmonics is not None
    edges, across = light.r_edges_mm, 1 + np.cos(np.arange(1, 13) * np.pi / 2) @ light.harmonics
    used = (edges[:-1] * (sigma_a + sigma_sp) > 0.7) & (light.beyond[1:] > 1e-4 * light.total)
    lo, hi = edges[:-1][used], edges[1:][used]
    rd = (-np.diff(light.beyond) * across)[used] / (np.pi * (hi**2 - lo**2))
    piece = Slice(
        channels={"G": ChannelSlice((lo + hi) / 2, rd, 0.01 * rd, lo, hi)},
        eta=1.3,
        flux="incident",
        exit="fresnel",
        g=0.0,
        total_r={"G": light.total},
        total_r_sd={"G": 0.002 * light.total},
    )
    fit = fit_slices([piece], FitOptions(model="mc"))[0]["G"]
    assert fit.sigma_sp_per_mm == pytest.approx(sigma_sp, rel=0.02)
    assert fit.sigma_a_per_mm == pytest.approx(sigma_a, rel=0.02)


def test_the_sample_s_mounting_is_flagged(auto: dict[str, ChannelFit]) -> None:
    marble = auto["marbleG_g0"]
    assert setting_flags(Material("m", 1.5), marble) == ()
    assert setting_flags(Material("m", 1.5, thickness_mm=100.0, width_mm=100.0), marble) == ()
    small = Material("m", 1.5, thickness_mm=10.0, width_mm=20.0, cover="glass", finish="rough")
    assert setting_flags(small, marble) == ("narrow_sample", "rough_finish", "thin_sample", "under_glass")
