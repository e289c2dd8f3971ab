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
from bssrdf.batch.stages import StageOptions, result_of
from bssrdf.batch.state import InputOutcome, is_finished, read_chunk, stage_keys
from bssrdf.batch.sums import failures_of, write_sums
from bssrdf.errors import UsageError
from bssrdf.session import atomic_write, make_folder

MEASURED, PLAIN, BULK = 4, 256, 2048
"""Inputs in a chunk: with frames, of which each takes seconds; without, which the fit takes together; and slices of
Parquet files, for which nothing but the fit is written."""
_WAIT_S = 5.0
"""For a batch that is about to end."""
Progress = Callable[[str, int, int], None]


class BatchResult(NamedTuple):
    """All outcomes in the order of the inputs, and what there was to do."""

    outcomes: list[InputOutcome]
    unit: str
    """What is counted: sessions, or the curves of Parquet files."""
    total: int
    skipped: int
    """Done before."""

    @property
    def failures(self) -> list[str]:
        return [line for each in self.outcomes for *_, line in failures_of(each)]


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
    how many inputs, or slices of a Parquet file, are finished, redone or lost together: a few with frames, many
    without, if None. `cluster`
    is `local:N` or the address of a Dask scheduler; `memory` [bytes] is what a worker may take. An input that fails
    is an outcome with its error. Raises InputError or UsageError where there is nothing to do or nowhere to write.
    """
    inputs = find_inputs(what, stages, chunk or BULK)
    state = _opened(out)
    with _locked(out, state):
        inputs = _named_as_before(inputs, state)
        size = 1 if inputs[0].rows else chunk or (MEASURED if {"ingest", "measure"} & set(stages) else PLAIN)
        wanted = _wanted(inputs, stages, options, progress)
        chunks = _chunks(out, state, wanted, stages, options, size)
        _write_plan(state, inputs, size)
        todo = [chunk for chunk in chunks if not _is_finished(chunk)]
        unit, total = "curves" if inputs[0].rows else "inputs", sum(item.size for item in inputs)
        done = total - sum(item.size for chunk in todo for item, _, _ in chunk.inputs)
        pace = _Pace(done, total, unit, progress)
        if cluster is None:
            _here(todo, memory, pace)
        else:
            from bssrdf.batch.cluster import on_cluster

            for count in on_cluster(cluster, todo, memory):
                pace.more(count)
        outcomes = [outcome for chunk in chunks for outcome in read_chunk(chunk.file)]
        write_sums(out, outcomes, bulk=inputs[0].rows is not None)
        _forget_others(out, state, chunks)
    return BatchResult(outcomes, unit, total, done)


def _is_finished(chunk: Chunk) -> bool:
    """Whether an earlier run did all of it on the same, and its results are still there."""
    outcomes = read_chunk(chunk.file)
    if not is_finished(outcomes, [(item, keys) for item, _, keys in chunk.inputs]):
        return False
    return all(
        result_of(chunk.out, item, stage).exists()
        for (item, _, _), outcome in zip(chunk.inputs, outcomes, strict=True)
        for stage in (() if outcome.failed else chunk.stages)
        if stage != "ingest"
    )


def _here(todo: Sequence[Chunk], memory: float | None, pace: _Pace) -> None:
    child = KeptProcess(os.cpu_count() or 1, memory)
    try:
        for chunk in todo:
            pace.more(do_chunk(chunk, child, pace.tell))
    finally:
        child.close()


class _Pace:
    """How far the batch is, in words."""

    def __init__(self, done: int, total: int, unit: str, progress: Progress | None) -> None:
        self._done, self._total, self._unit, self._new, self._progress = done, total, unit, 0, progress
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
            self._progress(f"{rate:.3g} {self._unit}/s, {left} {name[:30]}".rstrip(), self._done, self._total)


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
        wanted.append((item, stage_keys(signature(item.file), stages, by_stage)))
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


def _forget_others(out: Path, state: Path, chunks: Sequence[Chunk]) -> None:
    """Remove the chunks of earlier lists, whose outcomes stand in those of this one, and their files of fits."""
    if chunks[0].inputs[0][0].rows:
        results = {result_of(out, item, "fit") for chunk in chunks for item, _, _ in chunk.inputs}
        for file in {*(out / "fits").glob("*.parquet")} - results:
            file.unlink()
    own = {chunk.file.parent for chunk in chunks}
    for folder in state.iterdir():
        if folder.is_dir() and folder not in own:
            shutil.rmtree(folder, ignore_errors=True)
