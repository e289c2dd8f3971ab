"""Curves on which a fit could go astray, each with what it must say. The light is the Monte Carlo table's, with noise.

All cases of one kind are fitted in one call, so that few kernels are compiled.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders import changed, model_light, model_slice, slice_of, with_rd
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bssrdf.errors import InputError
from bssrdf.fit import FitOptions, fit_slices
from bssrdf.fit.terms import solved
from bssrdf.session.records import ChannelFit, ChannelSlice, Slice
from bssrdf.transport.forward import DipoleModel
from bssrdf.transport.white.store import table_model

N = 64
TRUTH = {
    "Spectralon": (0.0, 11.6, 1.3),
    "cream red": (0.0002, 7.38, 1.3),
    "ketchup blue": (1.45, 0.03, 1.3),
    "chicken blue": (0.19, 0.38, 1.3),
    "marble of albedo 0.5": (2.62, 2.62, 1.5),
    "marble": (0.0041, 2.62, 1.5),
    "skin": (0.17, 0.88, 1.3),
    "thin fog": (0.001, 0.01, 1.3),
    "paint": (20.0, 1000.0, 1.5),
}


def light(name: str, *, far_mfp: float = 24.0, n: int = N, noise: float = 0.01, seed: int = 1) -> Slice:
    """The table's light of a medium from 1 mean free path on, with noise and with R to 0.2 %."""
    sigma_a, sigma_sp, eta = TRUTH[name]
    errors = {"noise": noise, "seed": seed, "g": 0.0, "scale_rel_sd": 0.0, "mm_rel_sd": 0.0}
    return model_slice(table_model(eta, 0.0), sigma_a, sigma_sp, np.linspace(1, far_mfp, n), **errors)


def dipole_light(eta: float) -> Slice:
    """The dipole's light of skin at an index without a table."""
    errors = {"noise": 0.01, "seed": 5, "g": 0.0, "scale_rel_sd": 0.0, "mm_rel_sd": 0.0}
    return model_slice(DipoleModel(eta), 0.17, 0.88, np.linspace(1, 24, N), **errors)


def _outlier() -> np.ndarray:
    factor = np.ones(N)
    factor[20] = 1.5
    return factor


def _cases() -> dict[str, Slice]:
    marble, skin = light("marble"), light("skin")
    rng = np.random.default_rng(5)
    noise = np.abs(skin.channels["G"].sd_per_mm2) * 100 * rng.standard_normal(N)
    return {
        **{name: light(name) for name in TRUTH},
        "noisy total": replace(light("Spectralon"), total_r={"G": 1.004}),
        "short frame": light("marble", far_mfp=6.0),
        "eta 0.95": dipole_light(0.95),
        "eta 3.1": dipole_light(3.1),
        "g 0.97": replace(dipole_light(1.3), g=0.97),
        "five points": light("skin", n=5, far_mfp=12.0),
        "four points": light("skin", n=4, far_mfp=12.0),
        "six decades of weights": changed(skin, sd=np.geomspace(1, 1e6, N)),
        "outlier": changed(skin, rd=_outlier(), sd=1.0),
        "zeros and negatives": with_rd(
            skin, np.where(np.arange(N) % 9 == 8, 0.0, 1) * skin.channels["G"].rd_per_mm2 - 0
        ),
        "total 10 % off": replace(marble, total_r={"G": marble.total_r["G"] * 0.9}),
        "constant": with_rd(skin, np.full(N, float(np.median(skin.channels["G"].rd_per_mm2)))),
        "pure noise": replace(
            with_rd(skin, noise),
            channels={"G": ChannelSlice(skin.channels["G"].r_mm, noise, np.abs(noise).mean() * np.ones(N))},
        ),
        "micrometres": changed(skin, r=1000.0),
        "metres": changed(skin, r=0.001),
    }


CASES = _cases()


@pytest.fixture(scope="module")
def dipole() -> dict[str, ChannelFit]:
    fits = fit_slices(list(CASES.values()), FitOptions(model="dipole", constraint="soft"))
    return {name: fit["G"] for name, fit in zip(CASES, fits, strict=True)}


@pytest.fixture(scope="module")
def table() -> dict[str, ChannelFit]:
    names = [name for name in CASES if name not in ("eta 0.95", "eta 3.1", "g 0.97")]
    fits = fit_slices([CASES[name] for name in names], FitOptions(model="mc", constraint="soft"))
    return {name: fit["G"] for name, fit in zip(names, fits, strict=True)}


def covers(interval: tuple[float, float], truth: float) -> bool:
    return interval[0] <= truth <= interval[1]


