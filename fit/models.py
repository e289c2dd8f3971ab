"""Forward models by name, (η, g), and those a little aside; the rule behind `--model auto`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache, partial
from typing import Literal, NamedTuple

from bssrdf.errors import InputError
from bssrdf.session.records import Slice
from bssrdf.transport import NORMAL, Incidence, Policy, Progress, allowed, nearest, place, shipped, table_model
from bssrdf.transport.light import Dipole, Light, WhiteTable, dipole, table_of

ModelName = Literal["auto", "dipole", "mc"]
ASSUMED_G = 0.0
"""Taken where a slice does not say g; the fit is flagged, since R depends on g at equal σs′."""
G_STEP = 0.05
ETA_STEP = 0.01
OBLIQUE_DEG = 10.0
"""Of the beam to the normal: from here on light enters aside of where a normal beam's does."""
DIPOLE_SHARE = 0.3
"""Of the statistical sd: a dipole whose model error is below adds at most 4 % to an interval's true width."""

COARSE_ERROR = 0.006
"""Of the tables that ship for unusual media: interpolated between few, they lie 0.2 to 0.7 % off fine ones at 1 to 5
mean free paths and 1 to 2 % at 18."""
COARSE_EXIT = 0.03
"""Likewise of their light across the view, which lies 1 to 4 % off at g 0.8."""
DIPOLE_BEST = 0.005
"""Relative sd of both coefficients below which nobody need ask: no dipole is right to 0.3 of that."""

RULE = (
    "auto takes the dipole where its model error is below 0.3 of the statistical error in both coefficients, and the "
    "Monte Carlo table elsewhere. The dipole's model error is found by fitting it, with the same radii and weights, to "
    "the table's light of the same medium. A table that does not ship is taken from the cache or made (--tables)."
)


class Making(NamedTuple):
    """What to tell while a table is made: about how long it takes [s], and how far it is."""

    announce: Callable[[float], None] | None = None
    progress: Progress | None = None


SILENT: Making = Making()


class Truth(NamedTuple):
    """A table that says how wrong the dipole is, with the dipole of the same index."""

    dipole: Dipole
    table: WhiteTable
    own: bool
    """Whether it is that of the medium, and not of the nearest."""


def beam_of(piece: Slice) -> Incidence:
    """How the beam fell in: near the normal as along it; else a slice across the view is one across its plane too."""
    if piece.incidence_deg < OBLIQUE_DEG:
        return NORMAL
    return Incidence(piece.incidence_deg, across=piece.exit == "fresnel" and piece.azimuth == "perpendicular")


def table_of_medium(piece: Slice, policy: Policy, making: Making) -> WhiteTable:
    """The table of the slice's medium and beam, g drawn into range; raises InputError where the policy forbids it."""
    found = place(piece.eta, ASSUMED_G if piece.g is None else piece.g, beam=beam_of(piece))
    if not allowed(found, policy):
        raise InputError(
            f"eta = {piece.eta:g}, g = {found.g:g}: no Monte Carlo table is at hand; --tables make makes one in about "
            f"{found.seconds:.0f} s, or take --model dipole"
        )
    return _table(found.eta, found.g, making, beam_of(piece))


def named(name: Literal["dipole", "mc"], piece: Slice, policy: Policy, making: Making) -> Light:
    """The model of that name for the slice's medium and beam."""
    return dipole(piece.eta) if name == "dipole" else table_of_medium(piece, policy, making)


def has_table(piece: Slice, policy: Policy) -> bool:
    """Whether the policy gives this medium and beam a table."""
    try:
        return allowed(place(piece.eta, ASSUMED_G if piece.g is None else piece.g, beam=beam_of(piece)), policy)
    except InputError:
        return False


def is_clamped(g: float | None) -> bool:
    """Whether g lies beyond the tables and their nearest is taken."""
    return g is not None and place(1.4, g).g_clamped


def truth_of(piece: Slice, policy: Policy, making: Making) -> Truth | None:
    """The medium's own table where it is at hand, else the nearest; None where that lies too far off.

    None is made: whoever wants the dipole alone need not wait for a table.
    """
    at_hand: Policy = "shipped" if policy == "shipped" else "cached"
    if has_table(piece, at_hand):
        return Truth(dipole(piece.eta), table_of_medium(piece, at_hand, making), own=True)
    other = nearest(piece.eta, ASSUMED_G if piece.g is None else piece.g, policy=at_hand)
    return Truth(dipole(other.eta), _table(other.eta, other.g, Making()), own=False) if other.near else None


@lru_cache(maxsize=64)
def _table(eta: float, g: float, making: Making, beam: Incidence = NORMAL) -> WhiteTable:
    made = table_model(eta, g, beam=beam, announce=making.announce, progress=making.progress)
    table = table_of(made)._replace(sin_beam=beam.sine / eta)
    coarse = place(eta, g, beam=beam).origin == "shipped" and not tabulated(eta, g)
    return table._replace(relative_error=COARSE_ERROR, exit_error=COARSE_EXIT) if coarse else table


class _Neighbours(Mapping[str, tuple[Light, float]]):
    """By `eta` and `g`: a model a little aside, and how far; made when it is first asked for, which few fits do."""

    def __init__(self, made: Mapping[str, Callable[[], Light]], steps: Mapping[str, float]) -> None:
        self._made, self._steps = made, steps

    def __getitem__(self, key: str) -> tuple[Light, float]:
        return self._made[key](), self._steps[key]

    def __contains__(self, key: object) -> bool:
        return key in self._made

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


def beside_of(model: Light, piece: Slice) -> Mapping[str, tuple[Light, float]]:
    """A model's neighbours for a slice; none beside an oblique beam."""
    return _beside(model.biased, piece.eta, piece.g) if beam_of(piece) == NORMAL else {}


@lru_cache(maxsize=64)
def _beside(of_dipole: bool, eta: float, g: float | None) -> Mapping[str, tuple[Light, float]]:
    """Those of a medium; for the table what ships."""
    if of_dipole:
        return _Neighbours({"eta": partial(dipole, eta + ETA_STEP)}, {"eta": ETA_STEP})
    g = ASSUMED_G if g is None else g
    made: dict[str, Callable[[], Light]] = {}
    steps: dict[str, float] = {}
    for key, step in (("eta", ETA_STEP), ("g", G_STEP)):
        for signed in (step, -step):
            at = (eta + signed, g) if key == "eta" else (eta, g + signed)
            if key not in made and tabulated(*at):
                made[key], steps[key] = partial(_table, *at, Making()), signed
    return _Neighbours(made, steps)


def tabulated(eta: float, g: float | None) -> bool:
    """Whether a table of the finest set that ships covers the medium."""
    return shipped().covers(eta, ASSUMED_G if g is None else g)


def shipped_table(eta: float, g: float) -> WhiteTable:
    """The table of a medium that `tabulated` knows."""
    return _table(eta, g, Making())
