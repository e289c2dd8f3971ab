"""Several slices of one material fitted together: σa and σs′ in common, errors of scale and length by slice.

What a slice's scale and length may be off by spreads its residuals together. That covariance, V = 1 + Σ sd² b bᵀ with
b the residuals' derivative, weighs the slices against each other. Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.fit.batch import pick
from bssrdf.fit.choose import Announce, ModelName
from bssrdf.fit.curves import Curves
from bssrdf.fit.kernel import Residual, Solution, Task, residual, reweighted, share_of_noise
from bssrdf.fit.predict import Parameters, total
from bssrdf.fit.result import PARABOLIC, POOR_CHI2, VAGUE, Z95, spread_of
from bssrdf.fit.run import FitOptions, fit_batches, fit_slices
from bssrdf.session.records import ChannelFit, Slice, Status
from bssrdf.transport.forward import ForwardModel
from bssrdf.transport.precision import scoped_x64

Floats = NDArray[np.float64]
STEPS = 20
SETTLED = 1e-7


class _Part(NamedTuple):
    """One slice of one channel as its own fit left it."""

    task: Task
    model: ForwardModel
    data: Curves
    solution: Solution
    scale_sd: float
    mm_sd: float


class _Sum(NamedTuple):
    """Normal equations in (ln σt′, q) of all slices at one point."""

    gradient: Floats
    curvature: Floats
    scatter: Floats
    """Covariance of the gradient."""
    chi2: float
    n: int


@scoped_x64
def fit_joint(
    slices: Sequence[Slice], options: FitOptions, *, announce: Announce | None = None
) -> dict[str, ChannelFit]:
    """One fit by channel for all slices; raises InputError where they are not of one medium or cannot be joined."""
    _check(slices, options)
    alone = fit_slices(slices, options, announce=announce)
    shared = [name for name in slices[0].channels if all(name in piece.channels for piece in slices)]
    if not shared:
        raise InputError("the slices have no channel in common: give slices with the same channel names")
    joined = {}
    for name in shared:
        fits = [fit[name] for fit in alone]
        model: ModelName = "mc" if any(fit.model == "mc" for fit in fits) else "dipole"
        parts = [_part(piece, name, replace(options, model=model), announce) for piece in slices]
        joined[name] = _joined(parts, fits)
    return joined


def _check(slices: Sequence[Slice], options: FitOptions) -> None:
    first = slices[0]
    for piece in slices[1:]:
        for key in ("eta", "g"):
            ours, other = getattr(first, key), getattr(piece, key)
            if ours != other:
                raise InputError(f"{key} = {ours} in one slice and {other} in another: join slices of one medium only")
    if options.scale == "free":
        raise InputError("scale free leaves each slice its own factor: fit such slices one by one")


def _part(piece: Slice, name: str, options: FitOptions, announce: Announce | None) -> _Part:
    one = replace(piece, channels={name: piece.channels[name]})
    (fitted,) = (each for each in fit_batches([one], options, announce) if each.jobs)
    if fitted.group.task.constraint == "exact":
        raise InputError(f"R of channel {name} has no error: give total_r_sd to weigh it, or --constraint none")
    data, solution = pick(fitted.data, 0), pick(fitted.judged.solution, 0)
    return _Part(fitted.group.task, fitted.model, data, solution, piece.scale_rel_sd or 0.0, piece.mm_rel_sd or 0.0)


def _joined(parts: Sequence[_Part], alone: Sequence[ChannelFit]) -> ChannelFit:
    """Gauss–Newton from the most precise slice's own optimum."""
    surest = min(range(len(parts)), key=lambda at: alone[at].sigma_sp_sd_per_mm / alone[at].sigma_sp_per_mm)
    point = parts[surest].solution.point
    x = np.array([float(point.log_sigma_tp), float(point.q)])
    for _ in range(STEPS):
        sums = _sum(parts, x)
        move = np.clip(-np.linalg.solve(sums.curvature, sums.gradient), -0.5, 0.5)
        x = x + move
        if np.abs(move).max() < SETTLED:
            break
    sums = _sum(parts, x)
    inverse = np.linalg.inv(sums.curvature)
    covariance = inverse @ sums.scatter @ inverse
    result = _result(x, covariance, alone[surest])
    chi2 = sums.chi2 / max(sums.n - 2, 1)
    known = all(part.task.errors_known for part in parts)
    model = parts[0].model
    return replace(
        result,
        model_error=_largest(fit.model_error for fit in alone),
        total_r_model=float(total(model, jnp.asarray(x[1]))),
        window_mm=(min(fit.window_mm[0] for fit in alone), max(fit.window_mm[1] for fit in alone)),
        n=sum(fit.n for fit in alone),
        chi2_reduced=chi2 if known else float("nan"),
        flags=_flags(result, alone, known and chi2 > POOR_CHI2),
    )


