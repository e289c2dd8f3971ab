"""What holds a sample, and what that makes of its outer light: it falls faster, and ends at a wall. Lengths in mm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bssrdf.holding import Held
from bssrdf.session.records import Array
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.dish import slab_modes
from bssrdf.transport.finite import DEEP, Sample, level_of_half_space, total_ratio
from bssrdf.transport.slab import Top, loss_of, milne

_SOURCE_MFP = 1.0
_FAINT = 14.0
"""A mode so many decay lengths away is nothing, 1e-6."""
_MOST_MODES = 400
_DARK = 1e-300


class Holder(NamedTuple):
    """What holds the sample, and the index of its medium."""

    held: Held
    eta: float

    @property
    def top(self) -> Top:
        return Top(_SOURCE_MFP, milne(self.eta))

    @property
    def thickness(self) -> float:
        """A dish's depth up to that from which no light returns."""
        return min(self.held.thickness, DEEP * self.held.radius)

    def modes(self, nearest: float) -> int | None:
        """How many modes tell the light from this radius on; None where the sample is too deep for its depth to."""
        n = _FAINT / np.pi * self.thickness / nearest + 1
        return None if n > _MOST_MODES else int(np.ceil(n))

    def total_ratio(self, mfp: float, q: Array) -> Array:
        """R over a half space's at each q."""
        held = self.held
        column = [np.full((q.size, 1), each) for each in (self.thickness, held.back, held.radius, held.wall)]
        log_sigma = np.full((q.size, 1), -np.log(mfp))
        found = total_ratio(NUMPY, held.kind == "dish", Sample(*column), self.top, log_sigma, q[:, None])
        return np.asarray(found[0][:, 0])

    def ratio(self, r: Array, mfp: float, q: float, n_modes: int) -> Array:
        """R(r) over a half space's, beyond the radius that `n_modes` is for, 0 outside of a wall; q = σtr mfp.

        By the modes of `transport.finite`, whose sum Σ c (K0(κx) − b I0(κx))/2π, x = r/mfp, keeps its digits far out.
        """
        from scipy.special import i0e, i1e, k0e, k1e

        held = self.held
        tau = np.full((1, 1), self.thickness / mfp)
        modes = slab_modes(NUMPY, self.top, loss_of(held.back), tau, np.arange(1, n_modes + 1))
        kappa = np.hypot(modes.p[0], q)
        x = np.minimum(r, held.radius) / mfp
        y = x[:, None] * kappa
        light = k0e(y) * np.exp(-y)
        if held.kind == "dish":
            y_wall, eta = kappa * held.radius / mfp, loss_of(held.wall) / kappa
            b = (eta * k0e(y_wall) - k1e(y_wall)) / (eta * i0e(y_wall) + i1e(y_wall))
            light = light - b * i0e(y) * np.exp(y - 2 * y_wall)
        half = level_of_half_space(NUMPY, self.top, np.full((1, 1), q), x[None])[0]
        return np.asarray(
            np.where(r <= held.radius, light @ modes.share[0] / (2 * np.pi) / np.maximum(half, _DARK), 0.0)
        )
