"""The table in the fit: an independent code's curves, g, the camera's angle, the spot, and what model error says."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders import OF_TWO_CODES, curve, curve_slice, seen_slice, slice_of

from bssrdf.fit import FitOptions, fit_slices
from bssrdf.fit.free_g import fit_g
from bssrdf.session.records import ChannelFit, Slice
from bssrdf.transport.convention import camera_factor
from bssrdf.transport.dipole import Medium
from bssrdf.transport.forward import ACROSS, DipoleModel
from bssrdf.transport.white.store import table_model

MEDIA = {"marbleG_g0": (0.0041, 2.62), "skin1G_g0.8": (0.17, 0.88), "ketchupR_g0": (0.061, 0.18)}
"""σa and σs′ [1/mm]."""


@pytest.fixture(scope="module", params=["walk", "mcml"])
def pieces(request: pytest.FixtureRequest) -> dict[str, Slice]:
    """The media of two independent codes."""
    names = [name for name in OF_TWO_CODES if name.startswith(request.param)]
    return {name.split("/")[1]: curve_slice(curve(name)) for name in names}


@pytest.fixture(scope="module")
def auto(pieces: dict[str, Slice]) -> dict[str, ChannelFit]:
    fits = fit_slices(list(pieces.values()), FitOptions(model="auto"))
    return {name: fit["G"] for name, fit in zip(pieces, fits, strict=True)}


@pytest.mark.parametrize("name", MEDIA)
def test_auto_takes_the_table_and_finds_the_coefficients_of_an_independent_code(
    name: str, auto: dict[str, ChannelFit]
) -> None:
    sigma_a, sigma_sp = MEDIA[name]
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
    camera = {"flux": "incident", "exit": "fresnel", "view_angle_deg": angle, "g": 0.8}
    piece = slice_of(np.asarray(r), entering * seen, total_r=entering * total, **camera)
    fit = fit_slices([piece], FitOptions(model="mc"))[0]["G"]
    assert fit.sigma_a_per_mm == pytest.approx(0.48, rel=2e-3)
    assert fit.sigma_sp_per_mm == pytest.approx(1.01, rel=2e-3)


@pytest.mark.parametrize(("sigma_a", "sigma_sp"), [(0.97, 0.07), (0.061, 0.18), (0.015, 0.15)])
def test_the_exit_law_of_a_dark_medium_moves_with_the_coefficients(sigma_a: float, sigma_sp: float) -> None:
    """Within a mean free path the exit law changes with the radius as fast as the curve does; light of the bench."""
    piece = seen_slice(sigma_a, sigma_sp)
    fit = fit_slices([piece], FitOptions(model="mc"))[0]["G"]
    assert fit.sigma_sp_per_mm == pytest.approx(sigma_sp, rel=0.02)
    assert fit.sigma_a_per_mm == pytest.approx(sigma_a, rel=0.02)
