"""Fit g as well: the near-source data tell one phase function's mean cosine from another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bssrdf.errors import InputError
from bssrdf.fit.choose import Announce, tabulated
from bssrdf.fit.model_error import chi2_by_g
from bssrdf.fit.run import FitOptions, fit_batches
from bssrdf.session.records import Slice
from bssrdf.transport.precision import scoped_x64

GRID = (0.0, 0.35, 0.6, 0.75, 0.8, 0.9)


class FreeG(NamedTuple):
    """The mean cosine that the channels of a slice agree on best."""

    g: float
    sd: float
    """From the curvature of χ²; inf where the best g lies at an end of the grid."""


@scoped_x64
def fit_g(piece: Slice, options: FitOptions, *, announce: Announce | None = None) -> FreeG:
    """The g whose table fits all channels of the slice best; InputError where no table ships for its η."""
    if not tabulated(piece.eta, GRID[0]):
        raise InputError(f"eta = {piece.eta:g}: no Monte Carlo tables ship for it, so g cannot be fitted; give --g")
    begin = replace(piece, g=GRID[2])
    fitted = fit_batches([begin], replace(options, model="mc"), announce)
    chi2 = sum((chi2_by_g(each, GRID).sum(axis=1) for each in fitted), np.zeros(len(GRID)))
    return _lowest(GRID, chi2)


def _lowest(gs: Sequence[float], chi2: np.ndarray) -> FreeG:
    """Minimum of the parabola through the lowest point and its neighbours."""
    at = int(np.argmin(chi2))
    if at in (0, len(gs) - 1):
        return FreeG(gs[at], float("inf"))
    curvature, slope, _ = np.polyfit(np.asarray(gs[at - 1 : at + 2]) - gs[at], chi2[at - 1 : at + 2], 2)
    g = float(np.clip(gs[at] - slope / (2 * curvature), gs[0], gs[-1]))
    return FreeG(g, float(1 / np.sqrt(curvature)))
