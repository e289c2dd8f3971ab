"""A slice as a model has it: per entering flux over the hemisphere, less what spot and camera angle do."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.layout import Curves, Sight, curves_of, sight_of
from bssrdf.fit.models import table_key
from bssrdf.fit.observe import averaged, nodes, seen_at
from bssrdf.holding import held, samples_of
from bssrdf.session.records import Slice
from bssrdf.transport import has_light_table, light_table, shipped_table, tabulated
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.finite import log_ratio, top_of
from bssrdf.transport.light import NEAREST_MFP, Light, dipole, shape_of

Floats = NDArray[np.float64]


class Bare(NamedTuple):
    """Values of a narrow beam over all directions, by radius or annulus, (n,) each."""

    r_lo_mm: Floats
    r_hi_mm: Floats
    rd_per_mm2: Floats
    sd_per_mm2: Floats
    """NaN where no error is known."""
    model_per_mm2: Floats
    """What the model makes of the same radii."""
    dipole_per_mm2: Floats
    """What the dipole makes of them."""

    @property
    def r_mm(self) -> Floats:
        """Middle of each annulus."""
        return (self.r_lo_mm + self.r_hi_mm) / 2


def bare_curve(piece: Slice, channel: str, sigma_a: float, sigma_sp: float, model: Light | None = None) -> Bare:
    """The channel's data, spot and angle taken off by what these coefficients [1/mm] make of them in `model`.

    None is the table where one of the finest set ships, else the dipole.
    """
    curves = curves_of([piece], [channel], None)
    model = _usual_model(piece) if model is None else model
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(sigma_a, sigma_sp))
    sight = sight_of(piece, curves, blurred=bool(curves.spot_radius.any()))
    seen = seen_at(NUMPY, sight, model, curves, log_sigma, np.minimum(q, model.q_max))
    ratio = np.exp(seen.log_ratio[0])[:, None]
    there = curves.known[0] != 0

    def by_datum(by_ring: Floats) -> Floats:
        return np.broadcast_to(by_ring[:, None], there.shape)[there]

    lo, hi, of_model, of_dipole = map(
        by_datum,
        (
            curves.r_lo[0],
            curves.r_hi[0],
            _over_rings(piece, model, sight, curves, log_sigma, q),
            _over_rings(piece, dipole(piece.eta), sight, curves, log_sigma, q),
        ),
    )
    sd = 1 / curves.known[0][there] if curves.errors_known[0, 0] else np.full(int(there.sum()), np.nan)
    return Bare(
        lo, hi, (curves.rd[0] / ratio)[there], sd / np.broadcast_to(ratio, there.shape)[there], of_model, of_dipole
    )


def model_of(piece: Slice, name: str) -> Light:
    """The model that a fit names, by tables at hand; the dipole where no table is."""
    with_table = name == "mc" and has_light_table(*table_key(piece), "cached")
    return light_table(*table_key(piece), "cached") if with_table else dipole(piece.eta)


def _usual_model(piece: Slice) -> Light:
    return shipped_table(piece.eta, table_key(piece).g) if tabulated(piece.eta, piece.g) else dipole(piece.eta)


def sample_ratio(piece: Slice, sigma_a: float, sigma_sp: float, r_mm: Floats) -> Floats:
    """What back and walls of the slice's sample make of a half space's curve at these radii, (n,); 1 without them."""
    model = _usual_model(piece)
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(sigma_a, sigma_sp))
    return _in_sample(piece, model, log_sigma, q, r_mm)


def _in_sample(piece: Slice, model: Light, log_sigma: Floats, q: Floats, r_mm: Floats) -> Floats:
    kind = held(piece).kind
    if kind == "half":
        return np.ones_like(r_mm)
    looked = log_ratio(NUMPY, kind == "dish", samples_of([piece]), top_of(model), log_sigma, q, r_mm[None])
    ratio: Floats = np.exp(looked[0][0])
    return ratio


def _over_rings(piece: Slice, model: Light, sight: Sight, curves: Curves, log_sigma: Floats, q: Floats) -> Floats:
    """Means [1/mm²] of the model's narrow beam over the rings of the only row, (u,)."""
    at, sigma = nodes(NUMPY, sight, curves), np.exp(log_sigma)
    x = np.maximum(sigma * at.r, NEAREST_MFP)
    look = averaged(NUMPY, sight, at, model.look(NUMPY, np.minimum(q, model.q_max), x))
    middle = np.sqrt((curves.r_lo[0] ** 2 + curves.r_hi[0] ** 2) / 2)
    rings: Floats = np.asarray(sigma**2 * look[0])[0]
    return rings * _in_sample(piece, model, log_sigma, q, middle)
