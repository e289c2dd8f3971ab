"""Ctrl-C and SIGTERM while the shutter may be open: the first Ctrl-C lets the frame end, everything else stops now."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interrupts:
    """What has come in. While `making_safe`, signals are noted and wait."""

    def __init__(self) -> None:
        self.finish_frame = False
        self.making_safe = False
        self._at_prompt = False

    def handle(self, number: int, frame: FrameType | None) -> None:
        stop_now = number == signal.SIGTERM or self.finish_frame or self._at_prompt
        self.finish_frame = True
        if stop_now and not self.making_safe:
            raise KeyboardInterrupt

    @contextmanager
    def at_prompt(self) -> Iterator[None]:
        """While a person is asked no frame is on its way: the first Ctrl-C stops at once."""
        self._at_prompt = True
        try:
            yield
        finally:
            self._at_prompt = False


@contextmanager
def interrupts() -> Iterator[Interrupts]:
    """Handle the signals within the block; off the main thread there are none to handle."""
    state = Interrupts()
    if threading.current_thread() is not threading.main_thread():
        yield state
        return
    before = {number: signal.signal(number, state.handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield state
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def deferred() -> Iterator[None]:
    """Signals that come within the block are handled at its end, so that nothing is begun and then forgotten."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    before = {
        number: signal.signal(number, lambda *what: came.append(what)) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for missed, frame in came:
            handler = before[signal.Signals(missed)]
            if callable(handler):
                handler(missed, frame)
            elif handler == signal.SIG_DFL:
                signal.raise_signal(missed)
