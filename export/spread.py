"""How far light spreads: shares of the light by radius, the edge of a shadow, R_d(r). Lengths in mm, 1/mm.

Per unit flux that entered along the normal, over the hemisphere of exits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.export.bounce_walk import N_ORDERS, orders, rho_edges
from bssrdf.transport import half_space, place, table_model
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.light import shape_of, table_of

Floats = NDArray[np.float64]

FINE = np.geomspace(1e-4, 1e4, 4001)
"""Edges of annuli in 1/σt′: 0.5 % apart, so that light in one may be taken at its middle."""
PLACES = (np.arange(8) + 0.5) / 8
"""Radii that stand for a bin of the walk's table: it is 10 % wide."""
ALL_ORDERS_BELOW = 0.96
"""Albedo below which the table's orders are all the light: 0.96^256 is 3e-5."""


class WalkMedium(NamedTuple):
    """A measured half space in one channel."""

    sigma_a: float
    sigma_sp: float
    eta: float
    g: float = 0.0

    @property
    def sigma_tp(self) -> float:
        """σt′."""
        return self.sigma_a + self.sigma_sp

    @property
    def sigma_s(self) -> float:
        """σs = σs′/(1 − g)."""
        return self.sigma_sp / (1 - self.g)

    @property
    def sigma_tr(self) -> float:
        """σtr = √(3 σa σt′)."""
        return math.sqrt(3 * self.sigma_a * self.sigma_tp)

    @property
    def total(self) -> float:
        """Total diffuse reflectance, exact."""
        albedo = self.sigma_s / (self.sigma_s + self.sigma_a)
        return half_space(albedo, self.g, self.eta, np.array([1.0])).total


class Spread(NamedTuple):
    """Light by radius: point masses on annuli."""

    r_mm: Floats
    """(n,) ascending."""
    share: Floats
    """(n,) of the light that entered."""

    @property
    def total(self) -> float:
        """All that comes out."""
        return float(self.share.sum())

    def beyond(self, x_mm: Floats) -> Floats:
        """Light at each depth x (n,) into the shadow of a straight edge, over that which fell on the lit half plane.

        A point at distance r lies beyond the edge for the share arccos(x/r)/π of all azimuths.
        """
        over = x_mm[:, None] / np.maximum(self.r_mm, x_mm[:, None])
        return np.asarray((np.arccos(over) / np.pi) @ self.share)

    def edge(self, x_mm: Floats) -> Floats:
        """Brightness across the edge, lit where x < 0: the total far inside the light, 0 far inside the shadow."""
        beyond = self.beyond(np.abs(x_mm))
        return np.where(x_mm < 0, self.total - beyond, beyond)

    def rd(self, r_mm: Floats) -> Floats:
        """R_d [1/mm²], the mean over the annuli from r/1.15 to 1.15 r: wider than a bin of any source."""
        inside = np.append(0.0, np.cumsum(self.share))
        middle = np.append(self.r_mm[0] / 2, self.r_mm)
        low, high = r_mm / 1.15, r_mm * 1.15
        return np.asarray(
            (np.interp(high, middle, inside) - np.interp(low, middle, inside)) / (np.pi * (high**2 - low**2))
        )


def added(parts: list[Spread]) -> Spread:
    """The light of several lobes together."""
    r = np.concatenate([part.r_mm for part in parts])
    order = np.argsort(r, kind="stable")
    return Spread(r[order], np.concatenate([part.share for part in parts])[order])


def measured_spread(medium: WalkMedium) -> Spread:
    """Light of the measured medium by the Monte Carlo tables; a g below 0 as 0 at the same σs′."""
    _, q = shape_of(medium.sigma_a, medium.sigma_sp)
    table = table_of(table_model(medium.eta, place(medium.eta, max(medium.g, 0.0)).g))
    r = np.sqrt(FINE[1:] * FINE[:-1])
    rd = table.look(NUMPY, np.array([[q]]), r[None])[0][0]
    share = rd * np.pi * np.diff(FINE**2)
    return Spread(r / medium.sigma_tp, share * (medium.total / share.sum()))


def walk_spread(albedo: float, mfp_mm: float, bounces: int | None) -> Spread:
    """Light of an index-matched isotropic walk that is given up after so many bounces (at most 256), or never."""
    if bounces is None and albedo > ALL_ORDERS_BELOW:
        return measured_spread(WalkMedium((1 - albedo) / mfp_mm, albedo / mfp_mm, 1.0))
    n = np.arange(1, N_ORDERS + 1)
    by_bin = np.where(n <= (bounces or N_ORDERS), albedo**n, 0.0) @ orders()
    edges = rho_edges()
    r = edges[:-1, None] + PLACES * np.diff(edges)[:, None]
    inside = 2 * r * np.diff(edges)[:, None] / np.diff(edges**2)[:, None] / PLACES.size  # by area
    by_place = by_bin[:, None] * inside
    return Spread(mfp_mm * r.ravel(), by_place.ravel())
