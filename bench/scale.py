"""`bssrdf bench scale`: what many curves and sessions cost, by batch size and by workers, and what memory they take.

The curves are those of `bench fit`. Times of curves are the processor's; those of sessions are on the clock, each
beside plain processes in the same minutes.
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from bssrdf.batch import sample_on
from bssrdf.bench.bulk import BulkScore, FilesScore, bulk_score, files_score
from bssrdf.bench.engines import EngineScore, engine_scores
from bssrdf.bench.workers import WorkersScore, race
from bssrdf.transport import WhiteSamples, batches, merged, photons_per_batch

Progress = Callable[[str, int, int], None]
SIZES = (100, 1000, 3000)
"""Slices of three channels in one file."""
FILES = 300
WORKERS = (1, 2)
SESSIONS, ROUNDS = 8, 4
"""Of each worker in a round, and rounds."""


@dataclass(frozen=True)
class ScaleScores:
    """What was measured, and on what."""

    device: str
    """Of all but the engines, which name their own."""
    cores: int
    bulk: tuple[BulkScore, ...]
    files: FilesScore
    workers: tuple[WorkersScore, ...]
    engines: tuple[EngineScore, ...]


def run_scale_bench(
    *,
    out: Path | None = None,
    sizes: Sequence[int] = SIZES,
    files: int = FILES,
    workers: Sequence[int] = WORKERS,
    sessions: int = SESSIONS,
    rounds: int = ROUNDS,
    jax_curves: int = 0,
    progress: Progress | None = None,
) -> ScaleScores:
    """Fit Parquet files of so many slices, and `files` slice.csv; measure `sessions` for each of so many workers.

    They are measured in so many rounds, by workers and by plain processes in turn. `jax_curves` are also fitted by JAX,
    if not 0. With `out` also write JSON and a plot there.
    """
    told = progress or (lambda what, done, total: None)
    total = len(sizes) + 1 + (rounds + 1) * len(workers)

    def told_of(what: str, before: int) -> Callable[[int], None]:
        return lambda done: told(what, before + done, total)

    with tempfile.TemporaryDirectory(prefix="bssrdf-scale-") as name:
        folder, bulk, many = Path(name), [], []
        for at, size in enumerate(sizes):
            told(f"{3 * size} curves", at, total)
            bulk.append(bulk_score(folder, size))
        told(f"{files} files", len(sizes), total)
        few = files_score(folder / "slices", files)
        for at, count in enumerate(workers):
            begun = told_of(f"{count} workers", len(sizes) + 1 + at * (rounds + 1))
            many.append(race(folder, count, sessions, rounds, begun))
    engines = engine_scores(jax_curves) if jax_curves else []
    device = f"{platform.machine()} CPU, float64, NumPy"
    scores = ScaleScores(device, os.cpu_count() or 1, tuple(bulk), few, tuple(many), tuple(engines))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "scale.json").write_text(json.dumps(asdict(scores), indent=1) + "\n")
        _draw(out / "scale.png", scores)
    return scores


def table(scores: ScaleScores) -> str:
    """The scores as Markdown."""
    lines = [f"{scores.device}, {scores.cores} cores", ""]
    lines += ["| curves | CPU s | fits alone | ratio | curves/s | peak MB |", "|---:|---:|---:|---:|---:|---:|"]
    lines += [
        f"| {s.curves} | {s.seconds:.1f} | {s.fits_seconds:.1f} | {s.ratio:.2f} "
        f"| {s.curves / s.seconds:.0f} | {s.peak_mb:.0f} |"
        for s in scores.bulk
    ]
    few = scores.files
    lines += ["", f"{few.files} slice.csv files: {few.ms_over_fits:.2f} CPU ms per file over the fits", ""]
    lines += ["| workers | sessions/s | efficiency | of plain processes side by side |", "|---:|---:|---:|---:|"]
    one = scores.workers[0]
    lines += [
        f"| {s.workers} | {s.sessions_per_s:.2f} "
        f"| {s.sessions_per_s / one.sessions_per_s * one.workers / s.workers:.2f} "
        f"| {s.ratio:.3f} ± {s.spread:.3f} ({len(s.batch_s)} rounds of {s.sessions}) |"
        for s in scores.workers
    ]
    if scores.engines:
        lines += ["", "| search | device | batch | curves/s | error | lost |", "|---|---|---:|---:|---:|---:|"]
        lines += [
            f"| {s.engine} | {s.device} | {s.batch} | {s.curves / s.seconds:.0f} "
            f"| {s.largest_error:.0e} | {s.not_found} |"
            for s in scores.engines
        ]
    return "\n".join(lines)


def _draw(path: Path, scores: ScaleScores) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    curves = [s.curves for s in scores.bulk]
    left.loglog(curves, [s.seconds for s in scores.bulk], "o-", label="Parquet to Parquet")
    left.loglog(curves, [s.fits_seconds for s in scores.bulk], "s--", label="the fits alone")
    left.set(xlabel="curves", ylabel="processor time [s]")
    left.legend()
    workers = [s.workers for s in scores.workers]
    right.plot(workers, [s.sessions_per_s for s in scores.workers], "o-", label="workers of a batch")
    right.plot(workers, [s.sessions_per_s / s.ratio for s in scores.workers], "s--", label="plain processes")
    right.set(xlabel="workers", ylabel="sessions measured per second", ylim=(0, None), xticks=workers)
    right.legend()
    figure.suptitle(scores.device)
    figure.savefig(path, dpi=120)


def run_tables_bench(cluster: str, core_seconds: float, *, progress: Progress | None = None) -> dict[str, Any]:
    """Walk one table's samples in this process and on a cluster: times on the clock, and whether the bits agree."""
    g, etas, seed, n_batches = 0.5, np.array([1.4]), 1, 8
    per_batch = np.maximum(1, photons_per_batch(g, etas, core_seconds, seed) * 32 // n_batches)
    began = time.perf_counter()
    alone = merged(g, etas, per_batch, [batches(g, etas, per_batch, at, seed=seed) or [] for at in range(n_batches)])
    middle = time.perf_counter()
    many = sample_on(cluster, g, etas, per_batch, seed=seed, n_batches=n_batches, progress=progress)
    ended = time.perf_counter()
    return {
        "photons": int(alone.n_photons.sum()),
        "one_process_s": round(middle - began, 2),
        "cluster": cluster,
        "cluster_s": round(ended - middle, 2),
        "same_bits": same_bits(alone, many),
    }


def same_bits(one: WhiteSamples, other: WhiteSamples) -> bool:
    """Whether all that was scored agrees to the last bit."""
    names = [field.name for field in fields(WhiteSamples) if field.name != "seconds"]
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)
