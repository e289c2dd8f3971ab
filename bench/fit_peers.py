"""The other ways to fit the same curves: jaxopt, and SciPy one curve at a time."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares, minimize

from bssrdf.transport import dipole
from bssrdf.transport.dipole import Medium
from bssrdf.transport.fresnel import boundary_a


class PeerProblem(NamedTuple):
    """Curves on equal footing: a row each, every radius counting."""

    r_mm: np.ndarray
    """(b, n)"""
    rd: np.ndarray
    sd: np.ndarray
    total_r: np.ndarray
    """(b,)"""
    total_r_sd: np.ndarray
    eta: float


class PeerFit(NamedTuple):
    """Coefficients (b,) and what they took."""

    sigma_a: np.ndarray
    sigma_sp: np.ndarray
    seconds_each: float
    fails: int = 0
    """Curves on which the method itself gave up, or that it left with numbers that are none."""


class Found(NamedTuple):
    """One curve's coefficients, and whether the method says that it got there."""

    sigma_a: float
    sigma_sp: float
    success: bool


def dipole_numpy(sigma_a: float, sigma_sp: float, a: float, r: np.ndarray) -> np.ndarray:
    """Eq. 4 in numpy, as a SciPy user writes it."""
    sigma_tp = sigma_a + sigma_sp
    sigma_tr = np.sqrt(3 * sigma_a * sigma_tp)
    rd = np.zeros_like(r)
    for z in (1 / sigma_tp, (1 + 4 / 3 * a) / sigma_tp):
        d = np.hypot(r, z)
        rd += z * (1 + sigma_tr * d) * np.exp(-sigma_tr * d) / d**3
    return sigma_sp / sigma_tp / (4 * np.pi) * rd


def total_numpy(sigma_a: float, sigma_sp: float, a: float) -> float:
    """The closed-form total in numpy."""
    sigma_tp = sigma_a + sigma_sp
    q = np.sqrt(3 * sigma_a / sigma_tp)
    return float(sigma_sp / sigma_tp / 2 * (1 + np.exp(-4 / 3 * a * q)) * np.exp(-q))


def scipy_exact(problem: PeerProblem, ratio: np.ndarray) -> PeerFit:
    """`least_squares` in ln σt′ alone; `ratio` is σa/σt′ as R gives it."""

    def fit(row: int, a: float) -> Found:
        def rest(x: np.ndarray) -> np.ndarray:
            sigma_tp = np.exp(x[0])
            model = dipole_numpy(ratio[row] * sigma_tp, (1 - ratio[row]) * sigma_tp, a, problem.r_mm[row])
            return (problem.rd[row] - model) / problem.sd[row]

        found = least_squares(rest, [_start(problem, row)], xtol=1e-10, ftol=1e-12)
        sigma_tp = float(np.exp(found.x[0]))
        return Found(ratio[row] * sigma_tp, (1 - ratio[row]) * sigma_tp, found.success)

    return _one_by_one(problem, fit)


def scipy_soft(problem: PeerProblem) -> PeerFit:
    """`least_squares` in (ln σa, ln σs′), with R as one additional datum."""

    def fit(row: int, a: float) -> Found:
        def rest(x: np.ndarray) -> np.ndarray:
            sigma_a, sigma_sp = np.exp(x)
            curve = (problem.rd[row] - dipole_numpy(sigma_a, sigma_sp, a, problem.r_mm[row])) / problem.sd[row]
            return np.append(
                curve, (problem.total_r[row] - total_numpy(sigma_a, sigma_sp, a)) / problem.total_r_sd[row]
            )

        start = _start(problem, row)
        found = least_squares(rest, [start - 3, start], x_scale="jac", xtol=1e-10, ftol=1e-12)
        return Found(float(np.exp(found.x[0])), float(np.exp(found.x[1])), found.success)

    return _one_by_one(problem, fit)


