"""What a kept process is asked to do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from bssrdf.batch.stages import run_stages
from bssrdf.batch.state import InputOutcome, Told


def stages_task(task: dict[str, Any], told: Told) -> list[InputOutcome]:
    """The outcomes of some inputs."""
    return run_stages(task["inputs"], Path(task["out"]), task["stages"], task["options"], begun=told)


def walk_task(task: dict[str, Any], told: Told) -> Any:
    """The scores of one batch of white Monte Carlo."""
    from bssrdf.transport import batches

    return batches(task["g"], task["etas"], task["per_batch"], task["index"], seed=task["seed"])


TASKS: dict[str, Callable[[dict[str, Any], Told], Any]] = {"stages": stages_task, "walk": walk_task}
