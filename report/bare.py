"""A slice as a model has it: per entering flux over the hemisphere, less what spot and camera angle do."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit import Curves, curves_of, sight_of, table_key
from bssrdf.holding import sample_ratio
from bssrdf.session.records import Slice
from bssrdf.transport import has_light_table, light_table, usual_light
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.light import NEAREST_MFP, Light, dipole, shape_of
from bssrdf.transport.observed import Sight, averaged, nodes, seen_at

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
    model = usual_light(piece.eta, piece.g) if model is None else model
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(sigma_a, sigma_sp))
    sight = sight_of(piece, curves, blurred=bool(curves.spot_radius.any()))
    seen = seen_at(NUMPY, sight, model, curves, log_sigma, np.minimum(q, model.q_max))
    ratio = np.exp(seen.log_ratio[0])[:, None]
    there = curves.known[0] != 0

    def by_datum(by_ring: Floats) -> Floats:
        return np.broadcast_to(by_ring[:, None], there.shape)[there]

    def of(light: Light) -> Floats:
        looked = _over_rings(light, sight, curves, log_sigma, q)
        middle = np.sqrt((curves.r_lo[0] ** 2 + curves.r_hi[0] ** 2) / 2)
        return by_datum(looked * sample_ratio(piece, light, sigma_a, sigma_sp, middle))

    sd = 1 / curves.known[0] if curves.errors_known[0, 0] else np.full(there.shape, np.nan)
    return Bare(
        by_datum(curves.r_lo[0]),
        by_datum(curves.r_hi[0]),
        (curves.rd[0] / ratio)[there],
        (sd / ratio)[there],
        of(model),
        of(dipole(piece.eta)),
    )


def model_of(piece: Slice, name: str) -> Light:
    """The model that a fit names, by tables at hand; the dipole where no table is."""
    with_table = name == "mc" and has_light_table(*table_key(piece), "cached")
    return light_table(*table_key(piece), "cached") if with_table else dipole(piece.eta)


def _over_rings(model: Light, sight: Sight, curves: Curves, log_sigma: Floats, q: Floats) -> Floats:
    """Means [1/mm²] of the model's narrow beam over the rings of the only row, (u,)."""
    at, sigma = nodes(NUMPY, sight, curves), np.exp(log_sigma)
    look = model.look(NUMPY, np.minimum(q, model.q_max), np.maximum(sigma * at.r, NEAREST_MFP))
    rings: Floats = (sigma**2 * averaged(NUMPY, sight, at, look)[0])[0]
    return rings
