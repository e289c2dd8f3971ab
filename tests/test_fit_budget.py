"""What a fit states of each error is what that error does to the fit: a share of the budget is the square of a shift.

The data are exact; each error in turn is made in them, and the fit is asked again. Laws that hold whatever the light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from builders import model_light, seen_slice, slice_of
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from bssrdf.fit.batch import Fitted, fit_group
from bssrdf.fit.intervals import ONE_SIDED, TWO_SIDED, profile
from bssrdf.fit.jobs import FitOptions, Job
from bssrdf.fit.laying import look
from bssrdf.fit.problem import Point
from bssrdf.fit.run import fit_slices
from bssrdf.fit.terms import system, totals_of
from bssrdf.session.records import ChannelFit, Slice
from bssrdf.transport import shipped_table
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.convention import camera_factor
from bssrdf.transport.forward import DipoleModel
from bssrdf.transport.white.store import table_model

SIGMA_A, SIGMA_SP = 0.17, 0.88
ETA, VIEW_DEG, G = 1.4, 50.0, 0.8
R_MM = np.geomspace(1.6, 20, 24) / (SIGMA_A + SIGMA_SP)
SDS = {"scale": 0.01, "length": 0.005, "view": 0.5, "eta": 0.004, "g": 0.004, "total": 0.003}
"""One standard deviation of each: relative, in degrees for the view, in units of η and g."""
SMALL = 0.02
"""Of a standard deviation: so much of an error is made, that what it does is linear."""
KEYS = ("sigma_a", "sigma_sp")


@dataclass(frozen=True)
class Wrong:
    """By how much the truth differs from what the slice states."""

    scale: float = 0.0
    length: float = 0.0
    view: float = 0.0
    eta: float = 0.0
    g: float = 0.0
    total: float = 0.0


def measured(model: str, wrong: Wrong) -> Slice:
    """What a camera at VIEW_DEG is believed to have seen, and all errors stated."""
    eta, view_deg = ETA + wrong.eta, VIEW_DEG + wrong.view
    light = DipoleModel(eta) if model == "dipole" else table_model(eta, G + wrong.g)
    true_mm = R_MM * (1 + wrong.length)
    rd, total_r = model_light(light, SIGMA_A, SIGMA_SP, true_mm)
    seen = {"flux": "incident", "exit": "fresnel" if model == "dipole" else "hemisphere"}
    factor = (1 + wrong.scale) * camera_factor(eta, **seen, view_angle_deg=view_deg, incidence_deg=0.0)
    foreshortening = np.cos(np.radians(VIEW_DEG)) / np.cos(np.radians(view_deg)) if model == "dipole" else 1.0
    return slice_of(
        R_MM,
        factor * foreshortening * (1 + wrong.length) ** 2 * rd,
        total_r=factor * total_r * (1 + wrong.total),
        total_sd=SDS["total"],
        **seen,
        eta=ETA,
        g=G,
        view_angle_deg=VIEW_DEG,
        scale_rel_sd=SDS["scale"],
        mm_rel_sd=SDS["length"],
        view_angle_sd_deg=SDS["view"],
        eta_sd=SDS["eta"],
        g_sd=SDS["g"] if model == "mc" else None,
    )


def logs(fits: list[ChannelFit]) -> np.ndarray:
    """ln σa and ln σs′, (n, 2)."""
    return np.log([[getattr(fit, f"{key}_per_mm") for key in KEYS] for fit in fits])


def fitted(pieces: list[Slice], model: str, constraint: str) -> list[ChannelFit]:
    options = FitOptions(model=model, constraint=constraint)  # type: ignore[arg-type]
    return [fit["G"] for fit in fit_slices(pieces, options)]


def shifts(make: Callable[[float], list[Slice]], model: str, constraint: str) -> np.ndarray:
    """(n, 2): how ln σa and ln σs′ move by one standard deviation of each of n errors."""
    up, down = (logs(fitted(make(sign * SMALL), model, constraint)) for sign in (1, -1))
    return (up - down) / (2 * SMALL)


def check(found: ChannelFit, source: str, moved: np.ndarray) -> None:
    """The fit takes the slopes by η and g from a model a finite step aside."""
    rel, share = (0.06, 1e-3) if source in ("eta", "g") else (1e-4, 1e-6)
    for column, key in enumerate(KEYS):
        sd = getattr(found, f"{key}_sd_per_mm") / getattr(found, f"{key}_per_mm")
        seen = np.square(moved[:, column] / sd).sum()
        assert found.budget[key].get(source, 0.0) == pytest.approx(seen, rel=rel, abs=share), (source, key)


def one_wrong(model: str, source: str, size: float) -> list[Slice]:
    return [measured(model, Wrong(**{source: size * SDS[source]}))]


@pytest.mark.parametrize("constraint", ["exact", "soft", "none"])
@pytest.mark.parametrize("model", ["dipole", "mc"])
def test_a_share_of_the_budget_is_what_one_sd_of_that_error_does(model: str, constraint: str) -> None:
    (found,) = fitted([measured(model, Wrong())], model, constraint)
    shared = ["scale", "length", "eta", *(["view"] if model == "dipole" else ["g"])]
    for source in shared + (["total"] if constraint != "none" else []):
        moved = shifts(partial(one_wrong, model, source), model, constraint)
        check(found, source, moved)


@pytest.mark.parametrize("constraint", ["exact", "soft", "none"])
def test_the_share_of_noise_is_what_each_radius_does_and_all_shares_make_the_correlation(constraint: str) -> None:
    plain = replace(measured("dipole", Wrong()), scale_rel_sd=0.0, mm_rel_sd=0.0, view_angle_sd_deg=0.0, eta_sd=0.0)
    channel = plain.channels["G"]

    def one_off(size: float) -> list[Slice]:
        each = channel.rd_per_mm2 + size * np.diag(channel.sd_per_mm2)
        return [replace(plain, channels={"G": replace(channel, rd_per_mm2=values)}) for values in each]

    def total_off(size: float) -> list[Slice]:
        return [replace(plain, total_r={"G": plain.total_r["G"] * (1 + size * SDS["total"])})]

    (found,) = fitted([plain], "dipole", constraint)
    by_noise = shifts(one_off, "dipole", constraint)
    check(found, "noise", by_noise)
    by_total = shifts(total_off, "dipole", constraint) if constraint != "none" else np.zeros((0, 2))
    whole = np.concatenate([by_noise, by_total])
    covariance = whole.T @ whole
    assert found.correlation == pytest.approx(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]), abs=1e-3)


def vaguely_seen(sigma_a: float, sd: float) -> Fitted:
    """A fit of one exact slice without shared errors, whose curve tells the scale to some `sd` only."""
    light = table_model(ETA, G)
    rd, total_r = model_light(light, sigma_a, SIGMA_SP, R_MM)
    seen = {"flux": "incident", "exit": "hemisphere"}
    factor = camera_factor(ETA, **seen, view_angle_deg=0.0, incidence_deg=0.0)
    known = slice_of(R_MM, factor * rd, total_r=factor * total_r, total_sd=SDS["total"], **seen, eta=ETA, g=G)
    channel = replace(known.channels["G"], sd_per_mm2=sd * factor * rd)
    options = FitOptions(constraint="soft", tables="shipped")
    return fit_group([Job((replace(known, channels={"G": channel}),), "G")], options, shipped_table(ETA, G))


def test_a_profile_is_the_linear_interval_where_the_cost_is_a_parabola() -> None:
    one = vaguely_seen(SIGMA_A, 0.02)
    bounds = profile(one.plan, one.model, one.data, one.found, np.ones(1))
    turn = np.array([1, 2 / one.found.point.q[0, 0]])  # of ln σa by s and q
    sd = np.sqrt(turn @ sum(one.judged.sources.values())[0] @ turn)
    ends = np.log([bounds.lower[0], bounds.upper[0]]) - np.log(bounds.sigma_a[0])
    np.testing.assert_allclose(ends, norm.ppf([0.025, 0.975]) * sd, rtol=0.01)


def least_cost(one: Fitted, sigma_a: float) -> float:
    """χ² of the medium that fits best of all with this σa: every σt′ tried, shared errors at their best."""

    def cost(log_sigma: float) -> float:
        q = np.sqrt(3 * sigma_a / np.exp(log_sigma))
        at = Point(*(np.array([[each]]) for each in (log_sigma, q, 0.0)))
        seen = look(NUMPY, one.plan, one.model, one.data, one.found.laid, at)
        of, shared = (one.plan, one.data, one.found.laid, seen), one.found.shared
        gaps = totals_of(NUMPY, *of, shared)
        whole, gradient, matrix = system(NUMPY, *of, gaps, one.found.weights, shared)
        return float(whole[0] - gradient[0, 3:] @ np.linalg.solve(matrix[0, 3:, 3:], gradient[0, 3:]))

    middle = float(one.found.point.log_sigma[0, 0])
    return float(minimize_scalar(cost, bounds=(middle - 1, middle + 1), method="bounded", options={"xatol": 1e-9}).fun)


@pytest.mark.parametrize("sigma_a", [5e-5, 2e-4])
def test_a_bound_of_sigma_a_is_where_no_medium_of_that_sigma_a_fits(sigma_a: float) -> None:
    """Curve and scale are vague, and no absorption is not far: σt′ moves along with σa."""
    one = vaguely_seen(sigma_a, 0.3)
    bounds = profile(one.plan, one.model, one.data, one.found, np.ones(1))
    lowest = least_cost(one, float(bounds.sigma_a[0]))
    for bound in (bounds.lower[0], bounds.upper[0]):
        if bound > 0:
            rise = least_cost(one, float(bound)) - lowest
            assert rise == pytest.approx(ONE_SIDED if bounds.lower[0] == 0 else TWO_SIDED, rel=2e-3)


def test_a_bound_is_the_same_beside_a_curve_that_has_none() -> None:
    """Light near the beam hardly tells σa: where errors are 1 % there is an upper bound, where they are 60 % none."""
    r_mm = np.linspace(0.1, 0.4, 20) / SIGMA_SP
    rd, _ = model_light(table_model(ETA, G), 2e-3, SIGMA_SP, r_mm)
    clear, vague = (slice_of(r_mm, rd, sd=sd, eta=ETA, g=G) for sd in (0.01, 0.6))
    together = fitted([clear, vague], "mc", "none")
    alone = [fitted([piece], "mc", "none")[0] for piece in (clear, vague)]
    assert np.isfinite(together[0].sigma_a_interval95_per_mm[1])
    assert not np.isfinite(together[1].sigma_a_interval95_per_mm[1])
    np.testing.assert_allclose(together[0].sigma_a_interval95_per_mm, alone[0].sigma_a_interval95_per_mm, rtol=1e-5)


@pytest.mark.parametrize(("key", "step"), [("eta", 0.01), ("g", 0.02)])
def test_sensitivity_is_what_a_fit_under_another_medium_finds(key: str, step: float) -> None:
    """As a camera at 45° sees it, where η changes the convention and the law of exit as well as the light."""
    here = seen_slice(0.0011, 2.55)
    slices = [replace(here, **{key: getattr(here, key) + by}) for by in (0.0, step)]
    fit, moved = (channels["G"] for channels in fit_slices(slices, FitOptions(model="mc")))
    for name in ("sigma_a", "sigma_sp"):
        found = np.log(getattr(moved, f"{name}_per_mm") / getattr(fit, f"{name}_per_mm")) / step
        assert fit.sensitivity[f"d_ln_{name}_d_{key}"] == pytest.approx(found, rel=0.05, abs=0.04)