@pytest.mark.parametrize("name", ["Spectralon", "noisy total"])
def test_no_absorption_gives_an_upper_bound(
    name: str, table: dict[str, ChannelFit], dipole: dict[str, ChannelFit]
) -> None:
    for fit in (table[name], dipole[name]):
        assert fit.status == "upper_bound"
        assert fit.sigma_a_interval95_per_mm[0] == 0
        assert 0 < fit.sigma_a_interval95_per_mm[1] < 1e-3
    assert ("total_at_limit" in table[name].flags) == (name == "noisy total")


@pytest.mark.parametrize("name", list(TRUTH)[1:])
def test_the_table_finds_every_hard_medium(name: str, table: dict[str, ChannelFit]) -> None:
    sigma_a, sigma_sp, _ = TRUTH[name]
    fit = table[name]
    assert fit.sigma_sp_per_mm == pytest.approx(sigma_sp, abs=4 * fit.sigma_sp_sd_per_mm)
    assert abs(fit.sigma_a_per_mm - sigma_a) < 4 * fit.sigma_a_sd_per_mm
    assert fit.sigma_a_interval95_per_mm[0] <= fit.sigma_a_per_mm <= fit.sigma_a_interval95_per_mm[1]


@pytest.mark.parametrize("name", list(TRUTH)[1:])
def test_the_dipole_states_a_model_error_that_covers_its_bias(name: str, dipole: dict[str, ChannelFit]) -> None:
    sigma_a, sigma_sp, _ = TRUTH[name]
    fit = dipole[name]
    if "single_scattering" in fit.flags or fit.status == "rejected":
        assert sigma_a > 0.4 * sigma_sp  # where the dipole does not hold
        return
    for value, truth, sd, error in (
        (fit.sigma_a_per_mm, sigma_a, fit.sigma_a_sd_per_mm, fit.model_error["sigma_a"]),
        (fit.sigma_sp_per_mm, sigma_sp, fit.sigma_sp_sd_per_mm, fit.model_error["sigma_sp"]),
    ):
        assert abs(value - truth) < 1.5 * error * value + 3 * sd


def test_low_albedo_is_no_case_for_the_dipole(dipole: dict[str, ChannelFit]) -> None:
    assert "single_scattering" in dipole["ketchup blue"].flags
    half = dipole["marble of albedo 0.5"]
    assert half.status == "rejected" or half.model_error["sigma_sp"] > 0.1


def test_a_short_frame_is_flagged(dipole: dict[str, ChannelFit], table: dict[str, ChannelFit]) -> None:
    assert "window_short" in dipole["short frame"].flags
    assert "window_short" in table["short frame"].flags
    assert covers(table["short frame"].sigma_a_interval95_per_mm, TRUTH["marble"][0])


@pytest.mark.parametrize("name", ["eta 0.95", "eta 3.1", "g 0.97"])
def test_media_without_a_table_say_that_the_dipole_is_unchecked(name: str, dipole: dict[str, ChannelFit]) -> None:
    assert dipole[name].status == "converged"
    assert "dipole_unchecked" in dipole[name].flags
    assert dipole[name].model_error["sigma_a"] > 0


def test_five_radii_are_enough_and_four_are_not(table: dict[str, ChannelFit]) -> None:
    assert table["five points"].status == "converged"
    assert table["four points"].status == "unidentifiable"
    assert "few_radii" in table["four points"].flags


def test_weights_over_six_decades(table: dict[str, ChannelFit]) -> None:
    fit = table["six decades of weights"]
    assert covers(fit.sigma_sp_interval95_per_mm, 0.88)


def test_an_outlier_is_seen_and_huber_bears_it(table: dict[str, ChannelFit]) -> None:
    robust = fit_slices([CASES["outlier"]], FitOptions(model="mc", constraint="soft", robust=True))[0]["G"]
    assert "poor_fit" in table["outlier"].flags
    assert "robust" in robust.flags
    assert robust.sigma_sp_per_mm == pytest.approx(0.88, rel=0.02)
    assert abs(robust.sigma_sp_per_mm - 0.88) < abs(table["outlier"].sigma_sp_per_mm - 0.88) + 0.002


def test_samples_at_zero_are_data(table: dict[str, ChannelFit]) -> None:
    fit = table["zeros and negatives"]
    assert fit.n > 50
    assert "poor_fit" in fit.flags


def test_a_total_that_contradicts_the_curve_is_flagged(table: dict[str, ChannelFit]) -> None:
    assert {"total_inconsistent", "poor_fit"} & set(table["total 10 % off"].flags)


def test_a_constant_and_pure_noise_are_not_fitted_in_silence(table: dict[str, ChannelFit]) -> None:
    assert table["pure noise"].status in ("unidentifiable", "failed")
    assert {"poor_fit", "scale_suspect", "noise"} & set(table["constant"].flags)


