"""The same objective asked another question: what another model, g or η would make of the data.

Small changes take the fit's linear answer (`errors.Judged.answer`); large ones, such as the dipole's bias, fit again
with the weights as they are. Shapes: b problems; results are relative, (b, 2) in (σa, σs′).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.errors import Judged, judge
from bssrdf.fit.finite import curve_off, total_off
from bssrdf.fit.laying import lay, look
from bssrdf.fit.layout import Total
from bssrdf.fit.models import Truth
from bssrdf.fit.observe import NEAREST_MFP, seen_at, total_seen
from bssrdf.fit.problem import Laid, Neighbours, Plan, Point, Problem, Weights
from bssrdf.fit.solve import Solution, optimise, settle
from bssrdf.transport import R_ZERO, V_MAX
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.light import Light, WhiteTable, coefficients, dipole, shape_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
NEAR_BY = 1e-5
"""In the parameters: what another model would find is asked for to less than 0.1 %."""
LEAST_RATIO = 0.2
"""Of a fitted coefficient to the true one, in undoing a bias."""
LIKE_PULL, LIKE_CHI2 = 1.5, 0.3
"""Of honest curves nine in ten are as near to what the dipole makes of the light of their medium."""
FITS_PULL = 3.0
"""Light that the dipole itself made is not doubted."""
E = NUMPY
_OF_MODELS = ("table", "exit", "side", "eta", "g")
"""Shared errors that ask for more than the data."""


def to_log(q: Floats) -> Floats:
    """(b, 2, 2): derivatives of (ln σa, ln σs′) by (s, q)."""
    q = np.maximum(q[:, 0], 1e-300)
    one = np.ones_like(q)
    return np.stack([np.stack([one, 2 / q], 1), np.stack([one, -2 * q / 3 / (1 - q * q / 3)], 1)], 1)


def table_error(model: WhiteTable, data: Problem, found: Solution, judged: Judged) -> Floats:
    """From the Monte Carlo noise of the table's knots, which are independent."""
    q = np.clip(np.abs(found.point.q), 1e-12, model.q_max)
    knots = model.log_curve_sd.shape[1]
    by_knot = np.zeros((2, q.shape[0] * knots))
    for k, c in enumerate(data.curves):
        x = np.maximum(np.exp(found.point.log_sigma) * (c.r_lo + c.r_hi) / 2, NEAREST_MFP)
        t = np.clip(np.log1p(x / R_ZERO) / V_MAX, 0, 1) * (knots - 1)
        at = np.minimum(t.astype(int), knots - 2)
        moved, ahead = to_log(found.point.q) @ judged.answer[k], t - at
        left = (at + knots * np.arange(q.shape[0])[:, None]).ravel()
        for of_one, share in zip(by_knot, moved.swapaxes(0, 1), strict=True):
            for knot, part in ((left, share * (1 - ahead)), (left + 1, share * ahead)):
                of_one += np.bincount(knot, part.ravel(), of_one.size)
    edges = R_ZERO * np.expm1(np.linspace(0, 1, knots) * V_MAX)
    sd = model.shape_sd(E, q, np.broadcast_to(edges, (q.shape[0], knots)))
    return np.sqrt(np.square(by_knot.reshape(2, *sd.shape) * sd).sum(2)).T


def sample_error(plan: Plan, found: Solution, judged: Judged) -> Floats:
    """From what the ratio to a half space may be off by, in the curve and in R, which go one way; they stand in the
    interval too."""
    turn = to_log(found.point.q)
    moved = np.zeros((found.point.q.shape[0], 2))
    for laid, answer in zip(found.laid.samples, judged.answer, strict=True):
        if laid:
            moved += ((turn @ answer) * curve_off(laid)[:, None, :]).sum(2)
    by_total = (turn @ judged.total_answer[:, :, None])[:, :, 0]
    offs = [total_off(found.laid.samples[k]) for k in plan.totals if found.laid.samples[k]]
    return np.abs(moved) + np.abs(by_total) * np.max([np.zeros_like(found.point.q), *offs], axis=0)


def sensitivities(plan: Plan, data: Problem, found: Solution, judged: Judged, beside: Neighbours) -> dict[str, Floats]:
    """d ln(σa, σs′) by η and g, as `d_ln_sigma_a_d_g`: by the model, and for η by the slice's convention as well."""
    out = {}
    point, here = found.point, judged.seen
    for name, (other, step) in beside.items():
        factors = [step * by_eta if name == "eta" else 0.0 for _, by_eta in data.factor_slopes]
        aside = look(E, plan, other, data, _seen_by(plan, other, data, found), point)
        moved = np.zeros((point.q.shape[0], 2))
        for k, factor in enumerate(factors):
            change = np.log(np.maximum(aside.curves[k][0], 1e-300) / np.maximum(here.curves[k][0], 1e-300)) + factor
            moved -= ((to_log(point.q) @ judged.answer[k]) * change[:, None, :]).sum(2)
        for each, k in enumerate(plan.totals):  # none without R, of which one is looked at all the same
            change = np.log(aside.totals[each][0] / here.totals[each][0]) + factors[k]
            moved -= (to_log(point.q) @ judged.total_answer[:, :, None])[:, :, 0] * change / len(aside.totals)
        for column, key in enumerate(("sigma_a", "sigma_sp")):
            out[f"d_ln_{key}_d_{name}"] = moved[:, column] / step
    return out