def _sum(parts: Sequence[_Part], x: Floats) -> _Sum:
    gradient, curvature, scatter, chi2, n = np.zeros(2), np.zeros((2, 2)), np.zeros((2, 2)), 0.0, 0
    for part in parts:
        point = Parameters(jnp.asarray(x[0]), jnp.asarray(x[1]), jnp.asarray(0.0))
        misfit, share = _look(part.task, part.model, part.data, part.solution._replace(point=point))
        value, slopes = np.asarray(misfit.value), np.asarray(misfit.by_free)[:2]
        used = np.abs(slopes).sum(axis=0) > 0
        value, slopes, share = value[used], slopes[:, used], np.asarray(share)[used]
        common = np.stack([misfit.by_log_scale, misfit.by_log_mm])[:, used] * [[part.scale_sd], [part.mm_sd]]
        weigh = np.linalg.inv(np.eye(value.size) + common.T @ common)
        if not part.task.errors_known:
            share = share * (value @ weigh @ value) / max(value.size - 2, 1)
        weighed = slopes @ weigh
        gradient += weighed @ value
        curvature += weighed @ slopes.T
        scatter += weighed @ (np.diag(share) + common.T @ common) @ weighed.T
        chi2 += float(value @ weigh @ value)
        n += value.size
    return _Sum(gradient, curvature, scatter, chi2, n)


@partial(jax.jit, static_argnums=0)
def _look(task: Task, model: ForwardModel, data: Curves, at: Solution) -> tuple[Residual, Float[Array, " m"]]:
    known = jnp.where(jnp.isnan(data.weight), 1.0, data.weight)
    there = reweighted(task, model, data, known, at)
    return residual(task, model, data, there), share_of_noise(task, data, there, jnp.ones_like(at.point.q))


def _result(x: Floats, covariance: Floats, like: ChannelFit) -> ChannelFit:
    """The coefficients with their linear errors; σa's interval is that of q where q is near 0."""
    sigma_tp, q = float(np.exp(x[0])), max(float(x[1]), 0.0)
    q_sd = float(np.sqrt(covariance[1, 1]))
    value = sigma_tp * np.array([q * q / 3, 1 - q * q / 3])
    slope = np.array([[value[0], sigma_tp * 2 * q / 3], [value[1], -sigma_tp * 2 * q / 3]])
    errors = slope @ covariance @ slope.T
    sd = np.sqrt(np.diag(errors))
    bounds = (sigma_tp / 3 * max(x[1] - Z95 * q_sd, 0.0) ** 2, sigma_tp / 3 * max(x[1] + Z95 * q_sd, 0.0) ** 2)
    interval = spread_of(value[0], sd[0]) if q > PARABOLIC * q_sd else bounds
    return replace(
        like,
        sigma_a_per_mm=float(value[0]),
        sigma_a_sd_per_mm=float(sd[0]),
        sigma_a_interval95_per_mm=interval,
        sigma_sp_per_mm=float(value[1]),
        sigma_sp_sd_per_mm=float(sd[1]),
        sigma_sp_interval95_per_mm=spread_of(float(value[1]), float(sd[1])),
        correlation=float(errors[0, 1] / (sd[0] * sd[1])) if sd.all() else float("nan"),
        status=_status(interval[0], float(sd[1] / value[1])),
    )


def _status(lower: float, relative_sd: float) -> Status:
    if not relative_sd < VAGUE:
        return "unidentifiable"
    return "converged" if lower > 0 else "upper_bound"


def _flags(result: ChannelFit, alone: Sequence[ChannelFit], poor: bool) -> tuple[str, ...]:
    """All that single slices were flagged with, less what the joint fit answers by itself."""
    own = {"albedo_one": result.status == "upper_bound", "joint": True, "poor_fit": poor}
    raised = {flag for fit in alone for flag in fit.flags} - set(own)
    return tuple(sorted(raised | {name for name, holds in own.items() if holds}))


def _largest(errors: Iterable[dict[str, float]]) -> dict[str, float]:
    largest: dict[str, float] = {}
    for each in errors:
        largest |= {key: max(value, largest.get(key, 0.0)) for key, value in each.items()}
    return largest
