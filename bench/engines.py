"""The batched search of `fit` by NumPy, and by JAX on its default device in float64 and float32."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from platform import machine
from typing import Literal

import numpy as np

from bssrdf.bench.bulk import noisy_slices
from bssrdf.fit import shipped_table
from bssrdf.fit.batch import Fitted, fit_group
from bssrdf.fit.compiled import settled
from bssrdf.fit.jobs import Job, Options
from bssrdf.fit.solve import Solution, settle, start
from bssrdf.session.records import Slice
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.light import coefficients

Engine = Literal["NumPy", "float64", "float32"]
SINGLE_ERROR = 1e-4
"""Relative, of σa and σs′ in float32 where it finds them: 3e-5 is the most of 309 curves, 0.004 of a standard error.
Curves of albedo 0.02 it does not find."""
_SOFT = Options("soft", scale_free=False, robust=False, window_mm=None, tables="shipped")


@dataclass(frozen=True)
class EngineScore:
    """One engine on one device."""

    engine: str
    device: str
    curves: int
    seconds: float
    """On the clock, of a second run: JAX's first compiles."""
    largest_error: float
    """Relative, of σa and σs′ against NumPy's, where both find them."""
    not_found: int


def engine_scores(curves: int) -> list[EngineScore]:
    """The search for so many curves by NumPy, and by JAX in float64 and float32."""
    return [engine_score(curves, engine) for engine in ("NumPy", "float64", "float32")]


def engine_score(curves: int, engine: Engine, platform: str | None = None) -> EngineScore:
    """That of one engine, in a process of its own: JAX does not change its precision once it has compiled.

    `platform` is JAX's name of a kind of device, its default if None; RuntimeError where there is none of them.
    """
    pieces = [*noisy_slices(-(-curves // 3))]
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as fresh:
        return fresh.submit(_scored, pieces, curves, engine, platform).result()


def _scored(pieces: list[Slice], curves: int, engine: Engine, platform: str | None) -> EngineScore:
    jobs = [Job((piece,), channel) for piece in pieces for channel in piece.channels]
    ours = fit_group(jobs[:curves], _SOFT, shipped_table(pieces[0].eta, 0.0))
    name, run = _by_numpy(ours) if engine == "NumPy" else _by_jax(ours, engine == "float32", platform)
    run()
    began = time.perf_counter()
    found = run()
    seconds = time.perf_counter() - began
    both = found.converged & ours.found.converged
    title = "NumPy, float64" if engine == "NumPy" else f"JAX, {engine}"
    return EngineScore(
        title, name, curves, seconds, float(_off(found, ours)[both].max()), int((~found.converged).sum())
    )


def _by_numpy(ours: Fitted) -> tuple[str, Callable[[], Solution]]:
    def run() -> Solution:
        begun, _ = start(NUMPY, ours.plan, ours.model, ours.data, 0)
        return settle(NUMPY, ours.plan, ours.model, ours.data, begun, ours.beside)

    return f"{machine()} CPU", run


def _by_jax(ours: Fitted, single: bool, platform: str | None) -> tuple[str, Callable[[], Solution]]:
    import jax

    device = jax.devices(platform)[0]

    def run() -> Solution:
        with jax.default_device(device):
            return settled(ours.plan, ours.model, ours.data, ours.beside, len(ours.jobs), single=single)

    return f"{machine()} CPU" if device.platform == "cpu" else str(device.device_kind), run


def _off(theirs: Solution, ours: Fitted) -> np.ndarray:
    """(b,): the larger relative distance of σa and σs′ from NumPy's."""
    a, b = (
        np.hstack(coefficients(np.asarray(point.log_sigma, float), np.asarray(point.q, float)))
        for point in (theirs.point, ours.found.point)
    )
    return np.abs(a / b - 1).max(axis=1)
