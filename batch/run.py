"""`bssrdf batch`: cut the inputs into chunks, do those that are not done, here or on a cluster, and sum up."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from filelock import FileLock, Timeout

from bssrdf.batch.child import KeptProcess
from bssrdf.batch.chunks import Chunk, do_chunk
from bssrdf.batch.inputs import BatchInput, Stage, find_inputs, signature
from bssrdf.batch.stages import StageOptions
from bssrdf.batch.state import InputOutcome, is_finished, read_chunk, stage_keys
from bssrdf.batch.sums import write_sums
from bssrdf.errors import UsageError
from bssrdf.session import atomic_write, make_folder

MEASURED, PLAIN = 4, 256
"""Inputs in a chunk: with frames, of which each takes seconds, and without, which the fit takes together."""
_WAIT_S = 5.0
"""For a batch that is about to end."""
Progress = Callable[[str, int, int], None]


class BatchResult(NamedTuple):
    """All outcomes in the order of the inputs, and how many inputs had nothing to be done."""

    outcomes: list[InputOutcome]
    skipped: int

    @property
    def failures(self) -> list[str]:
        return [each.failed[2] for each in self.outcomes if each.failed is not None]


def run_batch(
    what: Sequence[str],
    out: Path,
    stages: Sequence[Stage],
    options: StageOptions,
    *,
    chunk: int | None = None,
    cluster: str | None = None,
    memory: float | None = None,
    progress: Progress | None = None,
) -> BatchResult:
    """Run the stages for all that `what` stands for; results go to `out`, a folder for each input.

    What an earlier run finished, on the same inputs with the same version and options, is not done again. `chunk` is
    how many inputs are finished, redone or lost together: a few with frames, many without, if None. `cluster`
    is `local:N` or the address of a Dask scheduler; `memory` [bytes] is what a worker may take. An input that fails
    is an outcome with its error. Raises InputError or UsageError where there is nothing to do or nowhere to write.
    """
    inputs = find_inputs(what, stages)
    state = _opened(out)
    with _locked(out, state):
        inputs = _named_as_before(inputs, state)
        size = chunk or (MEASURED if {"ingest", "measure"} & set(stages) else PLAIN)
        wanted = _wanted(inputs, stages, options, progress)
        chunks = _chunks(out, state, wanted, stages, options, size)
        _write_plan(state, inputs, size)
        todo = [c for c in chunks if not is_finished(read_chunk(c.file), [(item, keys) for item, _, keys in c.inputs])]
        done = len(inputs) - sum(len(chunk.inputs) for chunk in todo)
        pace = _Pace(done, len(inputs), progress)
        if cluster is None:
            _here(todo, memory, pace)
        else:
            from bssrdf.batch.cluster import on_cluster

            for count in on_cluster(cluster, todo, memory):
                pace.more(count)
        outcomes = [outcome for chunk in chunks for outcome in read_chunk(chunk.file)]
        write_sums(out, outcomes, stages)
        _forget_others(state, chunks)
    return BatchResult(outcomes, done)


def _here(todo: Sequence[Chunk], memory: float | None, pace: _Pace) -> None:
    child = KeptProcess(os.cpu_count() or 1, memory)
    try:
        for chunk in todo:
            pace.more(do_chunk(chunk, child, pace.tell))
    finally:
        child.close()


class _Pace:
    """How far the batch is, in words."""

    def __init__(self, done: int, total: int, progress: Progress | None) -> None:
        self._done, self._total, self._new, self._progress = done, total, 0, progress
        self._began = time.monotonic()
        self.tell("")

    def more(self, count: int) -> None:
        """So many inputs are finished."""
        self._done, self._new = self._done + count, self._new + count
        self.tell("")

    def tell(self, name: str) -> None:
        """Work on this input begins."""
        if self._progress is not None:
            rate = self._new / max(time.monotonic() - self._began, 1e-9)
            left = f"{(self._total - self._done) / rate:.0f} s left" if rate else "…"
            self._progress(f"{rate:.3g} sessions/s, {left} {name[:30]}".rstrip(), self._done, self._total)


def _opened(out: Path) -> Path:
    """The batch's own folder in `out`; UsageError where `out` holds something else."""
    state = out / ".batch"
    if out.exists() and not state.is_dir() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out} exists already and is not the folder of a batch; choose another --out")
    make_folder(state)
    return state


@contextmanager
def _locked(out: Path, state: Path) -> Iterator[None]:
    """Hold the batch's folder."""
    try:
        with FileLock(state / "lock", timeout=_WAIT_S):
            yield
    except Timeout:
        raise UsageError(f"{out}: another batch is working into it; wait for it") from None


def _named_as_before(inputs: Sequence[BatchInput], state: Path) -> list[BatchInput]:
    """Inputs that an earlier run knew keep the name of their results; a new one's name is nobody else's."""
    try:
        before: dict[str, str] = json.loads((state / "plan.json").read_text(encoding="utf-8"))["names"]
    except (OSError, ValueError, KeyError, TypeError):
        return [*inputs]
    taken = set(before.values())

    def named(item: BatchInput) -> BatchInput:
        if item.path in before:
            return item._replace(name=before[item.path])
        mark = hashlib.sha256(item.path.encode()).hexdigest()[:8]
        return item._replace(name=f"{item.name}-{mark}") if item.name in taken else item

    return [named(item) for item in inputs]


def _wanted(
    inputs: Sequence[BatchInput], stages: Sequence[Stage], options: StageOptions, progress: Progress | None
) -> list[tuple[BatchInput, dict[str, str]]]:
    by_stage: dict[str, Any] = {
        "ingest": options.settings and signature(options.settings),
        "fit": {**asdict(options.fit), "keys": dict(options.keys)},
    }
    wanted = []
    for at, item in enumerate(inputs):
        if progress is not None and not at % 100:
            progress("looking for changes", at, len(inputs))
        wanted.append((item, stage_keys(signature(item.path), stages, by_stage)))
    return wanted


def _chunks(
    out: Path,
    state: Path,
    wanted: Sequence[tuple[BatchInput, dict[str, str]]],
    stages: Sequence[Stage],
    options: StageOptions,
    size: int,
) -> list[Chunk]:
    """The inputs cut in their order; the cut is in the name of the files, so that those of another list stay apart."""
    known = {each.path: each for file in sorted(state.glob("*/*.json")) for each in read_chunk(file)}
    cut = hashlib.sha256(json.dumps([size, *(item.path for item, _ in wanted)]).encode()).hexdigest()[:12]
    make_folder(state / cut)
    rows = [(item, known.get(item.path), keys) for item, keys in wanted]
    return [
        Chunk(state / cut / f"{at // size:06}.json", tuple(rows[at : at + size]), out, tuple(stages), options)
        for at in range(0, len(rows), size)
    ]


def _write_plan(state: Path, inputs: Sequence[BatchInput], size: int) -> None:
    try:
        names = json.loads((state / "plan.json").read_text(encoding="utf-8"))["names"]
    except (OSError, ValueError, KeyError, TypeError):
        names = {}
    with atomic_write(state / "plan.json") as part:
        document = {"format": 1, "chunk": size, "names": {**names, **{item.path: item.name for item in inputs}}}
        part.write_text(json.dumps(document, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")


def _forget_others(state: Path, chunks: Sequence[Chunk]) -> None:
    """Remove the chunks of earlier lists, whose outcomes stand in those of this one."""
    own = {chunk.file.parent for chunk in chunks}
    for folder in state.iterdir():
        if folder.is_dir() and folder not in own:
            shutil.rmtree(folder, ignore_errors=True)
