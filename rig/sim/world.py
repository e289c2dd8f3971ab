"""What is true on the simulated bench, whatever the devices say: shutter, beam, interlock, what lies under the beam.

Times are seconds of the bench. The simulated devices act on the world and are told which fault to play.
"""

from __future__ import annotations

import math
from typing import Any

STUCK = ("stuck_open", "stuck_closed")
CAMERA_HABITS = (
    *("raw+jpeg", "jpeg+raw", "jpeg", "stale", "burst", "rounded labels"),
    *("automatic iso", "other iso", "no focus", "automatic focus", "automatic exposure"),
)
"""What a camera does that its user did not mean it to; `camera_process` plays them."""
LASTING = (*STUCK, "interlock", "busy_always", *CAMERA_HABITS)
"""Faults that stay until `clear`; every other is played once."""


class World:
    """State with a history, so that a camera can ask for the light of a time gone by."""

    def __init__(self) -> None:
        self.subject = "sample"
        self._open: list[list[float]] = []
        self._beam: list[list[float]] = [[-math.inf, math.inf]]
        self._faults: dict[str, list[str]] = {}
        self._lasting: set[str] = set()

    def open(self, t: float, until: float | None = None) -> None:
        """Open the shutter, and have it close by itself at `until`; nothing where it is stuck or locked."""
        if "stuck_closed" in self._lasting or "interlock" in self._lasting:
            return
        end = math.inf if until is None or "stuck_open" in self._lasting else until
        if self.is_open(t):
            self._open[-1][1] = end
        else:
            self._open.append([t, end])

    def close(self, t: float) -> None:
        if "stuck_open" not in self._lasting and self.is_open(t):
            self._open[-1][1] = t

    def is_open(self, t: float) -> bool:
        return bool(self._open) and self._open[-1][0] <= t < self._open[-1][1]

    def beam(self, t: float, on: bool) -> None:
        if on != self.beam_on(t):
            if on:
                self._beam.append([t, math.inf])
            else:
                self._beam[-1][1] = t

    def beam_on(self, t: float) -> bool:
        return bool(self._beam) and self._beam[-1][0] <= t < self._beam[-1][1]

    @property
    def interlock(self) -> bool:
        """Whether the interlock is tripped."""
        return "interlock" in self._lasting

    def lit_share(self, start: float, end: float) -> float:
        """Share of the time from `start` to `end` in which light fell on the subject."""
        lit = sum(
            max(0.0, min(end, opened[1], beam[1]) - max(start, opened[0], beam[0]))
            for opened in self._open
            for beam in self._beam
        )
        return min(1.0, lit / (end - start))

    def lay(self, subject: str) -> None:
        """Put the sample or the reference under the beam."""
        self.subject = subject

    def arm(self, t: float, device: str, fault: str) -> None:
        """Have a device play a fault at its next command; a lasting one begins now."""
        if fault not in LASTING:
            self._faults.setdefault(device, []).append(fault)
            return
        self._lasting.add(fault)
        if fault == "interlock" and self.is_open(t):
            self._open[-1][1] = t
        if fault == "stuck_open" and self.is_open(t):
            self._open[-1][1] = math.inf

    def clear(self, t: float) -> None:
        """End every fault; a blade that was stuck open falls shut."""
        was_stuck = "stuck_open" in self._lasting
        self._faults, self._lasting = {}, set()
        if was_stuck:
            self.close(t)

    def fault(self, device: str) -> str | None:
        """The fault that the device is to play now."""
        if device == "camera" and "busy_always" in self._lasting:
            return "busy"
        waiting = self._faults.get(device)
        return waiting.pop(0) if waiting else None

    def habits(self) -> list[str]:
        """What the camera does with every shot, until `clear`."""
        return sorted(self._lasting & set(CAMERA_HABITS))

    def status(self, t: float) -> dict[str, Any]:
        return {
            "open": self.is_open(t),
            "beam": self.beam_on(t),
            "interlock": self.interlock,
            "subject": self.subject,
            "lit": self.is_open(t) and self.beam_on(t),
        }
