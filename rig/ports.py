"""What the capture engine needs of a bench: a shutter, a beam, a camera, a clock. Drivers are in modules of their own.

Every call returns or raises DeviceError within a deadline; the message names the device.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, Protocol

from bssrdf.errors import DeviceError

ShutterState = Literal["open", "closed"]


class BadShot(DeviceError):
    """A camera's shot that gave no frame of its own; another may."""


@dataclass(frozen=True)
class Identity:
    """What a device says it is; goes into capture.toml."""

    driver: str
    port: str
    version: str


class ShutterPort(Protocol):
    """Stands before the focusing lens. Closing it again and again is always safe."""

    @property
    def name(self) -> str:
        """Driver and port, for messages."""
        ...

    @property
    def after_kill(self) -> str:
        """What closes the shutter when this program is killed, in plain words; empty where nothing does."""
        ...

    def connect(self) -> Identity:
        """Find the controller, and close."""
        ...

    def open_for(self, longest_s: float) -> None:
        """Open, and have the controller close by itself after `longest_s` where it can."""
        ...

    def close(self) -> None: ...

    def state(self) -> ShutterState | None:
        """As the controller reports it; None where it cannot tell."""
        ...

    def release(self) -> None:
        """Give the port back; the shutter stays as it is."""
        ...


class BeamPort(Protocol):
    """The lamp, LED or laser."""

    @property
    def name(self) -> str: ...

    def connect(self) -> Identity: ...

    def on(self) -> None: ...

    def off(self) -> None: ...

    def release(self) -> None: ...


class CameraPort(Protocol):
    """Takes one frame at a time and leaves it in a file."""

    @property
    def name(self) -> str: ...

    @property
    def overhead_s(self) -> float:
        """What it may take beyond an exposure before it counts as hung."""
        ...

    def connect(self) -> Identity: ...

    def exposures_s(self) -> tuple[float, ...]:
        """Exposure times it can be set to, ascending; empty where another program sets them."""
        ...

    def settings(self) -> dict[str, str]:
        """What must not change in a session: lens, ISO, file format."""
        ...

    def take(self, exposure_s: float, part: Path, keep_alive: Callable[[], None]) -> Path:
        """Expose for `exposure_s`; the file returned is `part` with the suffix of its format added, such as ".dng".

        `keep_alive` is called a few times per second while the camera is waited for.
        """
        ...

    def release(self) -> None: ...


class Clock(Protocol):
    """Time on the bench."""

    @property
    def speed(self) -> float:
        """Seconds of the bench in a second of ours: above 1 on a simulated bench only."""
        ...

    def sleep(self, seconds: float) -> None: ...

    def utc(self) -> str: ...


@dataclass(frozen=True)
class BenchClock:
    """The clock on the wall; a simulated bench runs `speed` times faster."""

    speed: float = 1.0

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds / self.speed)

    def utc(self) -> str:
        return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
