"""A slice as a model has it: per entering flux over the hemisphere, less what spot and camera angle do."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.layout import curves_of, sight_of
from bssrdf.fit.models import ASSUMED_G, shipped_table, tabulated
from bssrdf.fit.observe import seen_at
from bssrdf.session.records import Slice
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.light import Light, dipole, shape_of

Floats = NDArray[np.float64]


class Bare(NamedTuple):
    """Values of a narrow beam over all directions, by radius or annulus, (n,) each."""

    r_lo_mm: Floats
    r_hi_mm: Floats
    rd_per_mm2: Floats
    sd_per_mm2: Floats
    """NaN where no error is known."""


def bare_curve(piece: Slice, channel: str, sigma_a: float, sigma_sp: float) -> Bare:
    """The channel's data, spot and angle taken off by what these coefficients [1/mm] make of them."""
    curves = curves_of([piece], [channel], None)
    g = ASSUMED_G if piece.g is None else piece.g
    model: Light = shipped_table(piece.eta, g) if tabulated(piece.eta, g) else dipole(piece.eta)
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(sigma_a, sigma_sp))
    sight = sight_of(piece, curves, blurred=bool(curves.spot_radius.any()))
    seen = seen_at(NUMPY, sight, model, curves, log_sigma, np.minimum(q, model.q_max))
    ratio = np.exp(seen.log_ratio[0])[:, None]
    there = curves.known[0] != 0
    lo, hi = (np.broadcast_to(each[0][:, None], there.shape)[there] for each in (curves.r_lo, curves.r_hi))
    sd = 1 / curves.known[0][there] if curves.errors_known[0, 0] else np.full(int(there.sum()), np.nan)
    return Bare(lo, hi, (curves.rd[0] / ratio)[there], sd / np.broadcast_to(ratio, there.shape)[there])
