"""The fit: what the 2001 method does on exact light, consistency over the whole table, and SciPy's optima."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest
from builders import OF_TWO_CODES, changed, curve, curve_slice, model_slice
from scipy.optimize import least_squares

from bssrdf.errors import InputError
from bssrdf.fit import FitOptions, fit_slice, fit_slices
from bssrdf.session.records import ChannelFit, Slice
from bssrdf.transport import dipole, light
from bssrdf.transport.dipole import Medium
from bssrdf.transport.forward import DipoleModel
from bssrdf.transport.materials import CHANNELS, load_materials

CELLS = [(name, channel) for name in load_materials() for channel in CHANNELS]


def dipole_slice(medium: Medium, seed: int, *, noise: float = 0.01, total_sd: float = 0.0) -> Slice:
    """A curve of the dipole from 1 to 30 mean free paths with relative noise, and its exact total."""
    sigmas, r_mfp = (float(medium.sigma_a), float(medium.sigma_sp)), np.linspace(1, 30, 200)
    noise_of = {"noise": noise, "sd": noise, "total_sd": total_sd, "seed": seed}
    return model_slice(DipoleModel(float(medium.eta)), *sigmas, r_mfp, **noise_of)


@pytest.fixture(scope="module")
def table_fits() -> dict[tuple[str, str], ChannelFit]:
    materials = load_materials()
    slices = [dipole_slice(materials[name].medium(channel), seed) for seed, (name, channel) in enumerate(CELLS)]
    fits = fit_slices(slices, FitOptions(model="dipole", constraint="exact"))
    return {cell: fit["G"] for cell, fit in zip(CELLS, fits, strict=True)}


@pytest.mark.parametrize("cell", CELLS, ids="-".join)
def test_a_dipole_curve_of_every_cell_of_the_table_is_fitted_back(
    cell: tuple[str, str], table_fits: dict[tuple[str, str], ChannelFit]
) -> None:
    medium = load_materials()[cell[0]].medium(cell[1])
    fit = table_fits[cell]
    assert fit.sigma_sp_per_mm == pytest.approx(medium.sigma_sp, rel=0.03)
    if cell[0] == "Spectralon":
        assert fit.status == "upper_bound"
        assert fit.sigma_a_interval95_per_mm[0] == 0
        assert np.isfinite(fit.sigma_a_interval95_per_mm[1])
    else:
        assert fit.status == "converged"
        assert abs(fit.sigma_a_per_mm - medium.sigma_a) < 3 * fit.sigma_a_sd_per_mm


@pytest.mark.parametrize("name", [name for name in OF_TWO_CODES if "marble" in name])
def test_the_method_of_2001_on_exact_light_of_marble(name: str) -> None:
    marble = curve(name)
    piece = curve_slice(replace(marble, se=0 * marble.se), least_sd=0.01, total_sd=0.0)
    fit = fit_slice(piece, FitOptions(model="dipole", constraint="exact"))["G"]
    assert fit.sigma_sp_per_mm / 2.62 - 1 == pytest.approx(0.02, abs=0.02)
    assert fit.sigma_a_per_mm / 0.0041 - 1 == pytest.approx(-0.07, abs=0.04)
    lo, hi = np.asarray(fit.window_mm) * (fit.sigma_sp_per_mm + fit.sigma_a_per_mm)
    assert 0.97 < lo < 1.2
    assert 20 < hi <= 24.5


@pytest.mark.parametrize("constraint", ["exact", "soft", "none"])
def test_the_optimum_is_that_of_scipy(constraint: str) -> None:
    medium = Medium(0.0041, 2.62, 1.5)
    piece = dipole_slice(medium, 5, total_sd=0.002)
    fit = fit_slice(piece, FitOptions(model="dipole", constraint=constraint, window_mm=(0.45, 8.5)))["G"]  # type: ignore[arg-type]
    channel = piece.channels["G"]
    inside = (channel.r_mm >= fit.window_mm[0]) & (channel.r_mm <= fit.window_mm[1])
    q_of_r = np.sqrt(3 * fit.sigma_a_per_mm / (fit.sigma_a_per_mm + fit.sigma_sp_per_mm))

    with jax.enable_x64(True):
        found = Medium(fit.sigma_a_per_mm, fit.sigma_sp_per_mm, 1.5)
        allowance = light.dipole(1.5).relative_error * np.asarray(dipole.rd(found, channel.r_mm))
    sd = np.hypot(channel.sd_per_mm2, allowance)

    def residual(x: np.ndarray) -> np.ndarray:
        sigma_tp, q = np.exp(x[0]), x[1] if len(x) > 1 else q_of_r
        with jax.enable_x64(True):
            there = Medium(q**2 / 3 * sigma_tp, (1 - q**2 / 3) * sigma_tp, 1.5)
            rest = (channel.rd_per_mm2 - np.asarray(dipole.rd(there, channel.r_mm))) / sd
            gap = (piece.total_r["G"] - float(dipole.total_r(there))) / piece.total_r_sd["G"]
        return np.append(rest[inside], gap) if constraint == "soft" else rest[inside]

    start = [np.log(2.0)] if constraint == "exact" else [np.log(2.0), 0.1]
    best = least_squares(residual, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert np.log(fit.sigma_sp_per_mm + fit.sigma_a_per_mm) == pytest.approx(best.x[0], abs=1e-6)
    assert q_of_r == pytest.approx(best.x[-1] if constraint != "exact" else q_of_r, rel=1e-6)


def test_the_stated_errors_are_the_scatter_over_trials() -> None:
    medium = Medium(0.17, 0.88, 1.3)
    slices = [dipole_slice(medium, seed, total_sd=1e-9) for seed in range(256)]
    rng = np.random.default_rng(1)
    noisy = [
        replace(
            piece,
            total_r={"G": piece.total_r["G"] * (1 + 0.002 * rng.standard_normal())},
            total_r_sd={"G": 0.002 * piece.total_r["G"]},
        )
        for piece in slices
    ]
    for constraint in ("exact", "soft"):
        fits = [fit["G"] for fit in fit_slices(noisy, FitOptions(model="dipole", constraint=constraint))]  # type: ignore[arg-type]
        for key, truth in (("sigma_a", 0.17), ("sigma_sp", 0.88)):
            pull = np.array(
                [(getattr(fit, f"{key}_per_mm") - truth) / getattr(fit, f"{key}_sd_per_mm") for fit in fits]
            )
            assert np.std(pull) == pytest.approx(1, abs=0.15)
            assert abs(np.mean(pull)) < 0.25


@pytest.mark.parametrize("constraint", ["exact", "soft", "none"])
def test_a_length_error_moves_both_coefficients_by_as_much(constraint: str) -> None:
    """σ goes as 1/mm: an error of 1 % in all lengths is one of 1 % in both, fully correlated."""
    piece = dipole_slice(Medium(0.0041, 2.62, 1.5), 3, noise=1e-4, total_sd=1e-6)
    unsure = replace(piece, mm_rel_sd=0.01)
    fit = fit_slice(unsure, FitOptions(model="dipole", constraint=constraint))["G"]  # type: ignore[arg-type]
    assert fit.sigma_sp_sd_per_mm / fit.sigma_sp_per_mm == pytest.approx(0.01, rel=0.02)
    assert fit.sigma_a_sd_per_mm / fit.sigma_a_per_mm == pytest.approx(0.01, rel=0.02)
    assert fit.correlation > 0.99
    assert fit.budget["sigma_a"]["length"] > 0.97


@pytest.mark.parametrize("constraint", ["exact", "soft", "none"])
def test_lengths_that_are_wrong_move_the_coefficients_by_as_much(constraint: str) -> None:
    piece = dipole_slice(Medium(0.17, 0.88, 1.3), 3, noise=1e-4, total_sd=1e-6)
    longer = changed(piece, r=1.01, rd=1 / 1.01**2)
    options = FitOptions(model="dipole", constraint=constraint)  # type: ignore[arg-type]
    right, wrong = (fit_slice(each, options)["G"] for each in (piece, longer))
    assert wrong.sigma_sp_per_mm * 1.01 == pytest.approx(right.sigma_sp_per_mm, rel=1e-6)
    assert wrong.sigma_a_per_mm * 1.01 == pytest.approx(right.sigma_a_per_mm, rel=1e-6)


@pytest.mark.parametrize("constraint", ["exact", "soft"])
def test_an_error_of_scale_moves_curve_and_total_together(constraint: str) -> None:
    """Trials with the scale error drawn scatter as the stated sd says, and the fit takes the scale from the shape."""
    pieces = []
    for seed in range(160):
        piece = dipole_slice(Medium(0.0041, 2.62, 1.5), seed, noise=0.002, total_sd=1e-6)
        factor = 1 + 0.01 * np.random.default_rng(1000 + seed).standard_normal()
        pieces.append(changed(piece, rd=factor, sd=1.0, total_r=factor, scale_rel_sd=0.01))
    options = FitOptions(model="dipole", constraint=constraint, window_mm=(0.45, 8.5))  # type: ignore[arg-type]
    fits = [fit["G"] for fit in fit_slices(pieces, options)]
    for key, truth in (("sigma_a", 0.0041), ("sigma_sp", 2.62)):
        pull = [(getattr(f, f"{key}_per_mm") - truth) / getattr(f, f"{key}_sd_per_mm") for f in fits]
        assert np.std(pull) == pytest.approx(1, abs=0.17)
    sure = fit_slice(replace(pieces[0], scale_rel_sd=0.0), options)["G"]
    assert fits[0].budget["sigma_a"]["scale"] > 0.3
    assert fits[0].sigma_a_sd_per_mm > 1.5 * sure.sigma_a_sd_per_mm


def test_the_budget_adds_up_to_the_whole_variance() -> None:
    piece = replace(
        dipole_slice(Medium(0.17, 0.88, 1.3), 3, total_sd=0.001), scale_rel_sd=0.005, mm_rel_sd=0.002, eta_sd=0.01
    )
    fit = fit_slice(piece, FitOptions(model="dipole"))["G"]
    for key in ("sigma_a", "sigma_sp"):
        assert sum(fit.budget[key].values()) == pytest.approx(1, abs=1e-9)
        assert {"noise", "total", "scale", "length", "eta"} <= set(fit.budget[key])
    assert "g" in fit.not_stated
    assert "scale" not in fit.not_stated


def test_lengths_scale_out() -> None:
    piece = dipole_slice(Medium(0.0041, 2.62, 1.5), 4, total_sd=0.002)
    larger = changed(piece, r=50, rd=1 / 2500)
    near, far = (fit_slice(each, FitOptions(model="dipole"))["G"] for each in (piece, larger))
    assert far.sigma_sp_per_mm * 50 == pytest.approx(near.sigma_sp_per_mm, rel=1e-6)
    assert far.sigma_a_per_mm * 50 == pytest.approx(near.sigma_a_per_mm, rel=1e-6)


def test_camera_values_and_entering_values_give_the_same_fit() -> None:
    from bssrdf.transport.convention import camera_factor

    piece = dipole_slice(Medium(0.17, 0.88, 1.3), 7)
    factor = camera_factor(1.3, flux="incident", exit="fresnel", view_angle_deg=45.0, incidence_deg=0.0)
    seen = changed(piece, rd=factor, total_r=factor, flux="incident", exit="fresnel")
    a, b = (fit_slice(each, FitOptions(model="dipole"))["G"] for each in (piece, seen))
    assert a.sigma_a_per_mm == pytest.approx(b.sigma_a_per_mm, rel=1e-9)
    assert b.total_r_model == pytest.approx(a.total_r_model, rel=1e-9)


def test_a_constraint_without_its_total_is_refused() -> None:
    piece = dipole_slice(Medium(0.17, 0.88, 1.3), 8)
    with pytest.raises(InputError, match="total_r_sd"):
        fit_slice(piece, FitOptions(constraint="soft"))
    with pytest.raises(InputError, match="total_r for channel G"):
        fit_slice(replace(piece, total_r={}), FitOptions(constraint="exact"))
