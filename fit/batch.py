"""One batch: curves of one shape, one task and one medium's model go through the kernels, padded to a few sizes."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from bssrdf.fit.choose import model_of
from bssrdf.fit.curves import Curves, stack
from bssrdf.fit.intervals import Profile, profile_batch
from bssrdf.fit.kernel import Common, Constraint, Judged, Task, fit_batch
from bssrdf.fit.result import Job, factor_of, needs_profile
from bssrdf.transport.forward import ForwardModel
from bssrdf.transport.precision import scoped_x64

CHUNKS = (4, 64)
"""Rows that a kernel gets at once, padded, so that it is compiled for two shapes only. More would not fit the caches,
and all rows of a chunk wait for its slowest."""
BATCH = 1024
"""Rows that are judged together."""


class Group(NamedTuple):
    """What the curves of one batch have in common."""

    task: Task
    model: Literal["dipole", "mc"]
    eta: float
    g: float | None
    width: int


class Fitted(NamedTuple):
    """A batch with its results, rows in the order of `jobs`."""

    group: Group
    model: ForwardModel
    jobs: Sequence[Job]
    data: Curves
    judged: Judged
    profiles: dict[int, Profile]


def fit_group(
    group: Group, jobs: Sequence[Job], window_mm: tuple[float, float] | None, announce: Callable[[float], None] | None
) -> Fitted:
    """Fit at most BATCH jobs of one group."""
    model = model_of(group.model, group.eta, group.g, announce)
    data = stack([(job.piece, job.channel) for job in jobs], window_mm=window_mm)
    judged: Judged = run_padded(lambda batch: fit_batch(group.task, model, *batch), (data, _common_errors(jobs)))
    wanted = [row for row in range(len(jobs)) if needs_profile(group.task, pick(judged, row))]
    found = _profiles(group.task, model, data, judged, jobs, wanted) if wanted else []
    return Fitted(group, model, jobs, data, judged, dict(zip(wanted, found, strict=True)))


def run_padded(kernel: Callable[[Any], Any], batch: Any) -> Any:
    """The kernel's result for the rows of `batch`, by chunks on all processors; the last is padded with its last."""
    rows = len(jax.tree.leaves(batch)[0])
    size = next((size for size in CHUNKS if size >= rows), CHUNKS[-1])

    @scoped_x64
    def run(first: int) -> Any:
        part = jax.tree.map(lambda x: np.asarray(x)[first : first + size], batch)
        extra = size - len(jax.tree.leaves(part)[0])
        if extra:
            part = jax.tree.map(lambda x: np.concatenate([x, np.repeat(x[-1:], extra, axis=0)]), part)
        return jax.tree.map(np.asarray, kernel(part))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        parts = list(pool.map(run, range(0, rows, size)))
    return jax.tree.map(lambda *chunks: np.concatenate(chunks)[:rows], *parts)


def pick(tree: Any, at: Any) -> Any:
    """One row of a batch, or the rows that an array names."""
    return jax.tree.map(lambda x: x[at], tree)


def _profiles(
    task: Task, model: ForwardModel, data: Curves, judged: Judged, jobs: Sequence[Job], rows: Sequence[int]
) -> list[Profile]:
    """Profile likelihoods of some rows. An R without an error fixes q = 0; what bounds σa then is the curve alone."""
    scale_sd = np.asarray([job.piece.scale_rel_sd or 0.0 for job in jobs])
    data = data._replace(total_r_sd=np.hypot(data.total_r_sd, scale_sd * data.total_r))
    constraint: Constraint = "none" if task.constraint == "exact" else task.constraint
    inflation = np.ones(len(jobs)) if task.errors_known else judged.chi2
    chosen = jax.tree.map(lambda x: x[np.asarray(rows)], (data, judged.solution, inflation))
    found = run_padded(lambda batch: profile_batch(task._replace(constraint=constraint), model, *batch), chosen)
    return [pick(found, at) for at in range(len(rows))]


def _common_errors(jobs: Sequence[Job]) -> Common:
    rows = [
        (
            job.piece.total_r_sd.get(job.channel, 0.0) / factor_of(job.piece),
            job.piece.scale_rel_sd or 0.0,
            job.piece.mm_rel_sd or 0.0,
        )
        for job in jobs
    ]
    return Common(*np.asarray(rows).T)
