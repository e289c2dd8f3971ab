"""The batched search of `fit` by NumPy, and by JAX on its default device in float64 and float32, by size of batch."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from platform import machine
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.bulk import CHANNELS, noisy_slices
from bssrdf.fit import FitOptions, Fitted, Job, Solution, fit_group, searched
from bssrdf.transport import shipped_table
from bssrdf.transport.light import coefficients

Engine = Literal["NumPy", "float64", "float32"]
SINGLE_ERROR = 1e-4
"""Relative, of σa and σs′ in float32 where it finds them: 5.9e-5 is the most of 16,384 curves."""
SINGLE_LOSES = 0.06
"""The share that it does not find, and says so: 684 of those, where one of 24 is of albedo 0.02."""
_SOFT = FitOptions(constraint="soft", tables="shipped")
BATCHES = (256, 2048, 16_384)
"""Curves that go through together: `fit` takes 100 to 650 on a CPU, for its caches; a GPU wants more."""
Search = Callable[[slice], Solution]


@dataclass(frozen=True)
class EngineScore:
    """One engine on one device, by one size of batch."""

    engine: str
    device: str
    batch: int
    curves: int
    seconds: float
    """On the clock, of a second run: JAX's first compiles."""
    largest_error: float
    """Relative, of σa and σs′ against NumPy's, where both find them."""
    not_found: int


def engine_scores(curves: int) -> list[EngineScore]:
    """The search for so many curves by NumPy, and by JAX in float64 and float32, by each size of batch."""
    engines: tuple[Engine, ...] = ("NumPy", "float64", "float32")
    return [score for engine in engines for score in scores_of(curves, engine)]


def scores_of(curves: int, engine: Engine, platform: str | None = None) -> list[EngineScore]:
    """Those of one engine, in a process of its own: JAX does not change its precision once it has compiled.

    `platform` is JAX's name of a kind of device, its default if None; RuntimeError where there is none of them.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as fresh:
        return fresh.submit(_scored, curves, engine, platform).result()


def _scored(curves: int, engine: Engine, platform: str | None) -> list[EngineScore]:
    ours = fitted(curves)
    sizes = sorted({min(batch, curves) for batch in BATCHES})
    return [timed(ours, batch, *search_of(ours, engine, batch, platform)) for batch in sizes]


def fitted(curves: int) -> Fitted:
    """So many of the bench's curves, fitted by NumPy."""
    pieces = [*noisy_slices(-(-curves // len(CHANNELS)))]
    jobs = [Job((piece,), channel) for piece in pieces for channel in piece.channels]
    return fit_group(jobs[:curves], _SOFT, shipped_table(pieces[0].eta, 0.0))


def search_of(ours: Fitted, engine: Engine, batch: int, platform: str | None) -> tuple[str, str, Search]:
    """What the engine is called, its device, and its search for some rows."""
    if engine == "NumPy":
        return "NumPy, float64", f"{machine()} CPU", lambda rows: searched(ours, rows)
    return f"JAX, {engine}", *_by_jax(ours, engine == "float32", batch, platform)


def timed(ours: Fitted, batch: int, engine: str, device: str, search: Search) -> EngineScore:
    """The search for all curves, batch by batch, a second time."""
    _searched(ours, batch, search)
    began = time.perf_counter()
    found = _searched(ours, batch, search)
    seconds = time.perf_counter() - began
    converged = np.concatenate([each.converged for each in found])
    off = np.abs(np.concatenate([*map(_coefficients, found)]) / _coefficients(ours.found) - 1).max(axis=1)
    both = converged & ours.found.converged
    return EngineScore(engine, device, batch, len(ours.jobs), seconds, float(off[both].max()), int((~converged).sum()))


def _searched(ours: Fitted, batch: int, search: Search) -> list[Solution]:
    return [search(slice(at, at + batch)) for at in range(0, len(ours.jobs), batch)]


def _by_jax(ours: Fitted, single: bool, batch: int, platform: str | None) -> tuple[str, Search]:
    import jax

    device = jax.devices(platform)[0]

    def search(rows: slice) -> Solution:
        with jax.default_device(device):
            return searched(ours, rows, compiled_for=batch, single=single)

    return f"{machine()} CPU" if device.platform == "cpu" else str(device.device_kind), search


def _coefficients(found: Solution) -> NDArray[np.float64]:
    """(b, 2): σa and σs′."""
    point = found.point
    return np.hstack(coefficients(np.asarray(point.log_sigma, float), np.asarray(point.q, float)))
