"""The 1/e² radius of the beam's spot from a knife edge. Lengths in mm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import erf

from bssrdf.errors import InputError

Array = NDArray[np.float64]


def knife_edge_radius(position: Array, light: Array) -> float:
    """1/e² radius from the light that passes an edge moved across the spot, arrays of shape (n,), n ≥ 5.

    A Gaussian spot of radius w passes (1 + erf(√2 (x − x₀)/w))/2.
    """
    if len(position) < 5:
        raise InputError(f"{len(position)} positions of the edge do not tell the spot's radius; give at least five")
    low, high = light.min(), light.max()
    middle = float(np.interp((low + high) / 2, np.sort(light), position[np.argsort(light)]))
    rising = 1.0 if light[np.argmax(position)] > light[np.argmin(position)] else -1.0

    def residual(p: Array) -> Array:
        centre, log_radius, bottom, top = p
        return (
            bottom + (top - bottom) * (1 + erf(rising * 2**0.5 * (position - centre) / np.exp(log_radius))) / 2 - light
        )

    start = [middle, np.log(np.ptp(position) / 8), low, high]
    return float(np.exp(least_squares(residual, start).x[1]))