def scipy_slsqp(problem: PeerProblem) -> PeerFit:
    """`minimize` by SLSQP with the constraint as the paper writes it: ∫R_d dA = R."""

    def fit(row: int, a: float) -> Found:
        def cost(x: np.ndarray) -> float:
            sigma_a, sigma_sp = np.exp(x)
            model = dipole_numpy(sigma_a, sigma_sp, a, problem.r_mm[row])
            return float(np.mean(((problem.rd[row] - model) / problem.sd[row]) ** 2))

        start = _start(problem, row)

        def excess(x: np.ndarray) -> float:
            return total_numpy(np.exp(x[0]), np.exp(x[1]), a) - float(problem.total_r[row])

        constraint = {"type": "eq", "fun": excess}
        begin, limit = [start - 3, start], {"maxiter": 200}
        found = minimize(cost, begin, method="SLSQP", constraints=[constraint], options=limit)
        return Found(float(np.exp(found.x[0])), float(np.exp(found.x[1])), found.success)

    return _one_by_one(problem, fit)


def jaxopt_soft(problem: PeerProblem) -> PeerFit:
    """jaxopt's Levenberg–Marquardt mapped over the batch, in the parameters of our own fit."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from jaxopt import LevenbergMarquardt

    def rest(
        x: jax.Array, r: jax.Array, rd: jax.Array, sd: jax.Array, total_r: jax.Array, total_sd: jax.Array
    ) -> jax.Array:
        sigma_tp, absorbed = jnp.exp(x[0]), x[1] ** 2 / 3
        medium = Medium(absorbed * sigma_tp, (1 - absorbed) * sigma_tp, problem.eta)
        gap = (total_r - dipole.total_r(medium)) / total_sd
        return jnp.append((rd - dipole.rd(medium, r)) / sd, gap)

    solver = LevenbergMarquardt(
        rest, maxiter=60, materialize_jac=True, solver="cholesky", xtol=1e-8, gtol=1e-8,
        stop_criterion="madsen-nielsen", implicit_diff=False,
    )  # fmt: skip
    data = tuple(jnp.asarray(each) for each in problem[:5])
    start = jnp.stack([jnp.asarray([_start(problem, row), 0.3]) for row in range(len(problem.rd))])
    run = jax.jit(jax.vmap(lambda x, *data: solver.run(x, *data).params))
    x, seconds = timed(lambda: jax.block_until_ready(run(start, *data)))
    sigma_tp, absorbed = np.exp(x[:, 0]), np.asarray(x[:, 1]) ** 2 / 3
    return PeerFit(absorbed * sigma_tp, (1 - absorbed) * sigma_tp, seconds / len(problem.rd))


def timed(call: Callable[[], Any], repeats: int = 3) -> tuple[np.ndarray, float]:
    """Result and shortest time of a warm call, in seconds of the processor."""
    result = call()
    best = np.inf
    for _ in range(repeats):
        began = time.process_time()
        result = call()
        best = min(best, time.process_time() - began)
    return np.asarray(result), best


def _one_by_one(problem: PeerProblem, fit: Callable[[int, float], Found]) -> PeerFit:
    a = float(boundary_a(problem.eta))
    began = time.process_time()
    with np.errstate(all="ignore"):  # some of them wander off; their errors show it
        found = [fit(row, a) for row in range(len(problem.rd))]
    seconds = (time.process_time() - began) / len(problem.rd)
    sigma_a, sigma_sp, success = (np.array(column) for column in zip(*found, strict=True))
    good = success & np.isfinite(sigma_a) & np.isfinite(sigma_sp)
    return PeerFit(np.where(good, sigma_a, np.nan), np.where(good, sigma_sp, np.nan), seconds, int((~good).sum()))


def _start(problem: PeerProblem, row: int) -> float:
    """ln σt′ of a medium whose outermost radius is 15 mean free paths away."""
    return float(np.log(15 / problem.r_mm[row, -1]))
