"""Light of a white, index-matched half space by number of scatterings: what renderers' random walks are made of.

Lengths in mean free paths 1/σt. Scattering is isotropic, and light enters along the normal. A walk of albedo α that is
cut off after N bounces gives Σ αⁿ of the first N orders.
"""

from __future__ import annotations

import functools
import math
import threading
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bssrdf.transport import Progress, run_all
from bssrdf.transport.photon import State, free_path, scatter, stream_states

Floats = NDArray[np.float64]

N_ORDERS = 256
"""Bounces for which Cycles follows light under a surface, in every version."""
RHO_ZERO = 0.02
BINS_PER_E = 10
N_RHO = 90
"""Bins uniform in ln(1 + ρ/RHO_ZERO), up to ρ = 162: none of 60 million walks of 256 steps went that far."""
N_PHOTONS = 60_000_000
"""Makes a shadow's edge good to 0.5 % where it is 1e-4 of the lit side."""
N_STREAMS = 64


def rho_edges() -> Floats:
    """Edges of the N_RHO bins, from 0."""
    return np.asarray(RHO_ZERO * np.expm1(np.arange(N_RHO + 1) / BINS_PER_E))


@functools.cache
def orders() -> Floats:
    """Share of the photons that leave after n = 1 … N_ORDERS scatterings in each radial bin, (N_ORDERS, N_RHO)."""
    with as_file(files(__package__) / "bounces.npz") as path, np.load(path) as table:
        return np.asarray(table["counts"] / table["n_photons"])


@njit(nogil=True, cache=True)
def bounce_walk(n_photons: int, state: State, scores: NDArray[np.float64]) -> None:
    """Follow n_photons without absorption; add their exits to `scores` (N_ORDERS, N_RHO), order n in row n − 1."""
    n_orders, n_bins = scores.shape
    for _ in range(n_photons):
        x = y = 0.0
        z = free_path(state)
        for n in range(n_orders):
            ux, uy, uz = scatter(state, 0.0, 0.0, 0.0, 1.0)
            d = free_path(state)
            if z + d * uz < 0.0:
                to_surface = -z / uz
                x += ux * to_surface
                y += uy * to_surface
                bin_of = int(BINS_PER_E * math.log1p(math.sqrt(x * x + y * y) / RHO_ZERO))
                scores[n, min(bin_of, n_bins - 1)] += 1.0
                break
            x += ux * d
            y += uy * d
            z += uz * d


def make_table(
    path: Path,
    n_photons: int = N_PHOTONS,
    *,
    seed: int = 1,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> None:
    """Walk and write the table: how `bounces.npz` was made, in 2 minutes of a core."""
    each = n_photons // N_STREAMS

    def batch(state: State) -> Floats:
        scores = np.zeros((N_ORDERS, N_RHO))
        bounce_walk(each, state, scores)
        return scores

    tasks = [functools.partial(batch, state) for state in stream_states(seed, N_STREAMS)]
    done, _ = run_all(tasks, threading.Event(), n_threads, progress)
    np.savez_compressed(path, counts=np.sum(done, axis=0).astype(np.uint32), n_photons=each * N_STREAMS)
