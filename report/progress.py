"""Progress on stderr, for work that takes more than a moment; stdout is for results."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bssrdf.rig import Event, Report


@contextmanager
def steps(*, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A bar that is told what is being done, the steps done and the steps in all."""
    if quiet or not sys.stderr.isatty():
        yield lambda what, done, total: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda what, done, total: bar.update(task, description=what, completed=done, total=total)


@contextmanager
def stages(label: str, *, quiet: bool) -> Iterator[Callable[[str], None]]:
    """A line that is told what is being done now."""
    from rich.console import Console

    with Console(stderr=True, quiet=quiet).status(label) as status:
        yield lambda message: status.update(f"{label}: {message}")


@contextmanager
def live(*, quiet: bool = False) -> Iterator[Report]:
    """A bar for as long as the block lasts; rejected frames and drift stay above it as lines."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = [TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[peak]}{task.fields[left]}")]
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=quiet) as bar:
        task = bar.add_task("connecting", total=None, peak="", left="")

        def show(event: Event) -> None:
            if event.message:
                bar.console.print(f"{event.step.name}: {event.message}", markup=False)
            if event.what == "done":
                bar.update(task, peak=f"peak {100 * event.peak:.0f} %, ")
            bar.update(
                task,
                description=f"{event.number}/{event.total} {event.step.kind} {event.step.exposure_s:g} s",
                completed=event.number - (event.what == "start"),
                total=event.total,
                left=f"{event.left_s:.0f} s left",
            )

        yield show
