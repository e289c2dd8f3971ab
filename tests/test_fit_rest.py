"""Where a fit rests and how it is judged: by either engine, from any start, in any batch, and as jaxopt does."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders import changed, model_slice, seen_slice, slice_of

from bssrdf.bench.trial_light import shipped
from bssrdf.bench.trials import Drawn, slices_of
from bssrdf.fit import neighbours
from bssrdf.fit.batch import Fitted, fit_group
from bssrdf.fit.compiled import settled
from bssrdf.fit.jobs import FitOptions, Job
from bssrdf.fit.laying import look
from bssrdf.fit.models import named
from bssrdf.fit.neighbours import refitted, table_error
from bssrdf.fit.problem import Point, Weights
from bssrdf.fit.run import fit_slices
from bssrdf.fit.solve import marginal, settle
from bssrdf.fit.terms import cost_at, system, totals_of
from bssrdf.session.records import Slice
from bssrdf.transport import Making
from bssrdf.transport.arrays import NUMPY, picked
from bssrdf.transport.dipole import Medium, rd, total_r
from bssrdf.transport.light import WhiteTable, coefficients
from bssrdf.transport.white.grid import R_ZERO, V_MAX
from bssrdf.transport.white.store import table_model

PLAIN = FitOptions(constraint="soft", tables="shipped")


def trial(name: str = "Skin1 G", seed: int = 1) -> Slice:
    (piece,) = slices_of(shipped()[name], 1, 0.01, seed, Drawn(scale=0.01, length=0.002))
    return piece


def seen(sigma_a: float, sigma_sp: float) -> Slice:
    """A camera's slice whose spot is half a mean free path."""
    spot = {"spot_radius_mm": 0.5 / (sigma_a + sigma_sp), "spot_radius_sd_mm": 0.01}
    return seen_slice(sigma_a, sigma_sp, **spot, scale_rel_sd=0.005, mm_rel_sd=0.002)


def fitted(pieces: Sequence[Slice], name: Literal["mc", "dipole"] = "mc", options: FitOptions = PLAIN) -> Fitted:
    model = named(name, pieces[0], options.tables, Making())
    return fit_group([Job((piece,), "G") for piece in pieces], options, model)


def test_jax_and_numpy_run_the_same_fit() -> None:
    ours = fitted([trial(seed=seed) for seed in range(3)])
    theirs = settled(ours.plan, ours.model, ours.data, ours.beside, 256)
    for a, b in zip(ours.found.point, theirs.point, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)
    np.testing.assert_allclose(ours.found.cost, theirs.cost, rtol=1e-9)


@pytest.mark.parametrize(("sigma_a", "sigma_sp"), [(0.0024, 3.21), (0.17, 0.88), (0.97, 0.07)])
def test_a_camera_s_slice_rests_at_one_place_from_twenty_starts(sigma_a: float, sigma_sp: float) -> None:
    one = fitted([seen(sigma_a, sigma_sp)])
    rng = np.random.default_rng(4)
    rows = np.zeros(20, int)
    here = one.found.point
    begin = Point(
        here.log_sigma[rows] + rng.uniform(-0.4, 0.4, (20, 1)),
        np.minimum(here.q[rows] * np.exp(rng.uniform(-0.4, 0.4, (20, 1))), 1.7),
        here.log_scale[rows],
    )
    ended = settle(NUMPY, one.plan, one.model, picked(one.data, rows), begin, one.beside)
    sd = np.sqrt(np.diag(sum(one.judged.sources.values())[0]))
    assert ended.converged.all()
    assert np.abs(ended.point.log_sigma - here.log_sigma[0]).max() < 1e-3 * sd[0]
    assert np.abs(ended.point.q - here.q[0]).max() < 1e-3 * sd[1]


