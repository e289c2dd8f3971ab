"""The Monte Carlo table of a medium as a model of light: of those that ship, from the cache, or made now."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from bssrdf.errors import InputError
from bssrdf.transport.incidence import NORMAL, Incidence
from bssrdf.transport.light import Light, WhiteTable, dipole, table_of
from bssrdf.transport.parallel import Progress
from bssrdf.transport.white.store import Policy, allowed, place, shipped, table_model

COARSE_ERROR = 0.006
"""Of the tables that ship for unusual media: interpolated between few, they lie 0.2 to 0.7 % off fine ones at 1 to 5
mean free paths and 1 to 2 % at 18."""
COARSE_EXIT = 0.03
"""Likewise of their light across the view, which lies 1 to 4 % off at g 0.8."""


class Making(NamedTuple):
    """What to tell while a table is made: about how long it takes [s], and how far it is."""

    announce: Callable[[float], None] | None = None
    progress: Progress | None = None


SILENT: Making = Making()


def light_table(eta: float, g: float, beam: Incidence, policy: Policy, making: Making = SILENT) -> WhiteTable:
    """The table of a medium and beam, g drawn into range; InputError where the policy forbids it."""
    found = place(eta, g, beam=beam)
    if not allowed(found, policy):
        raise InputError(
            f"eta = {eta:g}, g = {found.g:g}: no Monte Carlo table is at hand; --tables make makes one in about "
            f"{found.seconds:.0f} s, or take --model dipole"
        )
    return _table(found.eta, found.g, making, beam)


def has_light_table(eta: float, g: float, beam: Incidence, policy: Policy) -> bool:
    """Whether the policy gives this medium and beam a table."""
    try:
        return allowed(place(eta, g, beam=beam), policy)
    except InputError:
        return False


def tabulated(eta: float, g: float | None) -> bool:
    """Whether a table of the finest set that ships covers the medium, g 0 where it is not known."""
    return shipped().covers(eta, g or 0.0)


def shipped_table(eta: float, g: float) -> WhiteTable:
    """The table of a medium that `tabulated` knows."""
    return _table(eta, g, SILENT, NORMAL)


def usual_light(eta: float, g: float | None) -> Light:
    """The table of the finest set where it ships, else the dipole."""
    return shipped_table(eta, g or 0.0) if tabulated(eta, g) else dipole(eta)


@lru_cache(maxsize=64)
def _table(eta: float, g: float, making: Making, beam: Incidence) -> WhiteTable:
    made = table_model(eta, g, beam=beam, announce=making.announce, progress=making.progress)
    table = table_of(made)._replace(sin_beam=beam.sine / eta)
    coarse = place(eta, g, beam=beam).origin == "shipped" and not tabulated(eta, g)
    return table._replace(relative_error=COARSE_ERROR, exit_error=COARSE_EXIT) if coarse else table