def _seen_by(plan: Plan, other: Light, data: Problem, found: Solution) -> Laid:
    """What spot and camera make of another model's light at the point that was found."""
    sights = zip(plan.sights, data.curves, strict=True)
    seen = tuple(seen_at(E, sight, other, c, found.point.log_sigma, found.point.q) for sight, c in sights)
    totals = tuple(total_seen(E, plan.sights[k], other, found.point.q) for k in plan.totals)
    return found.laid._replace(seen=seen, total_seen=totals)


class Bias(NamedTuple):
    """What the dipole makes of a table's light of the medium it found."""

    error: Floats
    """(b, 2): how far the true (σa, σs′) lie from those found, relative to those."""
    pull: Floats
    """(b,): of R, and how far the curve departs, on that light: no data could do better."""
    drift: Floats
    doubtful: Bools
    """(b,): whether R pulls otherwise on that light than on the data, or χ² differs, and the dipole does not fit."""


class TableSays(NamedTuple):
    """What the table's own fit comes to where that of a biased model is in doubt; 0 elsewhere."""

    pull: Floats
    drift: Floats
    """Infinite where no medium of the table comes near."""


def bias(plan: Plan, truth: Truth, data: Problem, found: Solution, judged: Judged) -> Bias:
    """At the medium found and then at that less its bias; how far the bias moves between the two is added."""
    first, on_first = _bias_at(plan, truth, data, found, found.point)
    again, on_again = _bias_at(plan, truth, data, found, _unbiased(found.point, first))
    off_first, off_again = (1 / np.maximum(1 + each, LEAST_RATIO) - 1 for each in (first, again))
    error = np.where(np.isfinite(again), np.abs(off_again) + np.abs(off_again - off_first), np.abs(off_first))
    pull = np.fmax(np.abs(on_first.pull), np.abs(on_again.pull))
    fits = (judged.chi2 < 1) & (np.abs(judged.pull) < FITS_PULL)
    same = np.abs(judged.pull - on_again.pull) < LIKE_PULL
    same &= np.abs(judged.chi2 - on_again.chi2) < LIKE_CHI2 * on_again.chi2
    return Bias(error, pull, np.fmax(on_first.drift, on_again.drift), ~fits & ~same)


def _bias_at(plan: Plan, truth: Truth, data: Problem, found: Solution, at: Point) -> tuple[Floats, Judged]:
    at = at._replace(q=np.clip(at.q, 1e-6, truth.table.q_max))
    light = _light_of(plan, truth.table, data, at)
    refit = refitted(plan, truth.dipole, light.data, found, Weights(found.weights.mass, light.means))
    fitted, true = (np.concatenate(coefficients(p.log_sigma, p.q), axis=1) for p in (refit.point, at))
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = fitted / true - 1
    return np.where(np.isfinite(relative), relative, np.nan), judge(
        E, plan, truth.dipole, light.data, refit, significant=0.0
    )


def dipole_on_light(plan: Plan, truth: Light, data: Problem, at: Point) -> Floats:
    """Relative error (b, 2) of the dipole fitted to the light of `truth` at these points, as the data lie."""
    at = at._replace(q=np.clip(at.q, 1e-6, truth.q_max))
    light = _light_of(plan, truth, data, at)
    curves = tuple(
        c._replace(rd=np.broadcast_to(mean[..., None], c.rd.shape))
        for c, mean in zip(data.curves, light.means, strict=True)
    )
    of_dipole = plan._replace(shared=tuple(each for each in plan.shared if each.source not in _OF_MODELS))
    ended = settle(E, of_dipole, dipole(truth.eta), light.data._replace(curves=curves), at, {})
    fitted, true = (np.concatenate(coefficients(p.log_sigma, p.q), axis=1) for p in (ended.point, at))
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.abs(fitted / true - 1)
    return np.where(np.isfinite(error) & ended.converged[:, None], error, np.inf)


class _Light(NamedTuple):
    data: Problem
    means: tuple[Any, ...]


def _light_of(plan: Plan, truth: Light, data: Problem, at: Point) -> _Light:
    """The data that `truth` would have made."""
    bare = plan._replace(shared=())
    laid: Laid = lay(E, bare, truth, data, at, {})
    looked = look(E, bare, truth, data, laid, at)
    totals = tuple(
        Total(total[0] * seen, each.sd)
        for each, total, seen in zip(data.totals, looked.totals, laid.total_seen, strict=False)
    )
    return _Light(data._replace(totals=totals), tuple(value for value, _, _ in looked.curves))


def refitted(plan: Plan, model: Light, data: Problem, found: Solution, weights: Weights) -> Solution:
    """Fit again near by, with these weights and data; spot and angle as they were."""
    return optimise(E, plan, model, data, found.laid, found.point, NEAR_BY, relay=False, weights=weights)


def _unbiased(point: Point, biased: Floats) -> Point:
    """The media whose fits, of that bias, came out as they did."""
    sigma = np.concatenate(coefficients(point.log_sigma, point.q), axis=1)
    sigma_a, sigma_sp = (sigma / np.maximum(1 + np.nan_to_num(biased), LEAST_RATIO)).T
    log_sigma, q = shape_of(np.maximum(sigma_a, 1e-300), sigma_sp)
    return point._replace(log_sigma=log_sigma[:, None], q=q[:, None])
