"""Measuring by the workers of a batch, and by as many plain processes side by side.

Both do the same sessions in turns, again and again, so that they meet the same load of the machine; each worker, and
each plain process, has cores ÷ workers threads. Processes are started, and code is compiled, before the clock runs.
Dask's idle processes, which take 0.013 cores, are there meanwhile.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median, quantiles

from bssrdf.batch import MEASURED, THREADS, StageOptions, connected, run_batch
from bssrdf.bench.measure import write_large
from bssrdf.measure import measure_session
from bssrdf.session import read_session


@dataclass(frozen=True)
class WorkersScore:
    """A batch of sessions that are measured, against plain processes."""

    workers: int
    sessions: int
    """Of each round."""
    batch_s: tuple[float, ...]
    """Of each round, on the clock."""
    plain_s: tuple[float, ...]

    @property
    def sessions_per_s(self) -> float:
        return self.sessions / median(self.batch_s)

    @property
    def ratios(self) -> list[float]:
        """The batch's speed over that of the plain processes, by round."""
        return [plain / batch for plain, batch in zip(self.plain_s, self.batch_s, strict=True)]

    @property
    def ratio(self) -> float:
        return median(self.ratios)

    @property
    def spread(self) -> float:
        """Standard error of the ratio, by the range of the middle half of the rounds; NaN for one round."""
        if len(self.batch_s) < 2:
            return float("nan")
        low, _, high = quantiles(self.ratios, n=4, method="inclusive")
        return 0.93 * (high - low) / len(self.batch_s) ** 0.5


def race(folder: Path, workers: int, each: int, rounds: int, told: Callable[[int], None]) -> WorkersScore:
    """Measure `each` × `workers` sessions by a batch on `local:workers` and by plain processes, `rounds` times each."""
    sessions, chunk = _sessions(folder / f"for{workers}", each * workers), min(each, MEASURED)
    batch_s: list[float] = []
    plain_s: list[float] = []
    with connected(f"local:{workers}", None) as client, _plain(workers) as pool:
        sides: list[tuple[list[float], Callable[[], None]]] = [
            (batch_s, lambda: _batch(sessions, chunk, folder / "batch", client.scheduler_info()["address"])),
            (plain_s, lambda: _side_by_side(sessions, chunk, folder / "plain", pool)),
        ]
        for at in range(rounds + 1):
            told(at)
            for seconds, run in sides if at % 2 else sides[::-1]:
                began = time.perf_counter()
                run()
                seconds.append(time.perf_counter() - began)
    return WorkersScore(workers, len(sessions), tuple(batch_s[1:]), tuple(plain_s[1:]))


def _sessions(folder: Path, count: int) -> list[Path]:
    """So many sessions of the same small frames, which lie on the disk once."""
    sessions = [folder / f"{at:03}" for at in range(count)]
    write_large(sessions[0], 1)
    for other in sessions[1:]:
        shutil.copytree(sessions[0], other, copy_function=os.link)
    return sessions


def _batch(sessions: Sequence[Path], chunk: int, out: Path, address: str) -> None:
    what = [str(session) for session in sessions]
    result = run_batch(what, out, ["measure"], StageOptions(), chunk=chunk, cluster=address)
    assert not result.failures, result.failures[0]
    shutil.rmtree(out)


@contextmanager
def _plain(count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes of Python's own pool, each with its share of the cores."""
    before = dict(os.environ)
    os.environ |= dict.fromkeys(THREADS, str(max(1, (os.cpu_count() or 1) // count)))
    try:
        with ProcessPoolExecutor(count, multiprocessing.get_context("spawn")) as pool:
            yield pool
    finally:
        os.environ.clear()
        os.environ.update(before)


def _side_by_side(sessions: Sequence[Path], chunk: int, out: Path, pool: ProcessPoolExecutor) -> None:
    out.mkdir()
    for each in [pool.submit(_measure, sessions[at : at + chunk], out) for at in range(0, len(sessions), chunk)]:
        each.result()
    shutil.rmtree(out)


def _measure(sessions: Sequence[Path], out: Path) -> None:
    for session in sessions:
        (out / session.name).mkdir()
        measure_session(read_session(session), out=out / session.name / "measured")
