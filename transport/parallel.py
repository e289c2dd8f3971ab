"""Compiled work on threads, cut short cleanly by Ctrl-C. Results never depend on the number of threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import Future

T = TypeVar("T")

Progress = Callable[[int, int], None]
"""Called with the batches done and the batches asked for."""


def run_all(
    tasks: Sequence[Callable[[], T | None]], stop: threading.Event, n_threads: int | None, progress: Progress | None
) -> tuple[list[T], bool]:
    """Results of `tasks` in their order, run on threads, and whether Ctrl-C cut the list short.

    At Ctrl-C `stop` is set, and tasks that heed it return None; with fewer than two results KeyboardInterrupt goes on.
    """
    from concurrent.futures import ThreadPoolExecutor  # late: a fit that names Progress alone starts without it

    interrupted = False
    with ThreadPoolExecutor(n_threads or os.cpu_count()) as pool:
        futures = [pool.submit(task) for task in tasks]
        try:
            _report(futures, progress)
        except KeyboardInterrupt:
            interrupted = True
            stop.set()
            pool.shutdown(cancel_futures=True)
    results = [future.result() for future in futures if not future.cancelled()]
    finished = [result for result in results if result is not None]
    if interrupted and len(finished) < 2:
        raise KeyboardInterrupt
    return finished, interrupted


def _report(futures: list[Future[T]], progress: Progress | None) -> None:
    from concurrent.futures import FIRST_COMPLETED, wait

    pending = set(futures)
    while pending:
        finished, pending = wait(pending, return_when=FIRST_COMPLETED)
        for future in finished:
            future.result()
        if progress is not None:
            progress(len(futures) - len(pending), len(futures))