def test_jaxopt_finds_the_same_optimum_of_the_same_objective(x64: None) -> None:
    """The dipole with R and an error of scale that curve and R share, in the weights in which our fit rests."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from jaxopt import LevenbergMarquardt
    one = fitted([slices_of(shipped()["Skin1 G"], 1, 0.01, 3, Drawn(scale=0.01))[0]], "dipole")
    weights, (data,), (total,) = one.found.weights, one.data.curves, one.data.totals
    t, w = np.polynomial.legendre.leggauss(8)
    lo, hi = data.r_lo[0][:, None], data.r_hi[0][:, None]
    nodes = (lo + hi) / 2 + (hi - lo) / 2 * t[None]

    def rest(x: jax.Array) -> jax.Array:
        medium = Medium(*(jnp.exp(x[0]) * each for each in (x[1] ** 2 / 3, 1 - x[1] ** 2 / 3)), 1.3)
        light = (rd(medium, nodes) * nodes * w[None]).sum(1) / (nodes * w[None]).sum(1)
        curve = jnp.sqrt(weights.mass[0][0]) * (weights.mean[0][0] - light * (1 + 0.01 * x[2]))
        gap = (total.r[0, 0] - total_r(medium) * (1 + 0.01 * x[2])) / total.sd[0, 0]
        return jnp.concatenate([curve, jnp.stack([gap, x[2]])])

    x = jnp.asarray([float(one.found.point.log_sigma[0, 0]) + 0.1, 0.6, 0.0])
    found = LevenbergMarquardt(rest, maxiter=100, xtol=1e-12, gtol=1e-12, materialize_jac=True).run(x).params
    sigma_a, sigma_sp = (float(each[0, 0]) for each in coefficients(one.found.point.log_sigma, one.found.point.q))
    theirs = coefficients(np.asarray(found[0]), np.asarray(found[1]))
    assert theirs == pytest.approx((sigma_a, sigma_sp), rel=1e-6)


def test_slopes_are_those_of_the_whole_objective_where_data_contradict_each_other() -> None:
    """By finite differences, shared errors at their best."""
    one = fitted([changed(trial(), rd=1.5)])
    plan, data, laid, by = one.plan, one.data, one.found.laid, one.found.weights
    begin, shared = one.found.point, one.found.shared
    at = begin._replace(log_sigma=begin.log_sigma + 0.02, q=0.97 * begin.q)
    seen = look(NUMPY, plan, one.model, data, laid, at)
    for _ in range(8):
        gaps = totals_of(NUMPY, plan, data, laid, seen, shared)
        here = marginal(NUMPY, system(NUMPY, plan, data, laid, seen, gaps, by, shared), plan.free, None, shared)
        shared = here.shared
    assert np.abs(shared).max() > 10

    def cost(point: Point) -> float:
        beside = look(NUMPY, plan, one.model, data, laid, point)
        return float(cost_at(NUMPY, plan, data, laid, beside, by, shared)[0])

    for k, name in enumerate(("log_sigma", "q")):
        ends = [cost(at._replace(**{name: getattr(at, name) + step})) for step in (1e-5, -1e-5)]
        assert -2 * here.gradient[0, k] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-5)


def test_no_search_fails_on_curves_that_the_model_cannot_make() -> None:
    """A dipole's, which near the beam and in dark media are far from the table's."""
    rng = np.random.default_rng(5)
    pieces = []
    for near, far, sigma_a in itertools.product((0.1, 0.3, 1.0), (10.0, 20.0), (0.001, 0.01, 0.1, 0.4)):
        medium = Medium(sigma_a, 1.0, 1.3)
        r_mm = np.geomspace(near, far, 40) / (1 + sigma_a)
        light = np.asarray(rd(medium, r_mm)) * (1 + 0.01 * rng.standard_normal(40))
        r_mm, light = (each[light > 1e-6 * light[0]] for each in (r_mm, light))
        shared = {"scale_rel_sd": 0.005, "mm_rel_sd": 0.002}
        pieces.append(slice_of(r_mm, light, total_r=float(total_r(medium)), **shared, g=0.0))
    fits = [fit["G"] for fit in fit_slices(pieces, FitOptions(model="mc", tables="shipped"))]
    assert not any("not_converged" in fit.flags for fit in fits)


def test_what_other_models_say_hangs_little_on_how_many_of_the_radii_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Curves of 169 and 175 radii, of which every second is looked at: the dipole's bias, and what a wrong η does."""
    pieces = [trial(name) for name in ("Wholemilk R", "Potato G", "Apple B")]

    def said() -> tuple[list[float], list[float]]:
        fits = [fit["G"] for fit in fit_slices(pieces, FitOptions(model="dipole", constraint="soft"))]
        return [x for f in fits for x in f.model_error.values()], [x for f in fits for x in f.sensitivity.values()]

    some = said()
    monkeypatch.setattr(neighbours, "ENOUGH", 10**6)
    every = said()
    assert some != every
    np.testing.assert_allclose(some[0], every[0], rtol=0.05)
    np.testing.assert_allclose(some[1], every[1], rtol=0.005)


