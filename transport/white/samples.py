"""Samples of white Monte Carlo for one g and several indices: what a table is made from.

Walks are sampled in groups of neighbouring albedos; q = √(1 − α′) names a medium. Lengths in mean free paths 1/σt.
Needs no JAX, so that large runs need only numpy, scipy and numba.
"""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bssrdf.transport.discrete_ordinates import decay_constant
from bssrdf.transport.exit_radiance import N_MU
from bssrdf.transport.incidence import NORMAL, Incidence
from bssrdf.transport.parallel import Progress, run_all
from bssrdf.transport.photon import stream_states
from bssrdf.transport.white.grid import R_ZERO, V_MAX, albedo_of, q_nodes
from bssrdf.transport.white.walk import COARSE, white_walk

Floats = NDArray[np.float64]

GROUPS = ((0, 4), (4, 7), (7, 10), (10, 13), (13, 16), (16, 20), (20, 25), (25, 32))
"""Nodes of q that one walk serves; the first is the one whose light it follows."""
N_R = 112
"""Radial bins, uniform in v up to R_MAX."""
BINS_PER_V = N_R / V_MAX
JUMP_DEPTH = 10.0
JUMP_MARGIN = 6.0
"""[1/σt′] deeper than JUMP_DEPTH light diffuses; it jumps to JUMP_MARGIN under the surface."""
FOLLOW = 0.7
FOLLOW_CONSERVATIVE = 0.35
"""Share of the decay constant that the weights follow outwards; where the first albedo is 1, of the last one's."""
N_BATCHES = 32
Scores = tuple[Floats, Floats, Floats, Floats, float]
"""Curve, angles, across and totals of one batch of one group, and its processor time [s]."""
PILOT_PHOTONS = 2000


@dataclass(frozen=True)
class WhiteSamples:
    """Mean and standard error over batches, per entered photon; the leading axes are n_eta and N_Q."""

    g: float
    etas: Floats
    curve: Floats
    """(…, N_R + 1) light scattered twice or more by radial bin of the node's own walk; the last bin is all beyond."""
    curve_se: Floats
    angles: Floats
    """(…, N_R / COARSE, N_MU) light scattered twice or more by exit direction."""
    angles_se: Floats
    across: Floats
    """(…, N_R / COARSE, N_MU) how much more of it there is at a right angle to the radius than over all azimuths."""
    across_se: Floats
    totals: Floats
    """(…, 2) light scattered once, and twice or more."""
    totals_se: Floats
    n_photons: NDArray[np.int64]
    """(groups,)."""
    seconds: float
    """Processor time."""


