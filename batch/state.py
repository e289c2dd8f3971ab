"""What a batch remembers: the outcome of each input in the file of its chunk, which is there whole or not at all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import bssrdf
from bssrdf.batch.inputs import BatchInput, Stage
from bssrdf.session import atomic_write

Told = Callable[[Any], None]
"""Is told what a process works on."""
StageKeys = dict[str, str]
"""By stage a digest of all that its result depends on: version, options, and what came before it."""


@dataclass
class InputOutcome:
    """What became of an input."""

    name: str
    path: str
    keys: StageKeys
    failed: tuple[Stage, int, str] | None = None
    """Stage, exit code and line."""
    material: str | None = None
    channels: dict[str, Any] = field(default_factory=dict)
    """As in fit.json."""
    statuses: dict[str, int] = field(default_factory=dict)
    """Of rows of a Parquet file: how many curves came to each."""
    lost: list[tuple[str, int, str]] = field(default_factory=list)
    """Of those rows: name, exit code and line of each slice that failed."""


def stage_keys(signature: str, stages: Sequence[Stage], options: Mapping[str, Any]) -> StageKeys:
    """The key of each stage for an input of this signature; `options` by stage."""
    keys: StageKeys = {}
    so_far = signature
    for stage in stages:
        text = json.dumps([so_far, stage, bssrdf.__version__, options.get(stage)], sort_keys=True, default=str)
        so_far = keys[stage] = hashlib.sha256(text.encode()).hexdigest()
    return keys


def write_chunk(file: Path, outcomes: Sequence[InputOutcome]) -> None:
    """The outcomes of a finished chunk."""
    with atomic_write(file) as part:
        text = json.dumps([asdict(each) for each in outcomes], ensure_ascii=False, separators=(",", ":"))
        part.write_text(text + "\n", encoding="utf-8")


def read_chunk(file: Path) -> list[InputOutcome]:
    """The outcomes that `write_chunk` wrote; none where the file is not there or not whole."""
    try:
        found = [InputOutcome(**each) for each in json.loads(file.read_text(encoding="utf-8"))]
    except (OSError, ValueError, TypeError):
        return []
    return [replace(each, failed=(*each.failed,)) if each.failed else each for each in found]


def is_finished(outcomes: Sequence[InputOutcome], wanted: Sequence[tuple[BatchInput, StageKeys]]) -> bool:
    """Whether these are the outcomes of just these inputs and stages."""
    return [(each.path, each.keys) for each in outcomes] == [(item.path, keys) for item, keys in wanted]
