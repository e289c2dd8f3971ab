"""Any other camera: a program of its own takes the frames and drops them into a folder, which is watched."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path

from bssrdf.errors import DeviceError
from bssrdf.rig.ports import Clock, Identity
from bssrdf.session.frame_files import is_frame_name

_TICK_S = 0.05


class FolderCamera:
    """Takes the next file that appears in the folder. Whatever fills it sets the exposure; the engine checks it."""

    def __init__(
        self, clock: Clock, port: str, *, exposures_s: tuple[float, ...] = (), overhead_s: float = 60.0
    ) -> None:
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
        there = set(self._frames())
        deadline = time.monotonic() + exposure_s / self._clock.speed + self.overhead_s
        sizes: dict[Path, int] = {}
        while time.monotonic() < deadline:
            keep_alive()
            for file in set(self._frames()) - there:
                size = file.stat().st_size
                if size and sizes.get(file) == size:
                    target = part.with_name(part.name + file.suffix.lower())
                    shutil.copyfile(file, target)
                    return target
                sizes[file] = size
            time.sleep(_TICK_S)
        raise DeviceError(
            f"{self.name}: no new frame within {exposure_s / self._clock.speed + self.overhead_s:.3g} s; "
            "is the camera's program running?"
        )

    def release(self) -> None:
        pass

    def _frames(self) -> list[Path]:
        return [file for file in self._folder.iterdir() if is_frame_name(file)]
