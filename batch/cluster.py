"""A batch on Dask: chunks and walks go to workers, each of which keeps a process of its own for them.

Dask runs tasks in threads, where compiled parallel calls must not run; the kept process runs them on its main thread.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import bssrdf
from bssrdf.batch.child import KeptProcess
from bssrdf.batch.chunks import Chunk, do_chunk
from bssrdf.errors import BssrdfError, DeviceError, InputError, UsageError

if TYPE_CHECKING:
    from distributed import Client

_TIMEOUT_S = 10.0
_SHARE = 0.8
"""Of a machine's memory, for the workers of `local:N` together."""
_QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Dask's own watch over two workers takes 0.10 cores else, and 0.013 so."""
_kept = threading.local()
Work = Callable[[KeptProcess], Any]


def on_cluster(cluster: str, todo: Sequence[Chunk], memory: float | None) -> Iterator[int]:
    """Do the chunks on a cluster; yields how many inputs each had that is finished, in the order in which they end."""
    yield from results_of(cluster, _ChunkWork, todo, memory)


class _ChunkWork:
    """A chunk, as a worker does it."""

    def __init__(self, chunk: Chunk) -> None:
        self.chunk = chunk

    def __call__(self, child: KeptProcess) -> int:
        if not (self.chunk.file.parent.parent / "plan.json").is_file():
            raise InputError(f"{self.chunk.out}: a worker does not see it; put --out where all workers can write")
        return do_chunk(self.chunk, child, _nothing)


def _nothing(message: Any) -> None:
    """Told of progress on another machine."""


def results_of(cluster: str, work: Callable[[Any], Work], items: Sequence[Any], memory: float | None) -> Iterator[Any]:
    """What `work(item)` gives for each item when a worker calls it with its kept process; an error ends all."""
    from distributed import as_completed

    if not items:
        return
    with connected(cluster, memory) as client:
        slots = _slots(client)
        futures = [
            client.submit(_on_worker, work(item), slots, memory, pure=False, priority=-at)
            for at, item in enumerate(items)
        ]
        try:
            for future in as_completed(futures):
                yield _result(future)
        finally:
            client.cancel(futures, force=True)


def _result(future: Any) -> Any:
    from distributed.scheduler import KilledWorker

    try:
        answer = future.result()
    except KilledWorker as error:
        raise DeviceError(f"workers were lost again and again in one chunk ({error.task}); see their logs") from error
    if isinstance(answer, BssrdfError):
        raise answer
    return answer


@contextmanager
def connected(cluster: str, memory: float | None) -> Iterator[Client]:
    """A client of `local:N`, which listens on this machine alone, or of the scheduler at an address."""
    try:
        import dask
        import distributed
    except ImportError as error:
        raise UsageError("--cluster needs Dask; install it by `pip install 'bssrdf[batch]'`") from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    kind, _, number = cluster.partition(":")
    if kind == "local":
        if not number.isdecimal() or not 0 < int(number) <= 4 * (os.cpu_count() or 1):
            raise UsageError(f"--cluster {cluster}: give a number of workers that this machine holds, such as local:2")
        with (
            dask.config.set(_QUIET),
            distributed.LocalCluster(
                n_workers=int(number),
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            ) as own,
            distributed.Client(own) as client,
        ):
            yield client
        return
    if kind not in ("tcp", "tls", "ws", "wss"):
        raise UsageError(f"--cluster {cluster}: give local:N, or the address of a scheduler such as tcp://host:8786")
    try:
        client = distributed.Client(cluster, timeout=_TIMEOUT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DeviceError(
            f"--cluster {cluster}: cannot be reached ({said[:80]}); start `dask scheduler` there"
        ) from error
    with client:
        _check_workers(client, cluster)
        yield client


def _check_workers(client: Client, cluster: str) -> None:
    if not client.scheduler_info()["workers"]:
        raise DeviceError(f"--cluster {cluster}: has no worker; start some by `dask worker {cluster}`")
    try:
        versions = client.run(_version)
    except Exception as error:  # whatever a worker without this package makes of it
        raise DeviceError(
            f"--cluster {cluster}: a worker cannot run bssrdf ({error!r:.80}); install it there"
        ) from error
    for worker, version in versions.items():
        if version != bssrdf.__version__:
            raise DeviceError(f"{worker}: has bssrdf {version}, not {bssrdf.__version__}; install the same on all")


def _version() -> str:
    return bssrdf.__version__


def _slots(client: Client) -> dict[str, int]:
    """By host how many tasks its workers run at once."""
    slots: dict[str, int] = {}
    for worker in client.scheduler_info(n_workers=-1)["workers"].values():
        slots[worker["host"]] = slots.get(worker["host"], 0) + worker["nthreads"]
    return slots


def _on_worker(work: Work, slots: dict[str, int], memory: float | None) -> Any:
    """The work's result, or the error that it ends in, by the process that this thread of the worker keeps."""
    from distributed import get_worker

    if not hasattr(_kept, "child"):
        host = get_worker().address.rpartition("/")[2].rpartition(":")[0]
        _kept.child = KeptProcess(*_shares(slots.get(host, 1), memory))
    try:
        return work(_kept.child)
    except BssrdfError as error:
        return error


def _shares(slots: int, memory: float | None) -> tuple[int, float]:
    """Threads, and memory [bytes], of one of so many processes of a machine."""
    whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return max(1, (os.cpu_count() or 1) // slots), memory or _SHARE * whole / slots
