"""What a fit cannot know from its own curve: how far the model is off, and what a wrong g or η would do."""

from __future__ import annotations

from typing import Any

import numpy as np

from bssrdf.fit.batch import Fitted, run_padded
from bssrdf.fit.choose import ASSUMED_G, model_of, tabulated
from bssrdf.fit.compare import Refit, bias_batch, refit_batch
from bssrdf.fit.curves import Curves
from bssrdf.fit.kernel import Solution
from bssrdf.transport.forward import ForwardModel
from bssrdf.transport.table_grid import R_ZERO, U_MAX, V_MAX, u_of

G_STEP = 0.05
ETA_STEP = 0.01
NOISE_DRAWS = 4
NOISE_SEED = 1
LEAST_RATIO = 0.2
"""Of a fitted coefficient to the true one, in undoing a bias."""

Errors = list[dict[str, float]]


def model_errors(fitted: Fitted) -> Errors:
    """Relative model error of σa and σs′ by job: the dipole's bias against the table, the table's own noise."""
    if fitted.group.model == "dipole":
        return _dipole_errors(fitted)
    shifts = [_shift(fitted, _refit(fitted, fitted.model, data)) for data in _noisy_data(fitted)]
    rms = np.sqrt(np.mean(np.square(shifts), axis=0))
    return [{"sigma_a": float(a), "sigma_sp": float(sp)} for a, sp in rms]


def sensitivities(fitted: Fitted) -> Errors:
    """d ln σ/dη, and for the table d ln σ/dg, of both coefficients by job, by refitting with the models beside."""
    eta, g = fitted.group.eta, fitted.group.g
    neighbours = {"eta": ((eta - ETA_STEP, g), (eta + ETA_STEP, g), ETA_STEP)}
    if fitted.group.model == "mc":
        assumed = ASSUMED_G if g is None else g
        neighbours["g"] = ((eta, assumed - G_STEP), (eta, assumed + G_STEP), G_STEP)
    found: Errors = [{} for _ in fitted.jobs]
    for name, (below, above, step) in neighbours.items():
        ends = [end for end in (below, above) if fitted.group.model == "dipole" or tabulated(*end)]
        if not ends:
            continue
        refits = [_refit(fitted, model_of(fitted.group.model, *end)) for end in ends]
        first, last = (refits[0], refits[1]) if len(ends) == 2 else _ordered(fitted, refits[0], ends[0] == above)
        for row, entry in enumerate(found):
            for key in ("sigma_a", "sigma_sp"):
                a, b = float(getattr(first, key)[row]), float(getattr(last, key)[row])
                slope = float(np.log(b / a)) / (step * len(ends)) if a > 0 and b > 0 else float("nan")
                entry[f"d_ln_{key}_d_{name}"] = slope
    return found


def _ordered(fitted: Fitted, refit: Refit, is_above: bool) -> tuple[Any, Any]:
    """The fit and its only neighbour, the lower first."""
    return (fitted.judged, refit) if is_above else (refit, fitted.judged)


def chi2_by_g(fitted: Fitted, gs: tuple[float, ...]) -> np.ndarray:
    """χ² of every job under the tables of other g, shape (len(gs), jobs)."""
    return np.array([_refit(fitted, model_of("mc", fitted.group.eta, g)).chi2 for g in gs])


def _dipole_errors(fitted: Fitted) -> Errors:
    """What the dipole makes of the table's light of the medium; {} where no table ships for it.

    The medium is at first the one that was found, then that one less its bias. How far the bias moves between the two
    is how unsure it is, and is added.
    """
    if not tabulated(fitted.group.eta, fitted.group.g):
        return [{} for _ in fitted.jobs]
    first = _bias_at(fitted, fitted.judged.solution)
    again = _bias_at(fitted, _less(fitted, first))
    sure = np.isfinite(again)
    error = np.where(sure, np.abs(again) + np.abs(again - first), np.abs(first))
    return [{"sigma_a": float(a), "sigma_sp": float(sp)} for a, sp in error]


def _bias_at(fitted: Fitted, solution: Solution) -> np.ndarray:
    """Relative bias of (σa, σs′) of the dipole on the table's light of the solutions, shape (jobs, 2)."""
    truth = model_of("mc", fitted.group.eta, fitted.group.g)
    batch = (fitted.data, solution)
    bias: Refit = run_padded(lambda each: bias_batch(fitted.group.task, fitted.model, truth, *each), batch)
    absorbed = np.square(np.clip(solution.point.q, 0, truth.q_max)) / 3
    sigma_tp = np.exp(solution.point.log_sigma_tp)
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = [bias.sigma_a / (absorbed * sigma_tp) - 1, bias.sigma_sp / ((1 - absorbed) * sigma_tp) - 1]
    return np.where(np.isfinite(columns), columns, np.nan).T


def _less(fitted: Fitted, bias: np.ndarray) -> Solution:
    """The solutions of the media whose fits, of that bias, came out as they did."""
    found = np.stack([fitted.judged.sigma_a, fitted.judged.sigma_sp], axis=1)
    sigma_a, sigma_sp = (found / np.maximum(1 + np.nan_to_num(bias), LEAST_RATIO)).T
    solution: Solution = fitted.judged.solution
    sigma_tp = sigma_a + sigma_sp
    point = solution.point._replace(log_sigma_tp=np.log(sigma_tp), q=np.sqrt(3 * sigma_a / sigma_tp))
    return solution._replace(point=point)


def _refit(fitted: Fitted, model: ForwardModel, data: Curves | None = None) -> Refit:
    batch = (data or fitted.data, fitted.judged.solution)
    result: Refit = run_padded(lambda each: refit_batch(fitted.group.task, model, *each), batch)
    return result


def _shift(fitted: Fitted, refit: Refit) -> np.ndarray:
    """Relative change of (σa, σs′), shape (jobs, 2); NaN where σa is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = [refit.sigma_a / fitted.judged.sigma_a - 1, refit.sigma_sp / fitted.judged.sigma_sp - 1]
    return np.where(np.isfinite(columns), columns, np.nan).T


def _noisy_data(fitted: Fitted) -> list[Curves]:
    """The data with the table's own noise instead of the model with it: to first order the same, and simpler."""
    rng = np.random.default_rng(NOISE_SEED)
    table: Any = fitted.model
    sd = np.asarray(table.log_curve_sd)
    point = fitted.judged.solution.point
    row = np.clip(u_of(np.clip(point.q, 0, fitted.model.q_max) / np.sqrt(3)) / U_MAX, 0, 1) * (sd.shape[0] - 1)
    centre = (fitted.data.r_lo + fitted.data.r_hi) / 2 * np.exp(point.log_sigma_tp)[:, None]
    column = np.clip(np.log1p(centre / R_ZERO) / V_MAX, 0, 1) * (sd.shape[1] - 1)
    draws = []
    for _ in range(NOISE_DRAWS):
        noise = sd[np.rint(row).astype(int)] * rng.standard_normal((len(row), sd.shape[1]))
        wave = np.stack([np.interp(x, np.arange(sd.shape[1]), y) for x, y in zip(column, noise, strict=True)])
        draws.append(fitted.data._replace(rd=fitted.data.rd * (1 + wave)))
    return draws
