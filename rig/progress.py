"""Live progress of a capture on stderr: frame, exposure, peak of the histogram, time left."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bssrdf.rig.capture import Event, Report


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
