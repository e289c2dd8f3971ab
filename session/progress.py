"""How far a long work is, told to whoever shows it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import TypeVar

Progress = Callable[[str, int, int], None]
"""Told what is being done, the steps done and the steps in all."""

T = TypeVar("T")


def counted(items: Collection[T], what: str, progress: Progress | None) -> Iterator[T]:
    """The items, each told as a step that is done once the next one is asked for."""
    for done, item in enumerate(items, 1):
        yield item
        if progress:
            progress(what, done, len(items))
