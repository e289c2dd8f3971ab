"""Where a model's table comes from: those that ship with the package, else one made once and kept in a cache."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import platformdirs

from bssrdf.errors import InputError
from bssrdf.transport.incidence import NORMAL, Incidence
from bssrdf.transport.parallel import Progress
from bssrdf.transport.white.archive import TableSet, read_tables, table_set, write_tables
from bssrdf.transport.white.model import TableModel

ETA_RANGE = (1.0, 3.0)
G_RANGE = (-0.9, 0.95)
CORE_SECONDS = 300.0
"""Processor time spent on a table made on demand: errors of the curve near 0.5 %."""
SEED = 1
Origin = Literal["shipped", "cached", "made"]
Policy = Literal["make", "cached", "shipped"]
"""Tables that may be used: all, those at hand, or those that come with the package."""
COARSE_FACTOR = 3.0
"""Of the coarse tables' own noise: they lie 0.2 to 0.7 % off fine ones at 1 to 5 mean free paths and 1 to 2 % at 18."""
ETA_APART = 0.2
G_APART = 0.3
"""How far a table may be from a medium and still say how wrong the dipole is there."""
_NAME = re.compile(r"white-eta(?P<eta>[\d.]+)-g(?P<g>-?[\d.]+)\.npz")


class Place(NamedTuple):
    """Where the table of a medium comes from."""

    origin: Origin
    eta: float
    g: float
    """Of the table: the nearest in G_RANGE."""
    seconds: float
    """That it takes about to make it; 0 where it is there."""
    g_clamped: bool


class Nearest(NamedTuple):
    """The medium nearest to another for which a table is at hand."""

    eta: float
    g: float
    near: bool
    """Whether what it says of a model's error can stand for the other medium."""


@functools.cache
def shipped() -> TableSet:
    """The tables of usual media that come with the package."""
    return _packaged("white.npz")


@functools.cache
def shipped_wide() -> TableSet:
    """The coarse ones that do, for indices from 1 to 3."""
    return _packaged("wide.npz")


SHIPPED = (shipped, shipped_wide)
"""From fine to coarse; each is read when it is first needed."""


def cache_directory() -> Path:
    """Folder of the tables made on this computer."""
    return platformdirs.user_cache_path("bssrdf") / "tables"


def seconds_to_make(core_seconds: float = CORE_SECONDS) -> float:
    """How long `table_model` takes about when it has to make a table [s]."""
    return core_seconds / (os.cpu_count() or 1) + 15


def place(
    eta: float,
    g: float,
    *,
    beam: Incidence = NORMAL,
    directory: Path | None = None,
    core_seconds: float = CORE_SECONDS,
) -> Place:
    """Where the table of (eta, g) would come from, g drawn into G_RANGE; raises InputError for eta out of range."""
    _require("eta", eta, ETA_RANGE)
    within = min(max(g, G_RANGE[0]), G_RANGE[1])
    if _ships(eta, within, beam):
        origin: Origin = "shipped"
    else:
        origin = "cached" if _path(eta, within, beam, directory).exists() else "made"
    seconds = seconds_to_make(core_seconds) if origin == "made" else 0.0
    return Place(origin, eta, within, seconds, within != g)


def allowed(found: Place, policy: Policy) -> bool:
    """Whether the policy lets this table be used."""
    return {"shipped": 0, "cached": 1, "made": 2}[found.origin] <= {"shipped": 0, "cached": 1, "make": 2}[policy]


def nearest(eta: float, g: float, *, policy: Policy = "cached", directory: Path | None = None) -> Nearest:
    """The medium nearest to (eta, g), in steps of ETA_APART and G_APART, whose table ships or, by policy, was made."""
    at_hand = [
        (float(np.clip(eta, *t.etas[[0, -1]])), float(np.clip(g, *t.gs[[0, -1]]))) for t in (load() for load in SHIPPED)
    ]
    if policy != "shipped":
        at_hand += _made(directory or cache_directory())
    apart, best = min((max(abs(e - eta) / ETA_APART, abs(h - g) / G_APART), (e, h)) for e, h in at_hand)
    return Nearest(*best, near=apart <= 1 + 1e-9)


def table_model(
    eta: float,
    g: float,
    *,
    beam: Incidence = NORMAL,
    announce: Callable[[float], None] | None = None,
    progress: Progress | None = None,
    directory: Path | None = None,
    core_seconds: float = CORE_SECONDS,
) -> TableModel:
    """The Monte Carlo model of (eta, g): interpolated from the shipped tables where they cover it, else its own.

    Its own is read from `directory` (default: `cache_directory()`), or made and kept there; `announce` is told before
    about how many seconds that takes, and `progress` how far it is. An oblique `beam` has a table of its own. Raises
    InputError out of range, and for a file in the cache that is not a table.
    """
    _require("eta", eta, ETA_RANGE)
    _require("g", g, G_RANGE)
    if _ships(eta, g, beam):
        return _interpolated(eta, g)
    return _own(eta, g, beam, announce, progress, directory, core_seconds)


@functools.lru_cache(maxsize=32)
def _interpolated(eta: float, g: float) -> TableModel:
    if shipped().covers(eta, g):
        return shipped().model(eta, g)
    return shipped().of(g).widened(shipped_wide().of(g), COARSE_FACTOR).model(eta, g)


def _ships(eta: float, g: float, beam: Incidence) -> bool:
    """Whether a shipped set covers the medium; all are for normal incidence."""
    return beam.angle_deg == 0 and any(load().covers(eta, g) for load in SHIPPED)


def _packaged(name: str) -> TableSet:
    with as_file(files("bssrdf.transport.white") / "tables" / name) as path:
        return read_tables(path)


def _path(eta: float, g: float, beam: Incidence, directory: Path | None) -> Path:
    oblique = f"-at{beam.angle_deg!r}{'across' if beam.across else ''}" if beam.angle_deg else ""
    return (directory or cache_directory()) / f"white-eta{eta!r}-g{g!r}{oblique}.npz"


def _made(folder: Path) -> list[tuple[float, float]]:
    """Media whose own table lies in the folder."""
    names = (_NAME.fullmatch(path.name) for path in folder.glob("white-eta*.npz"))
    return [(float(match["eta"]), float(match["g"])) for match in names if match]


def _own(
    eta: float,
    g: float,
    beam: Incidence,
    announce: Callable[[float], None] | None,
    progress: Progress | None,
    directory: Path | None,
    core_seconds: float,
) -> TableModel:
    path = _path(eta, g, beam, directory)
    if not path.exists():
        if announce is not None:
            announce(seconds_to_make(core_seconds))
        from bssrdf.transport.white.samples import sample
        from bssrdf.transport.white.smooth import fit_tables

        samples = sample(g, np.array([eta]), core_seconds, seed=SEED, beam=beam, progress=progress)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_tables(path, table_set({(g, eta): fit_tables(samples)[0]}), beam)
    tables = read_tables(path, beam)
    if not tables.covers(eta, g):
        raise InputError(f"{path}: holds the table of another medium; delete it and it is made again")
    return tables.model(eta, g, beam)


def _require(name: str, value: float, bounds: tuple[float, float]) -> None:
    if not bounds[0] <= value <= bounds[1]:
        raise InputError(f"{name} = {value}: Monte Carlo tables exist for {name} from {bounds[0]:g} to {bounds[1]:g}")
