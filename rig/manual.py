"""A shutter and a lamp without a wire: a person moves a card before the beam; the lamp has a switch of its own."""

from __future__ import annotations

from bssrdf.rig.operators import Operator
from bssrdf.rig.ports import Identity, ShutterState


class ManualShutter:
    """A card that a person moves when asked; asked only where it must be moved."""

    name = "manual shutter"
    after_kill = ""

    def __init__(self, operator: Operator) -> None:
        self._operator = operator
        self._state: ShutterState | None = None

    def connect(self) -> Identity:
        self.close()
        return Identity("manual", "", "")

    def open_for(self, longest_s: float) -> None:
        self._move("open")

    def close(self) -> None:
        self._move("closed")

    def state(self) -> ShutterState | None:
        """As the person last confirmed it."""
        return self._state

    def release(self) -> None:
        """What was confirmed is believed no longer: the next move is asked for whatever it is."""
        self._state = None

    def _move(self, wanted: ShutterState) -> None:
        if self._state == wanted:
            return
        self._state = None
        self._operator.move_card(into_beam=wanted == "closed")
        self._state = wanted


class ManualBeam:
    """A lamp that is on as long as its own switch says so."""

    name = "manual beam"

    def connect(self) -> Identity:
        return Identity("manual", "", "")

    def on(self) -> None:
        pass

    def off(self) -> None:
        pass

    def release(self) -> None:
        pass
