"""Cameras that libgphoto2 drives, each in a child process that is given a deadline for every request."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bssrdf.errors import DeviceError
from bssrdf.rig.ports import BadShot, Clock, Identity

CONNECT_S = 20.0
_TICK_S = 0.1
_LEAST = 0.8
"""Share of an exposure that has passed before its file can be there; labels of times are rounded by up to 7 %."""
_EXPOSURE = re.compile(r"(?P<number>\d+(?:\.\d+)?(?:e-?\d+)?)(?:/(?P<over>[1-9]\d*(?:\.\d+)?))?(?P<unit>[sm]?)")
_QUOTED = re.compile(r'(\d+)"(\d)?')


class Gphoto2Camera:
    """A camera by libgphoto2; `port` as it lists it ("usb:001,004", "ptpip:192.168.1.1"), or the first one found."""

    def __init__(
        self,
        clock: Clock,
        port: str | None = None,
        *,
        model: str | None = None,
        iso: str | None = None,
        overhead_s: float = 10.0,
    ) -> None:
        self.name = f"gphoto2 camera on {port or 'any port'}"
        self._clock, self.overhead_s = clock, overhead_s
        self._port, self._model, self._iso = port, model, iso
        self._child: subprocess.Popen[bytes] | None = None
        self._choices: dict[float, str] = {}
        self._settings: dict[str, str] = {}

    def connect(self) -> Identity:
        if importlib.util.find_spec("gphoto2") is None:
            raise DeviceError(f"{self.name}: python-gphoto2 is not installed; pip install 'bssrdf[camera]'")
        self.release()
        self._child = subprocess.Popen(
            [sys.executable, "-m", "bssrdf.rig.gphoto2_child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # a Ctrl-C for us is not one for the camera
            bufsize=0,
        )
        told = self._request("connect", CONNECT_S, port=self._port, model=self._model, iso=self._iso)
        self._choices = {seconds: text for text in told["exposures"] if (seconds := exposure_seconds(text))}
        self._settings = dict(told["settings"])
        return Identity("gphoto2", self._port or "", told["version"])

    def exposures_s(self) -> tuple[float, ...]:
        return tuple(sorted(self._choices))

    def settings(self) -> dict[str, str]:
        return self._settings

    def take(self, exposure_s: float, part: Path, keep_alive: Callable[[], None]) -> Path:
        if self._child is None:
            self.connect()
        limit_s = exposure_s / self._clock.speed + self.overhead_s
        told = self._request(
            "take",
            limit_s + 1,
            keep_alive,
            exposure=self._choices[exposure_s],
            part=str(part),
            least_s=_LEAST * exposure_s / self._clock.speed,
            within_s=limit_s,
        )
        return Path(told["path"])

    def release(self) -> None:
        """End the child; the camera closes its session by itself."""
        child, self._child = self._child, None
        if child is None:
            return
        child.kill()
        child.wait()
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                pipe.close()

    def _request(
        self, verb: str, limit_s: float, keep_alive: Callable[[], None] | None = None, **arguments: Any
    ) -> dict[str, Any]:
        """The child's answer. DeviceError where it refuses, dies, or is not done in `limit_s`; then it is ended."""
        assert self._child is not None
        assert self._child.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._child.stdin.write(json.dumps([verb, arguments]).encode() + b"\n")
        try:
            line = self._line(verb, limit_s, keep_alive)
        except BaseException:
            self.release()
            raise
        answer = json.loads(line)
        if answer.get("again"):
            raise BadShot(f"{self.name}: {answer['error']}")
        if "error" in answer:
            self.release()
            raise DeviceError(f"{self.name}: {verb} failed: {answer['error']}")
        return dict(answer["ok"])

    def _line(self, verb: str, limit_s: float, keep_alive: Callable[[], None] | None) -> bytes:
        assert self._child is not None
        assert self._child.stdout is not None
        deadline = time.monotonic() + limit_s
        line = b""
        while not line.endswith(b"\n"):
            if time.monotonic() > deadline:
                raise DeviceError(f"{self.name}: no answer to {verb} within {limit_s:.3g} s; switch it off and on")
            ready, _, _ = select.select([self._child.stdout], [], [], _TICK_S)
            if ready:
                more = self._child.stdout.read(65536)
                if not more:
                    code = self._child.wait()
                    raise DeviceError(f"{self.name}: its process ended ({code}) during {verb}; try again")
                line += more
            if keep_alive is not None:
                keep_alive()
        return line


def exposure_seconds(text: str) -> float | None:
    """Seconds in a camera's own words: "0.0010s", "0,0002s", "1/250", "2m", 0"4, 1"; None for bulb and the like."""
    words = text.strip().replace(",", ".")
    if quoted := _QUOTED.fullmatch(words):
        return float(f"{quoted[1]}.{quoted[2] or 0}") or None
    match = _EXPOSURE.fullmatch(words)
    if match is None or (match["over"] == match["number"] and len(match["over"]) > 3):
        return None  # 65535/65535 is bulb, in PTP's own number
    seconds = float(match["number"]) / float(match["over"] or 1) * (60 if match["unit"] == "m" else 1)
    return seconds if 0 < seconds < math.inf else None
