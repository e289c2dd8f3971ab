"""The simulated world in the test's own process."""

from __future__ import annotations

from typing import Any

from bssrdf.rig.sim.world import World


class NearWorld:
    """The world in this process, at a time that the test sets."""

    def __init__(self) -> None:
        self.world, self.t = World(), 0.0

    def now(self) -> float:
        return self.t

    def open(self, for_s: float | None = None) -> None:
        self.world.open(self.t, None if for_s is None else self.t + for_s)

    def close(self) -> None:
        self.world.close(self.t)

    def is_open(self) -> bool:
        return self.world.is_open(self.t)

    def beam(self, on: bool) -> None:
        self.world.beam(self.t, on)

    def lit_share(self, start: float, end: float) -> float:
        return self.world.lit_share(start, end)

    def status(self) -> dict[str, Any]:
        return self.world.status(self.t)
