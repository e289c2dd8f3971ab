"""Least squares of a few parameters between bounds.

SciPy does the same; its import takes longer than all the fits of a session.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-15, 1e12
_HARDER, _SOFTER = 4.0, 0.1
"""Factors of the damping after a step that fails and after one that does not."""
_MOST_STEPS = 300
_SETTLED = 1e-12
"""Relative decrease of the sum of squares, and step over the parameters' size, that are none."""
_DIFFERENCE = 2.0**-26
"""Step of a slope, the root of what float64 resolves."""


class Minimum(NamedTuple):
    """Parameters (k,) and residuals (n,) at the minimum, and the slopes (n, k) there."""

    x: Array
    residuals: Array
    slopes: Array

    @property
    def cost(self) -> float:
        """Half the sum of the squared residuals."""
        return float(self.residuals @ self.residuals) / 2


def least_squares(
    residual: Callable[[Array], Array], start: Array, low: Array, high: Array, longest: float = np.inf
) -> Minimum:
    """Levenberg & Marquardt's method within bounds; a parameter that pushes against one rests.

    Args: `residual` of parameters (k,) to (n,); `start`, `low` and `high` of shape (k,), infinite where there is no
    bound; `longest` step of a parameter, since a leap may end where nothing has a slope.
    """
    x = np.clip(start, low, high)
    here, damping = residual(x), _FIRST_DAMPING
    slopes = _slopes(residual, x, here, high)
    for _ in range(_MOST_STEPS):
        tried = _tried(x, slopes.T @ here, slopes.T @ slopes, damping, low, high)
        tried = x + (tried - x) * min(1.0, longest / max(float(np.abs(tried - x).max()), 1e-300))
        there = residual(tried)
        before, after = float(here @ here), float(there @ there)
        settled = np.all(np.abs(tried - x) <= _SETTLED * (1 + np.abs(x))) or abs(before - after) <= _SETTLED * before
        if after <= before:
            x, here, damping = tried, there, max(damping * _SOFTER, _LEAST_DAMPING)
            slopes = _slopes(residual, x, here, high)
        else:
            damping *= _HARDER
        if settled or damping > _MOST_DAMPING:
            break
    return Minimum(x, here, slopes)


def _tried(x: Array, gradient: Array, curvature: Array, damping: float, low: Array, high: Array) -> Array:
    """The damped step within the bounds: where a parameter would leave them, the others make do with it there."""
    damped = curvature + damping * np.diag(np.diag(curvature) + np.finfo(float).tiny)
    free = ~(((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0)))
    step = np.zeros_like(x)
    while free.any():
        pull = gradient + damped @ np.where(free, 0.0, step)
        step[free] = -np.linalg.lstsq(damped[np.ix_(free, free)], pull[free], rcond=None)[0]
        beyond = free & ((x + step < low) | (x + step > high))
        if not beyond.any():
            break
        step[beyond] = np.clip(x + step, low, high)[beyond] - x[beyond]
        free &= ~beyond
    return np.clip(x + step, low, high)


def _slopes(residual: Callable[[Array], Array], x: Array, here: Array, high: Array) -> Array:
    """Forward differences, backward at an upper bound."""
    steps = _DIFFERENCE * np.maximum(1.0, np.abs(x))
    steps = np.where(x + steps > high, -steps, steps)
    return np.stack([(residual(x + step) - here) / step.sum() for step in np.diag(steps)], axis=1)
