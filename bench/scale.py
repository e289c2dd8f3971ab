"""`bssrdf bench scale`: what many curves and sessions cost, by batch size and by workers, and what memory they take.

The curves are those of `bench fit`; times are those of this machine, with all else that runs on it.
"""

from __future__ import annotations

import json
import math
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bssrdf.batch import Named, StageOptions, fit_parquet, read_slices, run_batch, sample_on, write_slices
from bssrdf.bench.fit import noisy_curves
from bssrdf.fit import FitOptions, fit_slices
from bssrdf.session import write_slice
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.transport import WhiteSamples, batches, merged, photons_per_batch

Progress = Callable[[str, int, int], None]
CHANNELS = "RGB"
SIZES = (100, 1000, 3000)
"""Slices of three channels in one file."""
FILES = 300
WORKERS = (1, 2)
_GROUP = 1024


@dataclass(frozen=True)
class BulkScore:
    """A Parquet file of slices, fitted into another."""

    curves: int
    seconds: float
    """Processor time of reading, fitting and writing."""
    fits_seconds: float
    """Of the fits of the same slices alone."""
    peak_mb: float
    """Of the process so far."""

    @property
    def ratio(self) -> float:
        return self.seconds / self.fits_seconds


@dataclass(frozen=True)
class WorkersScore:
    """A batch of slice.csv files."""

    workers: int
    seconds: float
    """On the clock, with the start of the workers."""
    inputs_per_second: float


@dataclass(frozen=True)
class ScaleScores:
    """What was measured, and on what."""

    device: str
    cores: int
    bulk: tuple[BulkScore, ...]
    workers: tuple[WorkersScore, ...]


def run_scale_bench(
    *,
    out: Path | None = None,
    sizes: Sequence[int] = SIZES,
    files: int = FILES,
    workers: Sequence[int] = WORKERS,
    progress: Progress | None = None,
) -> ScaleScores:
    """Fit files of so many slices, and `files` by so many workers; with `out` write JSON and a plot."""
    told = progress or (lambda what, done, total: None)
    with tempfile.TemporaryDirectory(prefix="bssrdf-scale-") as folder:
        bulk = []
        for at, size in enumerate(sizes):
            told(f"{len(CHANNELS) * size} curves", at, len(sizes) + len(workers))
            bulk.append(_bulk(Path(folder), size))
        slices = _files(Path(folder) / "slices", files)
        many = []
        for at, count in enumerate(workers):
            told(f"{count} workers", len(sizes) + at, len(sizes) + len(workers))
            many.append(_batch(slices, Path(folder) / f"out{count}", files, count))
    device = f"{platform.machine()} CPU, float64, NumPy"
    scores = ScaleScores(device, os.cpu_count() or 1, tuple(bulk), tuple(many))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "scale.json").write_text(json.dumps(asdict(scores), indent=1) + "\n")
        _draw(out / "scale.png", scores)
    return scores


def table(scores: ScaleScores) -> str:
    """The scores as Markdown."""
    lines = [
        f"{scores.device}, {scores.cores} cores",
        "",
        "| curves | CPU s | fits alone | ratio | curves/s | peak MB |",
    ]
    lines += ["|---:|---:|---:|---:|---:|---:|"]
    lines += [
        f"| {s.curves} | {s.seconds:.1f} | {s.fits_seconds:.1f} | {s.ratio:.2f} "
        f"| {s.curves / s.seconds:.0f} | {s.peak_mb:.0f} |"
        for s in scores.bulk
    ]
    lines += ["", "| workers | s | inputs/s | efficiency |", "|---:|---:|---:|---:|"]
    one = scores.workers[0]
    lines += [
        f"| {s.workers} | {s.seconds:.1f} | {s.inputs_per_second:.1f} "
        f"| {s.inputs_per_second / one.inputs_per_second * one.workers / s.workers:.2f} |"
        for s in scores.workers
    ]
    return "\n".join(lines)


def _slices(count: int) -> Iterator[Slice]:
    """Slices of three channels of `bench fit`'s curves."""
    curves, _, _ = noisy_curves(3 * min(count, _GROUP))
    for at in range(count):
        rows = [(3 * at + k) % (3 * min(count, _GROUP)) for k in range(3)]
        parts = {
            name: ChannelSlice(curves.r_mm[row], curves.rd[row], np.asarray(curves.sd[row]))
            for name, row in zip(CHANNELS, rows, strict=True)
        }
        totals, sds = (
            {name: float(each[row]) for name, row in zip(CHANNELS, rows, strict=True)}
            for each in (curves.total_r, curves.total_r_sd)
        )
        yield Slice(parts, curves.eta, "entering", "hemisphere", total_r=totals, total_r_sd=sds, g=0.0)


def _bulk(folder: Path, count: int) -> BulkScore:
    source, target = folder / "slices.parquet", folder / "fits.parquet"
    with write_slices(source) as write:
        group: list[Named] = []
        for at, piece in enumerate(_slices(count)):
            group.append(Named(f"slice {at}", "", piece))
            if len(group) == _GROUP:
                write(group)
                group = []
        write(group)
    fits_seconds = 0.0
    fit_slices([*_slices(1)])  # the tables are there before the clock runs
    began = time.process_time()
    fit_parquet(source, target, FitOptions(), {})
    seconds = time.process_time() - began
    for several in read_slices(source, lean=True):
        pieces = [each.slice for each in several if isinstance(each.slice, Slice)]
        began = time.process_time()
        fit_slices(pieces)
        fits_seconds += time.process_time() - began
    return BulkScore(len(CHANNELS) * count, seconds, fits_seconds, _peak_mb())


def _peak_mb() -> float:
    """The most memory that this process has held; NaN where the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return math.nan
    return next(float(line.split()[1]) / 1000 for line in lines if line.startswith("VmHWM"))


def _files(folder: Path, count: int) -> Path:
    folder.mkdir()
    for at, piece in enumerate(_slices(count)):
        write_slice(folder / f"{at:06}.csv", piece)
    return folder


def _batch(slices: Path, out: Path, count: int, workers: int) -> WorkersScore:
    began = time.perf_counter()
    run_batch([str(slices)], out, ["fit"], StageOptions(), chunk=32, cluster=f"local:{workers}")
    seconds = time.perf_counter() - began
    shutil.rmtree(out)
    return WorkersScore(workers, seconds, count / seconds)


def _draw(path: Path, scores: ScaleScores) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    curves = [s.curves for s in scores.bulk]
    left.loglog(curves, [s.seconds for s in scores.bulk], "o-", label="Parquet to Parquet")
    left.loglog(curves, [s.fits_seconds for s in scores.bulk], "s--", label="the fits alone")
    left.set(xlabel="curves", ylabel="processor time [s]")
    left.legend()
    right.plot([s.workers for s in scores.workers], [s.inputs_per_second for s in scores.workers], "o-")
    right.set(xlabel="workers", ylabel="files/s, with start", ylim=(0, None))
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
        "same_bits": _same(alone, many),
    }


def _same(one: WhiteSamples, other: WhiteSamples) -> bool:
    names = ("curve", "curve_se", "angles", "angles_se", "across", "across_se", "totals", "totals_se")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)
