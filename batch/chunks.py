"""A chunk of a batch: done by a kept process, one by one where its inputs end that together, and kept in a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bssrdf.batch.child import KeptProcess, ProcessDiedError
from bssrdf.batch.inputs import BatchInput, Stage
from bssrdf.batch.stages import StageOptions
from bssrdf.batch.state import InputOutcome, StageKeys, Told, write_chunk


class Chunk(NamedTuple):
    """Inputs that are finished, done again or lost together."""

    file: Path
    """Of their outcomes."""
    inputs: tuple[tuple[BatchInput, InputOutcome | None, StageKeys], ...]
    """With what an earlier run made of each, and what its stages now depend on."""
    out: Path
    stages: tuple[Stage, ...]
    options: StageOptions


def do_chunk(chunk: Chunk, child: KeptProcess, told: Told) -> int:
    """Do the chunk and write its file; how many inputs, or rows of a Parquet file, it had."""
    write_chunk(chunk.file, _outcomes(chunk, child, told))
    return sum(item.size for item, _, _ in chunk.inputs)


def _outcomes(chunk: Chunk, child: KeptProcess, told: Told) -> list[InputOutcome]:
    try:
        return _asked(chunk, chunk.inputs, child, told)
    except ProcessDiedError as error:
        if len(chunk.inputs) > 1:
            return [each for one in chunk.inputs for each in _outcomes(chunk._replace(inputs=(one,)), child, told)]
        (item, _, _) = chunk.inputs[0]
        line = f"{item.path}: {error}; look at it by itself, or give workers more memory, and run the batch again"
        # without keys it is tried again next time
        return [InputOutcome(item.name, item.path, {}, failed=(chunk.stages[0], error.exit_code, line))]


def _asked(chunk: Chunk, inputs: Sequence[Any], child: KeptProcess, told: Told) -> list[InputOutcome]:
    task = {
        "task": "stages",
        "inputs": inputs,
        "out": str(chunk.out),
        "stages": chunk.stages,
        "options": chunk.options,
    }
    outcomes: list[InputOutcome] = child.ask(task, told)
    return outcomes
