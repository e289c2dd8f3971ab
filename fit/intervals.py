"""95 % intervals by profile likelihood, for where the cost is not a parabola: σa near 0.

The profile holds σa and lets everything else find its best again. A bound lies where the cost has risen by the quantile
of χ² with one degree of freedom: 2.71 for a one-sided bound, 3.84 for each end of an interval.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.problem import Plan, Problem
from bssrdf.fit.solve import REST, Solution, optimise
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.light import Light, coefficients

Floats = NDArray[np.float64]
ONE_SIDED = 2.706
TWO_SIDED = 3.841
FLOOR_Q = 1e-6
CLOSE = 1e-6
"""In ln σa, where a bound has been found."""
PROBES = 60
LEAST_RISE = 1e-3
"""Of the rise that is asked for: less, or none, counts as so much."""


class Profile(NamedTuple):
    """σa and σs′ at the best q ≥ 0, and bounds of σa, (b,); inf where the cost never rises enough."""

    sigma_a: Floats
    sigma_sp: Floats
    lower: Floats
    upper: Floats


def profile(plan: Plan, model: Light, data: Problem, found: Solution, inflation: Floats) -> Profile:
    """Bounds of σa; `inflation` multiplies the variances. An R without an error fixes q = 0: then the curve alone
    bounds σa."""
    plan = plan.curve_alone

    def held(log_a: Floats) -> tuple[Floats, Floats]:
        """Cost and σs′ with this ln σa and everything else at its best."""
        begin = found.point._replace(q=np.sqrt(3 * np.exp(log_a - found.point.log_sigma)))
        keep: dict[str, Any] = {"weights": found.weights, "held_sigma_a": True}
        rest = optimise(NUMPY, plan, model, data, found.laid, begin, 10 * REST, relay=False, **keep)
        return rest.cost / inflation, coefficients(rest.point.log_sigma, rest.point.q)[1][:, 0]

    def log_a_of(q: Floats | float) -> Floats:
        return np.asarray(found.point.log_sigma + 2 * np.log(q) - np.log(3))

    best = log_a_of(np.maximum(found.point.q, FLOOR_Q))
    lowest, sigma_sp = held(best)

    def bound(rise: Floats | float, edge: float) -> tuple[Floats, Any]:
        """σa where the cost has risen by `rise` on the way to q = `edge`, and whether it has risen so much there."""

        def risen(log_a: Floats) -> Floats:
            """ln of how far the cost has risen, over `rise`: beyond the bound all but even with ln σa."""
            return np.log(np.maximum((held(log_a)[0] - lowest) / rise, LEAST_RISE))

        near, far = best, log_a_of(edge)
        near_rise, far_rise = np.full_like(lowest, np.log(LEAST_RISE)), risen(far)
        crossed = far_rise >= 0
        middle, was_below = far, np.full(lowest.size, 2)
        for _ in range(PROBES):  # Illinois: a secant that never keeps an end for long
            slope = np.where(far_rise != near_rise, far_rise - near_rise, 1.0)
            middle = near - near_rise[:, None] * (far - near) / slope[:, None]
            middle = np.where(np.isfinite(middle), middle, (near + far) / 2)
            middle = np.clip(middle, np.minimum(near, far), np.maximum(near, far))  # beyond, where nothing has crossed
            here = risen(middle)
            below = here < 0
            halved = np.where(below == was_below, 0.5, 1.0)
            far_rise = np.where(below, far_rise * halved, here)
            near_rise = np.where(below, here, near_rise * halved)
            was_below = below
            near, far = np.where(below[:, None], middle, near), np.where(below[:, None], far, middle)
            if np.all((np.abs(here) < CLOSE) | (np.abs(far - near)[:, 0] < CLOSE) | ~crossed):
                break
        return np.exp(middle)[:, 0], crossed

    lower, two_sided = bound(TWO_SIDED, FLOOR_Q)
    above = two_sided & (found.point.q[:, 0] > FLOOR_Q)
    upper, ends = bound(np.where(above, TWO_SIDED, ONE_SIDED), model.q_max)
    return Profile(
        sigma_a=np.where(found.point.q[:, 0] > FLOOR_Q, np.exp(best)[:, 0], 0.0),
        sigma_sp=sigma_sp,
        lower=np.where(above, lower, 0.0),
        upper=np.where(ends, upper, np.inf),
    )