def test_light_beyond_the_end_of_the_table_does_not_count() -> None:
    within = model_slice(table_model(1.3, 0.0), 0.0001, 2.0, np.geomspace(2, 150, 40))
    part, r_mm = within.channels["G"], np.array([202.0, 210.0]) / 2.0001
    piece, elsewhere = (
        slice_of(np.append(part.r_mm, r_mm), np.append(part.rd_per_mm2, [far, far]), total_r=within.total_r["G"], g=0.0)
        for far in (1e-8, 3e-8)
    )
    one, other = fitted([piece, elsewhere]).found.point.log_sigma[:, 0]
    assert one == pytest.approx(other, abs=1e-9)


@pytest.mark.parametrize("name", ["Wholemilk R", "Skin1 G", "Potato B"])
def test_a_table_s_model_error_is_the_spread_of_fits_to_its_noise(name: str) -> None:
    one = fitted([trial(name)])
    assert isinstance(one.model, WhiteTable)
    stated = table_error(one)[0]
    rng = np.random.default_rng(0)
    rows = np.zeros(300, int)
    (curves,), knots = one.data.curves, one.model.log_curve_sd.shape[1]
    edges = R_ZERO * np.expm1(np.linspace(0, 1, knots) * V_MAX)
    sd = one.model.shape_sd(NUMPY, one.found.point.q, edges[None])[0]
    x = np.exp(one.found.point.log_sigma) * (curves.r_lo + curves.r_hi) / 2
    at = np.log1p(x[0] / R_ZERO) / V_MAX * (knots - 1)
    draws = rng.standard_normal((rows.size, knots))
    draws -= draws.mean(axis=0)
    draws @= np.linalg.inv(np.linalg.cholesky(draws.T @ draws / rows.size)).T  # with exactly the spread they stand for
    waves = np.stack([np.interp(at, np.arange(knots), sd * each) for each in draws])
    many = picked(one.found, rows)
    weights = Weights(many.weights.mass, (many.weights.mean[0] + one.judged.seen.curves[0][0] * waves,))
    ended = refitted(one.plan, one.model, picked(one.data, rows), many, weights)
    ours = np.concatenate(coefficients(one.found.point.log_sigma, one.found.point.q), axis=1)
    spread = np.std(np.concatenate(coefficients(ended.point.log_sigma, ended.point.q), axis=1) / ours, axis=0)
    np.testing.assert_allclose(spread, stated, rtol=0.05)


def test_a_fit_is_the_same_alone_and_in_any_batch() -> None:
    pieces = [trial(name, seed) for seed, name in enumerate(("Skin1 G", "Skin2 G", "Chicken1 R", "Potato G"))]
    together = fit_slices(pieces, FitOptions(model="mc"))
    for piece, among in zip(pieces, together, strict=True):
        (alone,) = fit_slices([piece], FitOptions(model="mc"))
        for key in ("sigma_a_per_mm", "sigma_sp_per_mm", "sigma_a_sd_per_mm"):
            assert getattr(among["G"], key) == pytest.approx(getattr(alone["G"], key), rel=1e-7)
        assert among["G"].model_error["sigma_a"] == pytest.approx(alone["G"].model_error["sigma_a"], rel=1e-6)