@dataclass(frozen=True)
class Walk:
    """One group of albedos to sample."""

    g: float
    etas: Floats
    group: int
    beam: Incidence = NORMAL

    @property
    def q(self) -> Floats:
        first, last = GROUPS[self.group]
        return q_nodes()[first:last]

    def batch(self, seed: int, index: int, n_photons: int, stop: threading.Event) -> Scores | None:
        """Scores of one stream per photon, and its processor time; None if stopped before its end."""
        albedos = albedo_of(self.q, self.g)
        kappas = np.array([decay_constant(albedo, self.g) for albedo in albedos])
        unit = 1 / (1 - albedos[0] * self.g)
        conservative = self.group == 0
        [state] = stream_states(seed, 1, self.group, index)
        shape = (self.etas.size, self.q.size)
        curve = np.zeros((N_R + 1, *shape))
        angles = np.zeros((N_R // COARSE, *shape, N_MU))
        across = np.zeros_like(angles)
        totals = np.zeros((2, *shape))
        began = time.thread_time()
        chunk = max(1, n_photons // 20)
        for start in range(0, n_photons, chunk):
            if stop.is_set():
                return None
            white_walk(
                min(chunk, n_photons - start),
                state,
                self.g,
                self.etas,
                np.sin(np.radians(self.beam.angle_deg)) / self.etas,
                self.beam.across,
                albedos,
                kappas,
                FOLLOW_CONSERVATIVE * kappas[-1] if conservative else FOLLOW * kappas[0],
                unit,
                R_ZERO,
                BINS_PER_V,
                JUMP_DEPTH * unit if conservative else np.inf,
                JUMP_MARGIN * unit,
                curve,
                angles,
                across,
                totals,
            )
        seconds = time.thread_time() - began
        return curve / n_photons, angles / n_photons, across / n_photons, totals / n_photons, seconds


def radius_of_bin_edges(q: Floats, g: float) -> Floats:
    """Edges [1/σt′ of the node] of the radial bins at every node of q, shape (N_Q, N_R + 1)."""
    own = 1 - albedo_of(q, g) * g
    firsts = np.concatenate([np.full(last - first, first) for first, last in GROUPS])
    edges = R_ZERO * np.expm1(np.arange(N_R + 1) / BINS_PER_V)
    return edges * (own / own[firsts])[:, None]


def seconds_per_photon(g: float, etas: Floats, seed: int = 0) -> Floats:
    """Processor time per photon in each group, by a short trial."""
    stop = threading.Event()
    costs = []
    for group in range(len(GROUPS)):
        walk = Walk(g, etas, group)
        walk.batch(seed, 0, 1, stop)
        trial = walk.batch(seed, 1, PILOT_PHOTONS, stop)
        assert trial is not None
        costs.append(trial[-1] / PILOT_PHOTONS)
    return np.array(costs)


def sample(
    g: float,
    etas: Floats,
    core_seconds: float,
    *,
    seed: int,
    beam: Incidence = NORMAL,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> WhiteSamples:
    """Sample all groups for about `core_seconds` of processor time, shared equally among them.

    An oblique `beam` takes one index, which bends it. A Ctrl-C raises KeyboardInterrupt: a table from a part would
    lack whole ranges of albedo.
    """
    per_batch = photons_per_batch(g, etas, core_seconds, seed)
    stop = threading.Event()
    tasks = [
        functools.partial(batches, g, etas, per_batch, index, seed=seed, beam=beam, stop=stop)
        for index in range(N_BATCHES)
    ]
    done, interrupted = run_all(tasks, stop, n_threads, progress)
    if interrupted:
        raise KeyboardInterrupt
    return merged(g, etas, per_batch, done)


def photons_per_batch(g: float, etas: Floats, core_seconds: float, seed: int) -> NDArray[np.int64]:
    """Photons of each group in one of N_BATCHES that together take about `core_seconds`."""
    share = core_seconds / len(GROUPS) / N_BATCHES
    return np.maximum(1, share / seconds_per_photon(g, etas, seed)).astype(np.int64)


def batches(
    g: float,
    etas: Floats,
    per_batch: NDArray[np.int64],
    index: int,
    *,
    seed: int,
    beam: Incidence = NORMAL,
    stop: threading.Event | None = None,
) -> list[Scores] | None:
    """The scores of each group in batch `index`, the same on whatever machine; None if stopped before the end."""
    done = []
    for group in range(len(GROUPS)):
        scores = Walk(g, etas, group, beam).batch(seed, 2 + index, int(per_batch[group]), stop or threading.Event())
        if scores is None:
            return None
        done.append(scores)
    return done


def merged(g: float, etas: Floats, per_batch: NDArray[np.int64], done: Sequence[list[Scores]]) -> WhiteSamples:
    """Means and standard errors over the batches, which stand in order of their index."""
    by_kind = [[np.stack([each[group][kind] for each in done]) for group in range(len(GROUPS))] for kind in range(4)]
    curve, angles, across, totals = (
        np.concatenate([np.moveaxis(group, (2, 3), (1, 2)) for group in kind], axis=2) for kind in by_kind
    )
    error = functools.partial(np.std, axis=0, ddof=1)
    root = np.sqrt(len(done))
    return WhiteSamples(
        g,
        np.asarray(etas, dtype=float),
        curve.mean(0),
        error(curve) / root,
        angles.mean(0),
        error(angles) / root,
        across.mean(0),
        error(across) / root,
        totals.mean(0),
        error(totals) / root,
        per_batch * len(done),
        float(sum(scores[-1] for each in done for scores in each)),
    )
