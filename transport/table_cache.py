"""Where a model's table comes from: those that ship with the package, else one made once and kept in a cache."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import platformdirs

from bssrdf.errors import InputError
from bssrdf.transport.parallel import Progress
from bssrdf.transport.table_model import TableModel
from bssrdf.transport.table_set import TableSet, read_tables, table_set, write_tables

ETA_RANGE = (1.0, 3.0)
G_RANGE = (-0.9, 0.95)
CORE_SECONDS = 300.0
"""Processor time spent on a table made on demand: errors of the curve near 0.5 %."""
SEED = 1


@functools.cache
def shipped() -> TableSet:
    """The tables that come with the package."""
    with as_file(files("bssrdf.transport") / "tables" / "white.npz") as path:
        return read_tables(path)


def cache_directory() -> Path:
    """Folder of the tables made on this computer."""
    return platformdirs.user_cache_path("bssrdf") / "tables"


def seconds_to_make(core_seconds: float = CORE_SECONDS) -> float:
    """How long `table_model` takes about when it has to make a table [s]."""
    return core_seconds / (os.cpu_count() or 1) + 15


def table_model(
    eta: float,
    g: float,
    *,
    announce: Callable[[float], None] | None = None,
    progress: Progress | None = None,
    directory: Path | None = None,
    core_seconds: float = CORE_SECONDS,
) -> TableModel:
    """The Monte Carlo model of (eta, g): interpolated from the shipped tables where they cover it, else its own.

    Its own is read from `directory` (default: `cache_directory()`), or made and kept there; `announce` is told before
    about how many seconds that takes, and `progress` how far it is. Raises InputError out of range, and for a file in
    the cache that is not a table.
    """
    _require("eta", eta, ETA_RANGE)
    _require("g", g, G_RANGE)
    return (
        _interpolated(eta, g) if shipped().covers(eta, g) else _own(eta, g, announce, progress, directory, core_seconds)
    )


@functools.lru_cache(maxsize=32)
def _interpolated(eta: float, g: float) -> TableModel:
    return shipped().model(eta, g)


def _own(
    eta: float,
    g: float,
    announce: Callable[[float], None] | None,
    progress: Progress | None,
    directory: Path | None,
    core_seconds: float,
) -> TableModel:
    folder = directory or cache_directory()
    path = folder / f"white-eta{eta!r}-g{g!r}.npz"
    if not path.exists():
        if announce is not None:
            announce(seconds_to_make(core_seconds))
        from bssrdf.transport.table_fit import fit_tables
        from bssrdf.transport.white_samples import sample

        samples = sample(g, np.array([eta]), core_seconds, seed=SEED, progress=progress)
        folder.mkdir(parents=True, exist_ok=True)
        write_tables(path, table_set({(g, eta): fit_tables(samples)[0]}))
    tables = read_tables(path)
    if not tables.covers(eta, g):
        raise InputError(f"{path}: holds the table of another medium; delete it and it is made again")
    return tables.model(eta, g)


def _require(name: str, value: float, bounds: tuple[float, float]) -> None:
    if not bounds[0] <= value <= bounds[1]:
        raise InputError(f"{name} = {value}: Monte Carlo tables exist for {name} from {bounds[0]:g} to {bounds[1]:g}")
