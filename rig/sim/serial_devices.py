"""Shutter controllers as they behave on their serial line: stateful, and refusing what the devices refuse."""

from __future__ import annotations

from typing import Protocol

from bssrdf.rig.sim.scpi_device import Scpi
from bssrdf.rig.sim.world_server import WorldClient


class SerialDevice(Protocol):
    """Takes bytes apart into commands and carries them out on the world."""

    banner: bytes

    def take(self, incoming: bytes) -> tuple[bytes | None, bytes]:
        """The first whole command of what has come in, if there is one, and the rest."""
        ...

    def execute(self, command: bytes) -> tuple[bytes, bytes]:
        """Carry out a command; its echo and its reply."""
        ...

    def idle(self) -> None:
        """Called when no byte has come for a while."""
        ...


class Sc10:
    """Thorlabs SC10: CR, echo, prompt; `ens` toggles; in mode 3 the blade closes after `open=` milliseconds."""

    banner = b""

    def __init__(self, world: WorldClient) -> None:
        self._world = world
        self._mode = 1
        self._open_ms = 500

    def take(self, incoming: bytes) -> tuple[bytes | None, bytes]:
        command, end, rest = incoming.partition(b"\r")
        return (command, rest) if end else (None, incoming)

    def execute(self, command: bytes) -> tuple[bytes, bytes]:
        answer = self._answer(command.decode("ascii", "replace"))
        return command + b"\r", (answer.encode() + b"\r" if answer else b"") + b"> "

    def idle(self) -> None:
        pass

    def _answer(self, command: str) -> str:
        verb, _, value = command.partition("=")
        if verb in ("mode", "open") and value:
            return self._set(verb, value)
        answers = {
            "id?": lambda: "THORLABS SC10 VERSION 1.07",
            "ens": self._toggle,
            "ens?": lambda: str(int(self._enabled)),
            "closed?": lambda: str(int(not self._world.is_open())),
            "interlock?": lambda: str(int(self._world.status()["interlock"])),
            "mode?": lambda: str(self._mode),
            "open?": lambda: str(self._open_ms),
        }
        return answers[command]() if command in answers else "Command error CMD_NOT_DEFINED"

    def _set(self, verb: str, value: str) -> str:
        limits = {"mode": (1, 5), "open": (1, 999_999)}
        low, high = limits[verb]
        if not value.isdigit() or not low <= int(value) <= high:
            return "Command error CMD_ARG_INVALID"
        if verb == "mode":
            self._mode = int(value)
        else:
            self._open_ms = int(value)
        return ""

    _ends = 0.0

    @property
    def _enabled(self) -> bool:
        return self._world.now() < self._ends

    def _toggle(self) -> str:
        if self._enabled:
            self._ends = 0.0
            self._world.close()
        elif not self._world.status()["interlock"]:
            for_s = self._open_ms / 1000 if self._mode == 3 else None
            self._ends = self._world.now() + (for_s or 1e12)
            self._world.open(for_s)
        return ""


class Uniblitz:
    """Uniblitz VMM: one byte a command, no reply ever."""

    banner = b""

    def __init__(self, world: WorldClient) -> None:
        self._world = world

    def take(self, incoming: bytes) -> tuple[bytes | None, bytes]:
        return (incoming[:1], incoming[1:]) if incoming else (None, b"")

    def execute(self, command: bytes) -> tuple[bytes, bytes]:
        if command == b"@":
            self._world.open()
        elif command == b"A":
            self._world.close()
        return b"", b""

    def idle(self) -> None:
        pass


DEVICES: dict[str, type[Sc10] | type[Uniblitz] | type[Scpi]] = {"sc10": Sc10, "uniblitz": Uniblitz, "scpi": Scpi}
