"""The models that may fit a slice, those a little aside of one, and the rule behind `--model auto`."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Literal, NamedTuple

from bssrdf.fit.problem import Neighbours
from bssrdf.session.records import Slice
from bssrdf.transport import (
    NORMAL,
    Incidence,
    Making,
    Policy,
    has_light_table,
    light_table,
    nearest,
    place,
    shipped_table,
    tabulated,
)
from bssrdf.transport.light import Dipole, Light, WhiteTable, dipole

ModelName = Literal["auto", "dipole", "mc"]
ASSUMED_G = 0.0
"""Taken where a slice does not say g; the fit is flagged, since R depends on g at equal σs′."""
G_STEP = 0.05
ETA_STEP = 0.01
_NONE: Neighbours = {}
OBLIQUE_DEG = 10.0
"""Of the beam to the normal: from here on light enters aside of where a normal beam's does."""
DIPOLE_SHARE = 0.3
"""Of the statistical sd: a dipole whose model error is below adds at most 4 % to an interval's true width."""
DIPOLE_BEST = 0.005
"""Relative sd of both coefficients below which nobody need ask: no dipole is right to 0.3 of that."""

RULE = (
    "auto takes the dipole where its model error is below 0.3 of the statistical error in both coefficients, and the "
    "Monte Carlo table elsewhere. The dipole's model error is found by fitting it, with the same radii and weights, to "
    "the table's light of the same medium. A table that does not ship is taken from the cache or made (--tables)."
)


class Truth(NamedTuple):
    """A table that says how wrong the dipole is, with the dipole of the same index."""

    dipole: Dipole
    table: WhiteTable
    own: bool
    """Whether it is that of the medium, and not of the nearest."""


class TableKey(NamedTuple):
    """What a table is made for: a medium and how the beam falls in."""

    eta: float
    g: float
    beam: Incidence


def table_key(piece: Slice) -> TableKey:
    """A slice's: a beam near the normal falls in along it; else a slice across the view is one across its plane too."""
    beam = NORMAL
    if piece.incidence_deg >= OBLIQUE_DEG:
        beam = Incidence(piece.incidence_deg, across=piece.exit == "fresnel" and piece.azimuth == "perpendicular")
    return TableKey(piece.eta, ASSUMED_G if piece.g is None else piece.g, beam)


def named(name: Literal["dipole", "mc"], piece: Slice, policy: Policy, making: Making) -> Light:
    """The model of that name for the slice's medium and beam; InputError where the policy forbids its table."""
    return dipole(piece.eta) if name == "dipole" else light_table(*table_key(piece), policy, making)


def is_clamped(g: float | None) -> bool:
    """Whether g lies beyond the tables and their nearest is taken."""
    return g is not None and place(1.4, g).g_clamped


def truth_of(piece: Slice, policy: Policy, making: Making) -> Truth | None:
    """The medium's own table where it is at hand, else the nearest; None where that lies too far off.

    None is made: whoever wants the dipole alone need not wait for a table.
    """
    medium = table_key(piece)
    at_hand: Policy = "cached" if policy == "make" else policy
    if has_light_table(*medium, at_hand):
        return Truth(dipole(piece.eta), light_table(*medium, at_hand, making), own=True)
    other = nearest(piece.eta, medium.g, policy=at_hand)
    return Truth(dipole(other.eta), shipped_table(other.eta, other.g), own=False) if other.near else None


def beside_of(model: Light, piece: Slice) -> Neighbours:
    """A model's neighbours for a slice; none beside an oblique beam."""
    medium = table_key(piece)
    return _beside(model.biased, medium.eta, medium.g) if medium.beam == NORMAL else _NONE


@lru_cache(maxsize=64)
def _beside(of_dipole: bool, eta: float, g: float) -> Neighbours:
    """Those of a medium; for the table what ships."""
    if of_dipole:
        return {"eta": (partial(dipole, eta + ETA_STEP), ETA_STEP)}
    found: Neighbours = {}
    for key, step, by_eta in (("eta", ETA_STEP, 1), ("g", G_STEP, 0)):
        for signed in (step, -step):
            at = eta + signed * by_eta, g + signed * (1 - by_eta)
            if key not in found and tabulated(*at):
                found[key] = partial(shipped_table, *at), signed
    return found
