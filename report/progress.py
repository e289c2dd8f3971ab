"""Progress on stderr, for work that takes more than a moment; stdout is for results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def steps(*, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A bar that is told what is being done, the steps done and the steps in all."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, disable=quiet) as bar:
        task = bar.add_task("", total=None)
        yield lambda what, done, total: bar.update(task, description=what, completed=done, total=total)


@contextmanager
def stages(label: str, *, quiet: bool) -> Iterator[Callable[[str], None]]:
    """A line that is told what is being done now."""
    from rich.console import Console

    with Console(stderr=True, quiet=quiet).status(label) as status:
        yield lambda message: status.update(f"{label}: {message}")
