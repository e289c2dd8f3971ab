"""The same objective asked another question: what another model, g or η would make of the data.

Small changes take the fit's linear answer (`errors.Judged.answer`); large ones, such as the dipole's bias, fit again
with the weights as they are. Shapes: b problems; results are relative, (b, 2) in (σa, σs′).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.batch import Fitted
from bssrdf.fit.errors import Judged, judge
from bssrdf.fit.laying import TINY, lay, look
from bssrdf.fit.layout import Total
from bssrdf.fit.models import Truth
from bssrdf.fit.problem import Plan, Point, Problem, Weights
from bssrdf.fit.solve import Solution, optimise, settle
from bssrdf.transport import R_ZERO, V_MAX
from bssrdf.transport.arrays import NUMPY, picked
from bssrdf.transport.light import KNOT_STEP, Light, coefficients, dipole, shape_of
from bssrdf.transport.observed import middles
from bssrdf.transport.sample_light import curve_off, total_off

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
ENOUGH = 48
"""Radii that tell how two models differ, which is smooth: of 96 and more every second, fourth and so on is looked at,
and weights and answers are laid on those."""
OF_RADII = ("r_lo", "r_hi", "arc", "rd", "known", "log_r", "within")
E = NUMPY
_OF_MODELS = ("table", "exit", "side", "eta", "g")
"""Shared errors that ask for more than the data."""


def to_log(q: Floats) -> Floats:
    """(b, 2, 2): derivatives of (ln σa, ln σs′) by (s, q)."""
    q = np.maximum(q[:, 0], 1e-300)
    one = np.ones_like(q)
    return np.stack([np.stack([one, 2 / q], 1), np.stack([one, -2 * q / 3 / (1 - q * q / 3)], 1)], 1)


def table_error(fitted: Fitted) -> Floats:
    """From the Monte Carlo noise of the table's knots, which are independent."""
    at, model = fitted.found.point, fitted.model
    q = np.clip(np.abs(at.q), 1e-12, model.q_max)
    knots = round(V_MAX / KNOT_STEP) + 1
    by_knot = np.zeros((2, q.shape[0] * knots))
    for c, answer in zip(fitted.data.curves, fitted.judged.answer, strict=True):
        t = np.clip(np.log1p(middles(E, c, at.log_sigma) / R_ZERO) / V_MAX, 0, 1) * (knots - 1)
        knot = np.minimum(t.astype(int), knots - 2)
        moved, ahead = to_log(at.q) @ answer, t - knot
        left = (knot + knots * np.arange(q.shape[0])[:, None]).ravel()
        for of_one, share in zip(by_knot, moved.swapaxes(0, 1), strict=True):
            of_one += np.bincount(left, (share * (1 - ahead)).ravel(), of_one.size)
            of_one += np.bincount(left + 1, (share * ahead).ravel(), of_one.size)
    edges = R_ZERO * np.expm1(np.linspace(0, 1, knots) * V_MAX)
    sd = model.shape_sd(E, q, np.broadcast_to(edges, (q.shape[0], knots)))
    return np.sqrt(np.square(by_knot.reshape(2, *sd.shape) * sd).sum(2)).T


def sample_error(fitted: Fitted) -> Floats:
    """From what the ratio to a half space may be off by, in the curve and in R, which go one way; they stand in the
    interval too."""
    samples, judged, q = fitted.found.laid.samples, fitted.judged, fitted.found.point.q
    turn, moved = to_log(q), np.zeros((q.shape[0], 2))
    for laid, answer in zip(samples, judged.answer, strict=True):
        if laid:
            moved += ((turn @ answer) * curve_off(laid)[:, None, :]).sum(2)
    by_total = (turn @ judged.total_answer[:, :, None])[:, :, 0]
    offs = [total_off(samples[k]) for k in fitted.plan.totals if samples[k]]
    return np.abs(moved) + np.abs(by_total) * np.max([np.zeros_like(q), *offs], axis=0)


class Fewer(NamedTuple):
    """Some rows with fewer radii, which tell how two models differ."""

    rows: Any
    """Which: a slice where all, else their places."""
    nodes: tuple[NDArray[np.int_], ...]
    """By slice: which of the radii."""
    ahead: tuple[Floats, ...]
    """By slice, (b, u): how far each radius lies from one of them to the next, in ln r."""
    plan: Plan
    data: Problem

    def summed(self, parts: Sequence[Any]) -> list[Any]:
        """By slice what hangs on every radius, (b, ..., u), laid on the nodes beside it."""
        found = []
        for part, nodes, ahead in zip(parts, self.nodes, self.ahead, strict=True):
            of = part[self.rows]
            share = ahead if of.ndim == 2 else ahead[:, None, :]
            laid = np.add.reduceat(of * (1 - share), nodes, axis=-1)
            laid[..., 1:] += np.add.reduceat(of * share, nodes, axis=-1)[..., :-1]
            found.append(laid)
        return found


