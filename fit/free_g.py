"""Fit g as well: the near-source data tell one phase function's mean cosine from another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bssrdf.errors import InputError
from bssrdf.fit.batch import fit_group
from bssrdf.fit.jobs import FitOptions, Job, groups_of
from bssrdf.fit.models import named
from bssrdf.session.records import Slice
from bssrdf.transport import SILENT, Making, tabulated

GRID = (0.0, 0.35, 0.6, 0.75, 0.8, 0.9)


class FreeG(NamedTuple):
    """The mean cosine that the channels of a slice agree on best."""

    g: float
    sd: float
    """From the curvature of χ²; inf where the best g lies at an end of the grid."""


@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def fit_g(piece: Slice, options: FitOptions, *, making: Making = SILENT) -> FreeG:
    """The g whose table fits all channels of the slice best; InputError where no table ships for its η."""
    if not tabulated(piece.eta, GRID[0]):
        raise InputError(f"eta = {piece.eta:g}: no Monte Carlo tables ship for it, so g cannot be fitted; give --g")
    jobs = [Job((piece,), channel) for channel in piece.channels]
    chi2 = np.zeros(len(GRID))
    for places, _ in groups_of(jobs, options):
        begin = None  # each g begins where the last one ended
        for at, g in enumerate(GRID):
            members = [Job((replace(piece, g=g),), jobs[place].channel) for place in places]
            model = named("mc", members[0].pieces[0], options.tables, making)
            found = fit_group(members, options, model, begin=begin).found
            chi2[at] += float(found.cost.sum())
            begin = found.point
    return _lowest(GRID, chi2)


def _lowest(gs: Sequence[float], chi2: np.ndarray) -> FreeG:
    """Minimum of the parabola through the lowest point and its neighbours."""
    at = int(np.argmin(chi2))
    if at in (0, len(gs) - 1):
        return FreeG(gs[at], float("inf"))
    curvature, slope, _ = np.polyfit(np.asarray(gs[at - 1 : at + 2]) - gs[at], chi2[at - 1 : at + 2], 2)
    g = float(np.clip(gs[at] - slope / (2 * curvature), gs[0], gs[-1]))
    return FreeG(g, float(1 / np.sqrt(curvature)))
