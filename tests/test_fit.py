"""The fit: what the 2001 method does on exact light, consistency over the whole table, and SciPy's optima."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares, minimize_scalar

from bssrdf.errors import InputError
from bssrdf.fit.gauss_newton import minimise
from bssrdf.fit.run import FitOptions, fit_slice, fit_slices
from bssrdf.session.records import ChannelFit, ChannelSlice, Slice
from bssrdf.transport import dipole
from bssrdf.transport.dipole import Medium
from bssrdf.transport.forward import DipoleModel
from bssrdf.transport.materials import CHANNELS, load_materials

CELLS = [(name, channel) for name in load_materials() for channel in CHANNELS]


def dipole_slice(medium: Medium, seed: int, *, noise: float = 0.01, total_sd: float = 0.0) -> Slice:
    """A curve of the dipole from 1 to 30 mean free paths with relative noise, and its exact total."""
    rng = np.random.default_rng(seed)
    with jax.enable_x64(True):
        r_mm = np.linspace(1, 30, 200) / float(medium.sigma_tp)
        rd = np.asarray(dipole.rd(medium, r_mm))
        total_r = float(dipole.total_r(medium))
    return Slice(
        channels={"G": ChannelSlice(r_mm, rd * (1 + noise * rng.standard_normal(200)), noise * rd)},
        eta=float(medium.eta),
        flux="entering",
        exit="hemisphere",
        total_r={"G": total_r},
        total_r_sd={"G": total_sd} if total_sd else {},
    )


def monte_carlo_slice(folder: Path, name: str, eta: float, total_r: float) -> Slice:
    """One of the shared Monte Carlo curves, with errors that are the same fraction of every value."""
    r_lo, r_hi, rd, _ = np.loadtxt(folder / "mc" / f"{name}.csv", delimiter=",", skiprows=5).T
    return Slice(
        channels={"G": ChannelSlice((r_lo + r_hi) / 2, rd, 0.01 * rd, r_lo, r_hi)},
        eta=eta,
        flux="entering",
        exit="hemisphere",
        total_r={"G": total_r},
    )


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


def test_the_method_of_2001_on_exact_light_of_marble(shared_data: Path) -> None:
    piece = monte_carlo_slice(shared_data, "marbleG_g0", 1.5, 0.799482)
    fit = fit_slice(piece, FitOptions(model="dipole", constraint="exact"))["G"]
    assert fit.sigma_sp_per_mm / 2.62 - 1 == pytest.approx(0.02, abs=0.02)
    assert fit.sigma_a_per_mm / 0.0041 - 1 == pytest.approx(-0.07, abs=0.04)
    lo, hi = np.asarray(fit.window_mm) * (fit.sigma_sp_per_mm + fit.sigma_a_per_mm)
    assert 1 <= lo < 1.2
    assert 20 < hi <= 24


@pytest.mark.parametrize("constraint", ["exact", "soft", "none"])
def test_the_optimum_is_that_of_scipy(constraint: str) -> None:
    medium = Medium(0.0041, 2.62, 1.5)
    piece = dipole_slice(medium, 5, total_sd=0.002)
    fit = fit_slice(piece, FitOptions(model="dipole", constraint=constraint, window_mm=(0.1, 9.5)))["G"]  # type: ignore[arg-type]
    channel = piece.channels["G"]
    inside = (channel.r_mm >= fit.window_mm[0]) & (channel.r_mm <= fit.window_mm[1])
    q_of_r = np.sqrt(3 * fit.sigma_a_per_mm / (fit.sigma_a_per_mm + fit.sigma_sp_per_mm))

    with jax.enable_x64(True):
        found = Medium(fit.sigma_a_per_mm, fit.sigma_sp_per_mm, 1.5)
        allowance = DipoleModel(1.5).relative_error * np.asarray(dipole.rd(found, channel.r_mm))
    sd = np.hypot(channel.sd_per_mm2, allowance)

    def residual(x: np.ndarray) -> np.ndarray:
        sigma_tp, q = np.exp(x[0]), x[1] if len(x) > 1 else q_of_r
        with jax.enable_x64(True):
            there = Medium(q**2 / 3 * sigma_tp, (1 - q**2 / 3) * sigma_tp, 1.5)
            rest = (channel.rd_per_mm2 - np.asarray(dipole.rd(there, channel.r_mm))) / sd
            gap = (piece.total_r["G"] - float(dipole.total_r(there))) / 0.002
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
        Slice(
            **{
                **vars(piece),
                "total_r": {"G": piece.total_r["G"] * (1 + 0.002 * rng.standard_normal())},
                "total_r_sd": {"G": 0.002 * piece.total_r["G"]},
            }
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


def test_a_common_scale_error_reaches_the_result() -> None:
    piece = dipole_slice(Medium(0.0041, 2.62, 1.5), 3, total_sd=1e-5)
    scaled = Slice(**{**vars(piece), "scale_rel_sd": 0.01})
    sure, unsure = (fit_slice(each, FitOptions(model="dipole", constraint="soft"))["G"] for each in (piece, scaled))
    assert unsure.sigma_a_sd_per_mm / unsure.sigma_a_per_mm == pytest.approx(0.09, abs=0.03)
    assert sure.sigma_a_sd_per_mm < unsure.sigma_a_sd_per_mm / 3


def test_lengths_scale_out() -> None:
    piece = dipole_slice(Medium(0.0041, 2.62, 1.5), 4, total_sd=0.002)
    channel = piece.channels["G"]
    larger = Slice(
        **{
            **vars(piece),
            "channels": {
                "G": ChannelSlice(channel.r_mm * 50, channel.rd_per_mm2 / 2500, channel.sd_per_mm2 / 2500),
            },
        }
    )
    near, far = (fit_slice(each, FitOptions(model="dipole"))["G"] for each in (piece, larger))
    assert far.sigma_sp_per_mm * 50 == pytest.approx(near.sigma_sp_per_mm, rel=1e-6)
    assert far.sigma_a_per_mm * 50 == pytest.approx(near.sigma_a_per_mm, rel=1e-6)


def test_camera_values_and_entering_values_give_the_same_fit() -> None:
    from bssrdf.transport.convention import camera_factor

    piece = dipole_slice(Medium(0.17, 0.88, 1.3), 7)
    factor = camera_factor(1.3, flux="incident", exit="fresnel", view_angle_deg=45.0, incidence_deg=0.0)
    channel = piece.channels["G"]
    seen = Slice(
        channels={"G": ChannelSlice(channel.r_mm, channel.rd_per_mm2 * factor, channel.sd_per_mm2 * factor)},
        eta=1.3,
        flux="incident",
        exit="fresnel",
        total_r={"G": piece.total_r["G"] * factor},
    )
    a, b = (fit_slice(each, FitOptions(model="dipole"))["G"] for each in (piece, seen))
    assert a.sigma_a_per_mm == pytest.approx(b.sigma_a_per_mm, rel=1e-9)
    assert b.total_r_model == pytest.approx(a.total_r_model, rel=1e-9)


def test_a_constraint_without_its_total_is_refused() -> None:
    piece = dipole_slice(Medium(0.17, 0.88, 1.3), 8)
    with pytest.raises(InputError, match="total_r_sd"):
        fit_slice(piece, FitOptions(constraint="soft"))
    with pytest.raises(InputError, match="total_r for channel G"):
        fit_slice(Slice(**{**vars(piece), "total_r": {}}), FitOptions(constraint="exact"))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_least_squares_finds_the_bottom_of_a_curved_valley(dtype: str) -> None:
    def rosenbrock(x: jax.Array) -> jax.Array:
        return jnp.stack([10 * (x[1] - x[0] ** 2), 1 - x[0]])

    with jax.enable_x64(dtype == "float64"):
        x, converged = minimise(with_slopes(rosenbrock), jnp.asarray([-1.2, 1.0], dtype))
    assert converged
    np.testing.assert_allclose(x, [1, 1], rtol=1e-3 if dtype == "float32" else 1e-7)


def test_least_squares_in_one_unknown_agrees_with_scipy(x64: None) -> None:
    t = np.linspace(0, 3, 30)
    y = np.exp(-0.7 * t) + 0.01 * np.sin(40 * t)
    x, converged = minimise(with_slopes(lambda x: y - jnp.exp(-x[0] * t)), jnp.asarray([2.0]))
    best = minimize_scalar(lambda k: np.sum((y - np.exp(-k * t)) ** 2), bounds=(0.1, 3), options={"xatol": 1e-12})
    assert converged
    assert float(x[0]) == pytest.approx(best.x, rel=1e-7)


def with_slopes(residual: Callable[[jax.Array], jax.Array]) -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
    """A residual with its derivatives, a row for each unknown."""
    return lambda x: (residual(x), jax.jacfwd(residual)(x).T)
