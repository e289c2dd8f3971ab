"""Any other camera: a program of its own takes the frames and drops them into a folder, which is watched."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bssrdf.errors import DeviceError, InputError
from bssrdf.rig.ports import BadShot, Clock, Identity
from bssrdf.session import RAW_SUFFIXES, RawFrame, is_frame_name, read_frame_file

_TICK_S = 0.05
_SHORTEST_PRESS_S = 0.1
"""Cameras that time the exposure themselves overlook a shorter press; in bulb mode the press is the exposure."""
_QUIET_S = 0.5
"""A file that has not grown or changed for this long is looked into."""
_DOUBTFUL_S = 3.0
"""The same for one that may be a dark frame, clipped to zero, or space that is still to be filled."""
_RUN_PX = 32
"""So many zeros side by side, where the camera's black is not zero, are not of the camera."""


class FolderCamera:
    """Takes the next file that appears in the folder. Whatever fills it sets the exposure; the engine checks it.

    With `press`, which holds the camera's release down for so many seconds, the camera needs nobody else to start it.
    """

    def __init__(
        self,
        clock: Clock,
        port: str,
        *,
        exposures_s: tuple[float, ...] = (),
        overhead_s: float = 60.0,
        press: Callable[[float], None] | None = None,
    ) -> None:
        self._press = press
        self.name = f"folder camera on {port}"
        self._folder, self._exposures_s = Path(port), exposures_s
        self._clock, self.overhead_s = clock, overhead_s

    def connect(self) -> Identity:
        if not self._folder.is_dir():
            raise DeviceError(f"{self.name}: there is no such folder; make it, and have the camera's program fill it")
        return Identity("folder", str(self._folder), "")

    def exposures_s(self) -> tuple[float, ...]:
        return self._exposures_s

    def settings(self) -> dict[str, str]:
        return {}

    def take(self, exposure_s: float, part: Path, keep_alive: Callable[[], None]) -> Path:
        there = set(_frames(self._folder))
        limit_s = exposure_s / self._clock.speed + self.overhead_s
        deadline = time.monotonic() + limit_s
        watched: dict[Path, _Watched] = {}
        if self._press is not None:
            self._press(max(exposure_s, _SHORTEST_PRESS_S))
        while time.monotonic() < deadline:
            keep_alive()
            new = [file for file in _frames(self._folder) if file not in there]
            watched = {file: _watch(file, watched.get(file)) for file in new}
            whole = [file for file, seen in watched.items() if seen.is_whole()]
            if len(whole) > 1:
                names = ", ".join(file.name for file in whole)
                raise BadShot(f"{self.name}: {names} came at once; no telling which is of this shot")
            if whole and all(seen.is_settled() for seen in watched.values()):
                target = part.with_name(part.name + whole[0].suffix.lower())
                shutil.copyfile(whole[0], target)
                return target
            time.sleep(_TICK_S)
        raise DeviceError(
            f"{self.name}: {_what_came(watched)} within {limit_s:.3g} s; is the camera's program running?"
        )

    def release(self) -> None:
        pass


class _Watched(NamedTuple):
    """A new file as it was last seen."""

    size: int
    changed_ns: int
    since: float
    lacks: str | None = None
    """Why it is not whole; None where it was not looked into yet."""
    doubtful: bool = False

    def is_settled(self) -> bool:
        return self.lacks is not None

    def is_whole(self) -> bool:
        return self.lacks == "" and (not self.doubtful or time.monotonic() - self.since > _DOUBTFUL_S)


def _frames(folder: Path) -> list[Path]:
    """Files with the name of a frame; RAW alone where each is there twice, as RAW and as an image."""
    files = [file for file in folder.iterdir() if is_frame_name(file)]
    raw = {file.stem for file in files if file.suffix.lower() in RAW_SUFFIXES}
    return [file for file in files if file.suffix.lower() in RAW_SUFFIXES or file.stem not in raw]


def _watch(file: Path, before: _Watched | None) -> _Watched:
    """Look again: into the file as well, once it has been quiet."""
    now = time.monotonic()
    try:
        found = file.stat()
    except FileNotFoundError:  # renamed, or taken away
        return _Watched(0, 0, now)
    if before is None or (before.size, before.changed_ns) != (found.st_size, found.st_mtime_ns):
        return _Watched(found.st_size, found.st_mtime_ns, now)
    if before.lacks is not None or now - before.since < _QUIET_S:
        return before
    try:
        frame = read_frame_file(file)
    except (InputError, OSError) as error:
        return before._replace(lacks=str(error))
    empty = has_empty_space(frame)
    black_is_zero = frame.black is None or not np.all(np.asarray(frame.black) > 0)
    lacks = f"{file}: part of it is empty" if empty and not black_is_zero else ""
    return before._replace(lacks=lacks, doubtful=empty)


def has_empty_space(frame: RawFrame) -> bool:
    """Whether the data hold a stretch of zeros, as space has that was reserved and not written yet."""
    zero = (frame.data == 0).ravel()
    return bool(zero[: zero.size // _RUN_PX * _RUN_PX].reshape(-1, _RUN_PX).all(axis=1).any())


def _what_came(watched: dict[Path, _Watched]) -> str:
    if not watched:
        return "no new frame (a file that is written over is not a new one)"
    lacks = next((seen.lacks for seen in watched.values() if seen.lacks), None)
    return f"no whole frame, but {', '.join(file.name for file in watched)} ({lacks or 'still growing'})"
