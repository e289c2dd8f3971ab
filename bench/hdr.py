"""`bssrdf bench hdr`: speed and error of the merge, beside other tools, on one made-up scene in one run.

Thirteen exposures of 1 ms to 4.1 s, six decades of radiance with a coloured fall-off, three channels. Every method
gets the same 16-bit frames; those that know no dark frames get them with the black level taken off, which is not timed.
"""

from __future__ import annotations

import json
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.hdr_peers import METHODS, Timed
from bssrdf.bench.hdr_scene import DECADES, Plane, bound, make_scene
from bssrdf.measure import Hdr, Progress

_MOST_SECONDS = 3.0
"""A method that takes longer is run once."""


@dataclass(frozen=True)
class MergeScore:
    """How one method did; by decade of radiance, the brightest first, in relative errors."""

    method: str
    seconds: float
    """Median over the rounds."""
    peak_mib: float
    rms: list[float]
    bias: list[float]


@dataclass(frozen=True)
class HdrBench:
    """All scores, the least possible error by decade, and how right our variance map is."""

    bound: list[float]
    scores: list[MergeScore]
    chi2: float
    skipped: dict[str, str]
    """Why a method was left out."""


def run_hdr_bench(
    height: int = 800, width: int = 1200, *, rounds: int = 5, out: Path | None = None, progress: Progress | None = None
) -> HdrBench:
    """Merge one scene by every method there is; write `hdr.json` and `hdr.png` into the folder `out`, if given.

    The methods take turns, `rounds` times, so that a busy machine is as busy for each.
    """
    scene = make_scene(height, width)
    decade = np.minimum(np.log10(scene.radiance.max() / scene.radiance).astype(np.int8), DECADES - 1)
    runs: dict[str, list[_MergeRun]] = {name: [] for name in METHODS}
    skipped: dict[str, str] = {}
    for turn in range(rounds):
        for number, (name, prepare) in enumerate(METHODS.items()):
            if progress:
                progress(name, turn * len(METHODS) + number, rounds * len(METHODS))
            if name in skipped or (runs[name] and runs[name][0].seconds > _MOST_SECONDS):
                continue
            try:
                run = _timed(prepare(scene))
                runs[name].append(run if turn == 0 else run._replace(merged=runs[name][0].merged))
            except ImportError as missing:
                skipped[name] = f"{missing.name} is not installed"
    chi2, scores = np.nan, []
    for name, done in runs.items():
        if not done:
            continue
        merged = done[0].merged
        if isinstance(merged, Hdr):
            chi2 = float(np.nanmean((merged.radiance - scene.radiance) ** 2 / merged.variance))
            merged = merged.radiance
        errors = _by_decade(np.divide(merged, scene.radiance, dtype=np.float32) - 1, decade)
        seconds = float(np.median([run.seconds for run in done]))
        scores.append(MergeScore(name, seconds, done[0].peak_mib, *errors))
    least = [float(np.sqrt(np.mean(bound(scene.radiance)[decade == d] ** 2))) for d in range(DECADES)]
    bench = HdrBench(least, scores, chi2, skipped)
    if out is not None:
        _write(bench, out)
    return bench


def _by_decade(error: Plane, decade: NDArray[np.int8]) -> tuple[list[float], list[float]]:
    """RMS and mean of a relative error in each decade."""
    parts = [error[(decade == d) & np.isfinite(error)] for d in range(DECADES)]
    return [float(np.sqrt(np.mean(part**2))) for part in parts], [float(np.mean(part)) for part in parts]


class _MergeRun(NamedTuple):
    """One call: its image, wall time, and by how much the process grew; NaN without /proc."""

    merged: Hdr | Plane
    seconds: float
    peak_mib: float


def _timed(method: Timed) -> _MergeRun:
    stop = threading.Event()
    before = _resident_mib()
    peak = [before]

    def look() -> None:
        while not stop.wait(0.002):
            peak[0] = max(peak[0], _resident_mib())

    thread = threading.Thread(target=look)
    thread.start()
    start = time.perf_counter()
    try:
        merged = method()
    finally:
        seconds = time.perf_counter() - start
        stop.set()
        thread.join()
    return _MergeRun(merged, seconds, max(peak[0], _resident_mib()) - before)


def _resident_mib() -> float:
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, IndexError):
        return float("nan")
    return pages * 4096 / 2**20


def table(bench: HdrBench) -> str:
    """The scores as a Markdown table, errors in percent."""
    head = "| method | s | MiB | " + " | ".join(f"RMS {d + 1}" for d in range(DECADES)) + " | largest bias |"
    lines = [head, "|---" * (DECADES + 4) + "|"]
    lines.append("| bound | | | " + " | ".join(f"{100 * b:.3f}" for b in bench.bound) + " | |")
    for score in bench.scores:
        errors = " | ".join(f"{100 * rms:.3f}" for rms in score.rms)
        bias = 100 * max(score.bias, key=abs)
        lines.append(f"| {score.method} | {score.seconds:.2f} | {score.peak_mib:.0f} | {errors} | {bias:+.2f} |")
    lines += [f"| {name} | {reason} |" for name, reason in bench.skipped.items()]
    return "\n".join([*lines, "", f"Mean χ² of the variance map: {bench.chi2:.3f}"])


def _write(bench: HdrBench, out: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    (out / "hdr.json").write_text(json.dumps(asdict(bench), indent=1) + "\n", encoding="utf-8")
    figure = Figure(figsize=(6, 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(
        xlabel="seconds", ylabel="RMS error over the bound, worst decade", xscale="log", yscale="log"
    )
    for score in bench.scores:
        worst = max(rms / least for rms, least in zip(score.rms, bench.bound, strict=True))
        axes.plot(score.seconds, worst, "o")
        axes.annotate(score.method, (score.seconds, worst), textcoords="offset points", xytext=(6, 3))
    axes.axhline(1, lw=0.8, color="0.5")
    figure.savefig(out / "hdr.png", dpi=110)
