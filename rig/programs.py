"""Shutter, beam and camera behind programs of the user's own: `driver = "command"`."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from bssrdf.errors import DeviceError
from bssrdf.rig.child import ended_well
from bssrdf.rig.ports import Clock, Identity, ShutterState
from bssrdf.session import ENCODED_SUFFIXES, IMAGE_SUFFIXES, RAW_SUFFIXES, kind_of

DEVICE_S = 10.0
CAMERA_S = 60.0
"""How long a program may take if rig.toml does not say; a camera's beyond its exposure."""


class CommandShutter:
    """Programs open and close it. Nothing closes it when this program is killed."""

    name = "command shutter"
    after_kill = ""

    def __init__(self, to_open: str, to_close: str, *, to_tell: str | None = None, timeout_s: float = DEVICE_S) -> None:
        self._open, self._close, self._state = shlex.split(to_open), shlex.split(to_close), shlex.split(to_tell or "")
        self._timeout_s = timeout_s

    def connect(self) -> Identity:
        self.close()
        return Identity("command", "", shlex.join(self._open))

    def open_for(self, longest_s: float) -> None:
        self._run(self._open)
        if self.state() == "closed":
            raise DeviceError(f"{self.name}: was told to open, but says closed; check lamp, interlock and cable")

    def close(self) -> None:
        self._run(self._close)
        if self.state() == "open":
            raise DeviceError(f"{self.name}: was told to close, but says open; block the beam by hand")

    def state(self) -> ShutterState | None:
        if not self._state:
            return None
        said = self._run(self._state).strip().lower()
        if said in ("open", "closed"):
            return "open" if said == "open" else "closed"
        raise DeviceError(f"{self.name}: {shlex.join(self._state)} printed {said[:60]!r}; it must print open or closed")

    def release(self) -> None:
        pass

    def _run(self, words: list[str]) -> str:
        return ended_well(self.name, words, self._timeout_s)


class CommandBeam:
    """Programs switch it on and off."""

    name = "command beam"

    def __init__(self, on: str, off: str, *, timeout_s: float = DEVICE_S) -> None:
        self._on, self._off, self._timeout_s = shlex.split(on), shlex.split(off), timeout_s

    def connect(self) -> Identity:
        return Identity("command", "", shlex.join(self._on))

    def on(self) -> None:
        ended_well(self.name, self._on, self._timeout_s)

    def off(self) -> None:
        ended_well(self.name, self._off, self._timeout_s)

    def release(self) -> None:
        pass


class CommandCamera:
    """A program that takes one frame; `{exposure_s}` and `{out}` in its words stand for the time and the file."""

    name = "command camera"

    def __init__(
        self, clock: Clock, expose: str, *, exposures_s: tuple[float, ...] = (), timeout_s: float = CAMERA_S
    ) -> None:
        self.overhead_s = timeout_s
        self._clock, self._expose, self._exposures_s = clock, shlex.split(expose), exposures_s

    def connect(self) -> Identity:
        return Identity("command", "", shlex.join(self._expose))

    def exposures_s(self) -> tuple[float, ...]:
        return tuple(sorted(self._exposures_s))

    def settings(self) -> dict[str, str]:
        return {}

    def take(self, exposure_s: float, part: Path, keep_alive: Callable[[], None]) -> Path:
        """Run the program. It leaves its file at `{out}`, with any suffix or none, in a folder that is empty."""
        with tempfile.TemporaryDirectory(
            prefix="part-", dir=part.parent.absolute(), ignore_cleanup_errors=True
        ) as folder:
            out = Path(folder) / "frame"
            stands_for = {"{exposure_s}": decimal(exposure_s), "{out}": str(out)}
            words = [_filled(word, stands_for) for word in self._expose]
            ended_well(self.name, words, exposure_s / self._clock.speed + self.overhead_s, keep_alive)
            file, suffix = frame_among(f"{self.name}: {shlex.join(words)}", sorted(out.parent.iterdir()))
            return file.rename(part.with_name(part.name + suffix))

    def release(self) -> None:
        pass


def decimal(seconds: float) -> str:
    """Seconds without an exponent, which shells and calculators do not read."""
    return f"{seconds:.9f}".rstrip("0").rstrip(".")


def _filled(word: str, stands_for: dict[str, str]) -> str:
    for name, value in stands_for.items():
        word = word.replace(name, value)
    return word


def frame_among(whose: str, files: Sequence[Path]) -> tuple[Path, str]:
    """The frame and its suffix: the one RAW file, else the one image; DeviceError where there is none or no telling."""
    kinds = {file: file.suffix.lower() or kind_of(file) for file in files if not file.name.startswith(".")}
    for wanted in (RAW_SUFFIXES, IMAGE_SUFFIXES, ENCODED_SUFFIXES):
        fitting = [file for file, suffix in kinds.items() if suffix in wanted]
        if len(fitting) > 1:
            names = ", ".join(file.name for file in fitting)
            raise DeviceError(f"{whose} left {names}; one frame is wanted")
        if fitting:
            return fitting[0], kinds[fitting[0]]
    others = ", ".join(file.name for file in files)
    left = f"left {others}, no kind of frame" if others else "left no file at {out}"
    raise DeviceError(f"{whose} {left}; have it write RAW, TIFF or EXR there")