def fewer(plan: Plan, data: Problem) -> list[Fewer]:
    """All rows, by how many of their radii stand for one, whatever rows are beside them."""
    found = []
    radii = np.stack([(c.known != 0).any(axis=2).sum(axis=1) for c in data.curves], axis=1)
    steps = 2 ** np.log2(np.maximum(radii / ENOUGH, 1)).astype(int)
    kinds = np.unique(steps, axis=0)
    for each in kinds:
        rows = np.flatnonzero((steps == each).all(axis=1)) if len(kinds) > 1 else slice(None)
        part = picked(data, rows)
        nodes = tuple(_every(c.r_lo.shape[1], step) for c, step in zip(part.curves, each, strict=True))
        sights = [
            s._replace(inner=int((at < s.inner).sum()), blur_inner=int((at < s.blur_inner).sum()))
            for s, at in zip(plan.sights, nodes, strict=True)
        ]
        curves = [
            c._replace(**{name: getattr(c, name)[:, at] for name in OF_RADII})
            for c, at in zip(part.curves, nodes, strict=True)
        ]
        ahead = tuple(_ahead(c.log_r, at) for c, at in zip(part.curves, nodes, strict=True))
        few = part._replace(curves=tuple(curves))
        found.append(Fewer(rows, nodes, ahead, plan._replace(sights=tuple(sights)), few))
    return found


def _at(sampled: Any, rows: NDArray[np.int_], nodes: NDArray[np.int_]) -> Any:
    """Of what was laid of a sample; nothing of a half space."""
    return type(sampled)(*(each[rows][:, nodes] if each.shape[1] > 1 else each[rows] for each in sampled))


def _every(radii: int, step: int) -> NDArray[np.int_]:
    """Each `step`th place, and the last."""
    at = np.arange(0, radii, step)
    return at if at[-1] == radii - 1 else np.append(at, radii - 1)


def _ahead(log_r: Floats, nodes: NDArray[np.int_]) -> Floats:
    counts = np.diff(np.append(nodes, log_r.shape[1]))
    here, after = (np.repeat(log_r[:, at], counts, axis=1) for at in (nodes, np.append(nodes[1:], nodes[-1])))
    return np.where(after > here, log_r - here, 0.0) / np.where(after > here, after - here, 1.0)


def sensitivities(fitted: Fitted, every: Sequence[Fewer]) -> dict[str, Floats]:
    """d ln(σa, σs′) by η and g, as `d_ln_sigma_a_d_g`: by the model, and for η by the slice's convention as well."""
    found, judged, beside = fitted.found, fitted.judged, fitted.beside
    out = {f"d_ln_{key}_d_{name}": np.empty(found.cost.size) for name in beside for key in ("sigma_a", "sigma_sp")}
    for few in every if beside else ():
        point, answers = picked(found.point, few.rows), few.summed(judged.answer)
        here = [value[few.rows][:, at] for (value, *_), at in zip(judged.seen.curves, few.nodes, strict=True)]
        samples = tuple(_at(s, few.rows, at) for s, at in zip(found.laid.samples, few.nodes, strict=True))
        total_here = [total[few.rows] for total, *_ in judged.seen.totals]
        turn, of_total = to_log(point.q), judged.total_answer[few.rows, :, None]
        for name, (made, step) in beside.items():
            other = made()
            factors = [step * by_eta if name == "eta" else 0.0 for _, by_eta in few.data.factor_slopes]
            laid = lay(E, few.plan._replace(shared=()), other, few.data, point, {})._replace(samples=samples)
            aside = look(E, few.plan, other, few.data, laid, point)
            moved = np.zeros((point.q.shape[0], 2))
            for (value, *_), old, answer, factor in zip(aside.curves, here, answers, factors, strict=True):
                change = np.log(np.maximum(value, 1e-300) / np.maximum(old, 1e-300)) + factor
                moved -= ((turn @ answer) * change[:, None, :]).sum(2)
            for k, (value, *_), old in zip(
                few.plan.totals, aside.totals, total_here, strict=False
            ):  # one without R too
                moved -= (turn @ of_total)[:, :, 0] * (np.log(value / old) + factors[k]) / len(aside.totals)
            for column, key in enumerate(("sigma_a", "sigma_sp")):
                out[f"d_ln_{key}_d_{name}"][few.rows] = moved[:, column] / step
    return out


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


