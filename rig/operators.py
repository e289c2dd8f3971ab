"""Whoever puts things under the beam and moves the card before it: the person at the keyboard, or the simulated one."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import time
from typing import Protocol

from bssrdf.errors import DeviceError
from bssrdf.rig.interrupts import Interrupts
from bssrdf.rig.plan_toml import Subject

_OPERATOR_S = 1800.0
_UNSAFE_S = 60.0
"""How long the person is waited for where the capture has ended and only the card is missing."""


class Operator(Protocol):
    """Whoever does by hand what no device does."""

    def lay(self, subject: Subject) -> None:
        """Put the sample or the white tile under the beam."""
        ...

    def move_card(self, *, into_beam: bool) -> None:
        """Put a card into the beam, or take it away."""
        ...


class ConsoleOperator:
    """The person at the keyboard, who confirms by Enter."""

    def __init__(self, signals: Interrupts) -> None:
        self._signals = signals

    def lay(self, subject: Subject) -> None:
        self._ask(f"Lay the {subject} under the beam")

    def move_card(self, *, into_beam: bool) -> None:
        self._ask("Put the card into the beam" if into_beam else "Take the card out of the beam")

    def _ask(self, task: str) -> None:
        """Wait until the person has done it; DeviceError where nobody is there, or nobody does."""
        handle = _keyboard()
        limit_s = _UNSAFE_S if self._signals.making_safe else _OPERATOR_S
        with self._signals.at_prompt():
            print(f"{task}, then press Enter.", file=sys.stderr, flush=True)
            answered = None if handle is None else _line(handle, limit_s)
        if answered is None:
            raise DeviceError(
                f"operator: nobody can be asked to {task[0].lower()}{task[1:]}: standard input has ended; "
                "run the capture in a terminal"
            )
        if not answered:
            raise DeviceError(f"operator: nobody confirmed within {limit_s:g} s: {task}; go on with --resume")


class SimulatedOperator:
    """Moves the things on a simulated bench."""

    def __init__(self, world: str) -> None:
        self._world = world

    def lay(self, subject: Subject) -> None:
        self._do("lay", subject)

    def move_card(self, *, into_beam: bool) -> None:
        self._do("close" if into_beam else "open")

    def _do(self, verb: str, *arguments: str) -> None:
        from bssrdf.rig.sim.world_server import WorldClient

        client = WorldClient(self._world)
        getattr(client, verb)(*arguments)
        client.release()


def _keyboard() -> int | None:
    """The handle of standard input, without what was typed before anything was asked; None where there is none."""
    try:
        handle = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        return None
    if os.isatty(handle):
        import termios

        with contextlib.suppress(termios.error):
            termios.tcflush(handle, termios.TCIFLUSH)
    return handle


def _line(handle: int, limit_s: float) -> bool | None:
    """Whether a line came in time; None where the input ended. Byte by byte: the next line is for the next question."""
    deadline = time.monotonic() + limit_s
    while select.select([handle], [], [], max(deadline - time.monotonic(), 0))[0]:
        try:
            byte = os.read(handle, 1)
        except OSError:  # a terminal that was hung up
            return None
        if byte in (b"\n", b"\r"):
            return True
        if not byte:
            return None
    return False
