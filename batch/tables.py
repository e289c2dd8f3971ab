"""Samples for Monte Carlo tables, walked batch by batch on a cluster: the same bits as one process gives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.batch.child import KeptProcess
from bssrdf.batch.cluster import results_of
from bssrdf.transport import N_BATCHES, WhiteSamples, merged


class _WalkWork:
    """One batch of the walk, as a worker does it: its index and its scores."""

    def __init__(self, task: dict[str, Any]) -> None:
        self.task = task

    def __call__(self, child: KeptProcess) -> tuple[int, Any]:
        return self.task["index"], child.ask(self.task)


def sample_on(
    cluster: str,
    g: float,
    etas: NDArray[np.float64],
    per_batch: NDArray[np.int64],
    *,
    seed: int,
    n_batches: int = N_BATCHES,
    progress: Callable[[str, int, int], None] | None = None,
) -> WhiteSamples:
    """`transport.sample` with given photons, on a cluster: streams belong to batches, which are merged by number."""
    common = {"task": "walk", "g": g, "etas": etas, "per_batch": per_batch, "seed": seed}
    done: dict[int, Any] = {}
    for index, scores in results_of(cluster, _WalkWork, [common | {"index": at} for at in range(n_batches)], None):
        done[index] = scores
        if progress is not None:
            progress("batches", len(done), n_batches)
    return merged(g, etas, per_batch, [done[at] for at in range(n_batches)])
