"""Where the beam lands, and how wide its spot is, from the image of it. Lengths in pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError

Array = NDArray[np.float64]

_PASSES = 50
_SETTLED_PX = 1e-3


class Spot(NamedTuple):
    """Centre of the spot and the covariance of its brightness about it."""

    x_px: float
    y_px: float
    covariance_px2: Array
    """2×2."""

    def ellipse_px(self) -> tuple[float, float, float]:
        """1/e² radii (long, short) of the Gaussian of this covariance, and the angle of the long one to x [rad]."""
        widths, axes = np.linalg.eigh(self.covariance_px2)
        return 2 * float(np.sqrt(widths[1])), 2 * float(np.sqrt(widths[0])), float(np.arctan2(axes[1, 1], axes[0, 1]))


def find_spot(x_px: Array, y_px: Array, value: Array, start: tuple[float, float], sd_px: float) -> Spot:
    """Centroid and covariance of the spot near `start`, weighted by a Gaussian that follows the spot's own shape.

    The weight keeps the far tail and its noise out (adaptive moments, Bernstein & Jarvis 2002): for a Gaussian spot
    the weighted covariance is half the spot's own, elsewhere the shape of the core. Arrays of shape (n,).
    """
    centre = np.array(start, float)
    shape = np.eye(2) * sd_px**2
    for _ in range(_PASSES):
        offset = np.stack([x_px - centre[0], y_px - centre[1]])
        weight = value * np.exp(-0.5 * (offset * (np.linalg.inv(shape) @ offset)).sum(axis=0))
        total = weight.sum()
        if not total > 0:
            raise InputError("the spot cannot be found in the image; check that the beam lies in the frame")
        step = offset @ weight / total
        next_shape = 2 * ((offset * weight) @ offset.T / total - np.outer(step, step))
        centre += 2 * step
        if np.hypot(*step) < _SETTLED_PX and np.allclose(next_shape, shape, rtol=1e-3):
            break
        shape = next_shape
    return Spot(float(centre[0]), float(centre[1]), next_shape)