def bias(fitted: Fitted, every: Sequence[Fewer], truth: Truth) -> Bias:
    """At the medium found and then at that less its bias; how far the bias moves between the two is added."""
    found, judged, b = fitted.found, fitted.judged, len(fitted.jobs)
    error, pull, drift, same = np.empty((b, 2)), np.empty(b), np.empty(b), np.empty(b, bool)
    values = [np.maximum(value, TINY) for value, _, _ in judged.seen.curves]
    relative = [mass * value**2 for mass, value in zip(found.weights.mass, values, strict=True)]
    for few in every:
        rows, of = few.rows, picked(found, few.rows)
        here = [value[rows][:, at] for value, at in zip(values, few.nodes, strict=True)]
        mass = tuple(part / value**2 for part, value in zip(few.summed(relative), here, strict=True))
        laid = lay(E, few.plan, truth.dipole, few.data, of.point, fitted.beside)
        of = of._replace(laid=laid, weights=Weights(mass, mass))
        first, on_first = _bias_at(few, truth, of, of.point, judged.n)
        again, on_again = _bias_at(few, truth, of, _unbiased(of.point, first), judged.n)
        off_first, off_again = (1 / np.maximum(1 + each, LEAST_RATIO) - 1 for each in (first, again))
        moved = np.abs(off_again) + np.abs(off_again - off_first)
        error[rows] = np.where(np.isfinite(again), moved, np.abs(off_first))
        pull[rows] = np.fmax(np.abs(on_first.pull), np.abs(on_again.pull))
        drift[rows] = np.fmax(on_first.drift, on_again.drift)
        same[rows] = np.abs(judged.pull[rows] - on_again.pull) < LIKE_PULL
        same[rows] &= np.abs(judged.chi2[rows] - on_again.chi2) < LIKE_CHI2 * on_again.chi2
    fits = (judged.chi2 < 1) & (np.abs(judged.pull) < FITS_PULL)
    return Bias(error, pull, drift, ~fits & ~same)


def _bias_at(few: Fewer, truth: Truth, found: Solution, at: Point, n: Floats) -> tuple[Floats, Judged]:
    at, data, curves = _light_of(few.plan, truth.table, few.data, at)
    refit = refitted(few.plan, truth.dipole, data, found, Weights(found.weights.mass, curves))
    return _off(refit.point, at), judge(few.plan, truth.dipole, data, refit, significant=0.0, n=n[few.rows])


def dipole_on_light(fitted: Fitted) -> Floats:
    """Relative error (b, 2) of the dipole fitted to the model's own light at these optima, as the data lie."""
    at, data, values = _light_of(fitted.plan, fitted.model, fitted.data, fitted.found.point)
    curves = tuple(
        c._replace(rd=np.broadcast_to(value[..., None], c.rd.shape))
        for c, value in zip(data.curves, values, strict=True)
    )
    plan = fitted.plan._replace(shared=tuple(e for e in fitted.plan.shared if e.source not in _OF_MODELS))
    ended = settle(E, plan, dipole(fitted.model.eta), data._replace(curves=curves), at, {})
    error = np.abs(_off(ended.point, at))
    return np.where(np.isfinite(error) & ended.converged[:, None], error, np.inf)


def _off(found: Point, true: Point) -> Floats:
    """Relative error of (σa, σs′), (b, 2), NaN where it is not finite."""
    ours, theirs = (np.concatenate(coefficients(p.log_sigma, p.q), axis=1) for p in (found, true))
    with np.errstate(divide="ignore", invalid="ignore"):
        off = ours / theirs - 1
    return np.where(np.isfinite(off), off, np.nan)


def _light_of(plan: Plan, truth: Light, data: Problem, at: Point) -> tuple[Point, Problem, tuple[Any, ...]]:
    """The point in the model's range, the data with the totals that `truth` has there, and its curves."""
    at, bare = at._replace(q=np.clip(at.q, 1e-6, truth.q_max)), plan._replace(shared=())
    laid = lay(E, bare, truth, data, at, {})
    looked = look(E, bare, truth, data, laid, at)
    totals = tuple(
        Total(total[0] * seen, each.sd)
        for each, total, seen in zip(data.totals, looked.totals, laid.total_seen, strict=False)
    )
    return at, data._replace(totals=totals), tuple(value for value, _, _ in looked.curves)


def refitted(plan: Plan, model: Light, data: Problem, found: Solution, weights: Weights) -> Solution:
    """Fit again near by, with these weights and data; spot and angle as they were."""
    return optimise(E, plan, model, data, found.laid, found.point, NEAR_BY, relay=False, weights=weights)


def _unbiased(point: Point, biased: Floats) -> Point:
    """The media whose fits, of that bias, came out as they did."""
    sigma = np.concatenate(coefficients(point.log_sigma, point.q), axis=1)
    sigma_a, sigma_sp = (sigma / np.maximum(1 + np.nan_to_num(biased), LEAST_RATIO)).T
    log_sigma, q = shape_of(np.maximum(sigma_a, 1e-300), sigma_sp)
    return point._replace(log_sigma=log_sigma[:, None], q=q[:, None])