@pytest.mark.parametrize(
    ("eta", "g", "sigma_a", "sigma_sp", "x_mfp"),
    [
        (1.5, 0.0, 0.0448, 2.424, np.geomspace(21.3, 105.4, 18)),
        (1.4, 0.8, 0.1764, 4.044, np.linspace(60.1, 200, 7)),
        (1.33, 0.9, 0.0332, 3.168, np.linspace(38.3, 192, 48)),
    ],
)
def test_light_far_out_without_r_is_not_fitted_in_a_wrong_valley(
    eta: float, g: float, sigma_a: float, sigma_sp: float, x_mfp: np.ndarray
) -> None:
    """Exact light of the table itself, by decades below that of the beam; where two media fit alike, that is said."""
    r_mm = x_mfp / (sigma_a + sigma_sp)
    rd, _ = model_light(table_model(eta, g), sigma_a, sigma_sp, r_mm)
    [fit] = fit_slices([slice_of(r_mm, rd, eta=eta, g=g)], FitOptions(model="mc"))
    if fit["G"].status == "converged":
        assert fit["G"].sigma_a_per_mm == pytest.approx(sigma_a, rel=2e-3)
        assert fit["G"].sigma_sp_per_mm == pytest.approx(sigma_sp, rel=2e-3)
    else:
        assert fit["G"].status == "unidentifiable"
        assert "two_media" in fit["G"].flags


@pytest.mark.parametrize("name", ["micrometres", "metres"])
def test_radii_in_another_unit_are_suspected(name: str, table: dict[str, ChannelFit]) -> None:
    assert "scale_suspect" in table[name].flags


def test_plain_media_are_not_suspected(table: dict[str, ChannelFit]) -> None:
    for name in ("marble", "skin", "cream red", "chicken blue", "thin fog", "paint"):
        assert table[name].status in ("converged", "upper_bound")
        assert not set(table[name].flags) - {"albedo_one", "window_short"}, name


curves = st.tuples(
    st.integers(0, 10**6),
    st.floats(1e-6, 1e6),
    st.floats(0, 3),
    st.floats(-4, 1),
    st.floats(0.001, 1.1),
)


def arbitrary(seed: int, size: float, roughness: float, slope: float, total_r: float) -> Slice:
    """A power law with noise: nothing that a medium need have made."""
    rng = np.random.default_rng(seed)
    r_mm = np.sort(rng.uniform(0.01, 30, N))
    rd = size * r_mm**slope * (1 + roughness * rng.standard_normal(N))
    return replace(
        CASES["skin"],
        channels={"G": ChannelSlice(r_mm, rd, 0.01 * np.abs(rd) + 1e-12)},
        total_r={"G": total_r},
        total_r_sd={"G": 0.002},
    )


@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(drawn=st.lists(curves, min_size=len(CASES), max_size=len(CASES)))
def test_no_curve_gives_a_traceback_or_a_silent_nan(
    drawn: list[tuple[int, float, float, float, float]], dipole: dict[str, ChannelFit]
) -> None:
    for fits in fit_slices([arbitrary(*each) for each in drawn], FitOptions(model="dipole", constraint="soft")):
        fit = fits["G"]
        numbers = [fit.sigma_sp_per_mm, fit.sigma_sp_sd_per_mm, *fit.sigma_sp_interval95_per_mm]
        if "sigma_a_unidentifiable" not in fit.flags:
            numbers.append(fit.sigma_a_per_mm)
        assert np.all(np.isfinite(numbers)) or fit.status in ("failed", "unidentifiable", "rejected")
        for lo, hi in (fit.sigma_a_interval95_per_mm, fit.sigma_sp_interval95_per_mm):
            assert lo <= hi or fit.status in ("failed", "unidentifiable", "rejected")


def test_shared_errors_are_found_beside_weights_that_drown_their_priors() -> None:
    """Far out light falls to 1e-20 of its sd, and 1e40 + 1 is 1e40: plainly solved, the priors would be gone."""
    response = np.array([[1.0, 2.0, -1.0, 0.5]])
    matrix = 1e40 * response[:, :, None] * response[:, None, :] + np.eye(4)
    right = 3e40 * response[:, :, None]
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.solve(matrix, right)
    assert (response @ solved(np, matrix, right)[0])[0, 0] == pytest.approx(3, rel=1e-9)


def test_a_channel_without_a_radius_is_refused() -> None:
    none = np.zeros(0)
    with pytest.raises(InputError, match="channel G of a slice has no radius"):
        fit_slices([replace(light("skin"), channels={"G": ChannelSlice(none, none, none)})])
