"""The camera's own process: libgphoto2 can crash or hang, and must not take the shutter with it.

One JSON line asked on stdin, one answered on stdout: {"ok": …} or {"error": "…"}.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from bssrdf.rig.camera_settings import NAMES, unfit
from bssrdf.rig.ports import BadShot
from bssrdf.session import RAW_SUFFIXES

_POLL_S = 0.002
_EVENT_MS = 100
_QUIET_S = 1.0
"""A shot is over when its camera says so, or else when nothing has come for this long after its file."""
_QUEUE_S = 2.0
"""Longest time in which the events of an earlier shot are awaited."""


class Child:
    """One camera."""

    def __init__(self) -> None:
        import gphoto2  # an extra: everything else must import without it

        self._gp: Any = gphoto2
        self._camera: Any = None
        self._exposure: str | None = None
        self._ours: set[str] = set()
        """Names, without suffix, of what our shots have brought."""

    @property
    def error(self) -> Any:
        """The class of what the library raises."""
        return self._gp.GPhoto2Error

    def connect(self, port: str | None, model: str | None, iso: str | None) -> dict[str, Any]:
        """Open the camera, put what it must be set to, and tell what it is and can do."""
        self._camera = self._gp.Camera()
        if model:
            abilities = self._gp.CameraAbilitiesList()
            abilities.load()
            self._camera.set_abilities(abilities[abilities.lookup_model(model)])
        if port:
            ports = self._gp.PortInfoList()
            ports.load()
            self._camera.set_port_info(ports[ports.lookup_path(port)])
        self._camera.init()
        settings = {name: value for name in NAMES if (value := self._get(name)) is not None}
        if problem := unfit(settings, iso_given=bool(iso)):
            raise ValueError(problem)
        if iso:
            self._set("iso", iso)
            settings["iso"] = iso
        self._empty_queue()
        shutter = self._camera.get_single_config("shutterspeed")
        version = " ".join(self._get(name) or "" for name in ("manufacturer", "cameramodel", "deviceversion"))
        return {
            "version": version.strip(),
            "exposures": [str(choice) for choice in shutter.get_choices()],
            "settings": settings,
        }

    def take(self, exposure: str, part: str, least_s: float, within_s: float) -> dict[str, Any]:
        """One frame into a file `part` + suffix; raises TimeoutError when the camera does not bring it in time.

        A file that is announced before the exposure can be over, after `least_s`, is of another shot.
        """
        deadline = time.monotonic() + within_s
        if exposure != self._exposure:
            self._set("shutterspeed", exposure)
            self._exposure = exposure
        self._empty_queue()
        self._trigger(deadline)
        files = self._files_of_shot(time.monotonic() + least_s, deadline)
        raw = [file for file in files if Path(file[1]).suffix.lower() in RAW_SUFFIXES]
        if len(raw) > 1:
            names = ", ".join(name for _, name in raw)
            raise BadShot(f"one shot brought {names}; no telling which is its own: is a bracket or a burst set?")
        if not raw:
            names = ", ".join(name for _, name in files)
            raise ValueError(f"a shot brought {names}, no RAW; set the camera's format to RAW, or RAW + JPEG")
        path = part + Path(raw[0][1]).suffix.lower()
        self._camera.file_get(*raw[0], self._gp.GP_FILE_TYPE_NORMAL).save(path)
        for file in files:
            self._camera.file_delete(*file)
        return {"path": path}

    def _trigger(self, deadline: float) -> None:
        while True:
            try:
                self._camera.trigger_capture()
                return
            except self.error as error:
                if error.code != self._gp.GP_ERROR_CAMERA_BUSY or time.monotonic() > deadline:
                    raise ValueError(f"the camera did not release ({error}); {self._why(error.code)}") from error
            time.sleep(0.05)

    def _why(self, code: int) -> str:
        unclear = (self._gp.GP_ERROR, self._gp.GP_ERROR_CAMERA_ERROR)
        focus = "most often its autofocus found nothing: set lens and camera to manual focus; else "
        return (focus if code in unclear else "") + "check its card and cable, and switch it off and on"

    def _files_of_shot(self, earliest: float, deadline: float) -> list[tuple[str, str]]:
        """Folder and name of every file that a shot brings: RAW and JPEG, in either order."""
        files: list[tuple[str, str]] = []
        complete, last = False, time.monotonic()
        while time.monotonic() < deadline:
            kind, data = self._camera.wait_for_event(_EVENT_MS // 5 if complete else _EVENT_MS)
            now = time.monotonic()
            if kind == self._gp.GP_EVENT_FILE_ADDED and now >= earliest:
                files.append((data.folder, data.name))
                self._ours.add(Path(data.name).stem)
                last = now
            elif kind == self._gp.GP_EVENT_CAPTURE_COMPLETE:
                complete = complete or now >= earliest
            elif kind == self._gp.GP_EVENT_TIMEOUT:
                has_raw = any(Path(name).suffix.lower() in RAW_SUFFIXES for _, name in files)
                if has_raw and (complete or now - last > _QUIET_S):
                    return files
                time.sleep(_POLL_S)
        if not files:
            raise TimeoutError("the camera announced no file in time")
        return files

    def _empty_queue(self) -> None:
        """Forget what the camera tells of earlier shots; what ours have brought late is removed from it."""
        deadline = time.monotonic() + _QUEUE_S
        while time.monotonic() < deadline:
            kind, data = self._camera.wait_for_event(1)
            if kind == self._gp.GP_EVENT_TIMEOUT:
                return
            if kind == self._gp.GP_EVENT_FILE_ADDED and Path(data.name).stem in self._ours:
                self._camera.file_delete(data.folder, data.name)

    def _get(self, name: str) -> str | None:
        try:
            return str(self._camera.get_single_config(name).get_value())
        except self.error:
            return None

    def _set(self, name: str, value: str) -> None:
        """Set, read back, compare: cameras snap to another value without a word."""
        widget = self._camera.get_single_config(name)
        if value not in list(widget.get_choices()):  # set_value of anything else may crash the library
            raise ValueError(f"{name} cannot be {value}; the camera offers {', '.join(widget.get_choices())}")
        widget.set_value(value)
        self._camera.set_single_config(name, widget)
        got = self._get(name)
        if got != value:
            raise ValueError(f"{name} was set to {value}, but the camera says {got}")


def main() -> None:
    """Answer until stdin ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the library prints must not come between
    child = Child()
    for line in sys.stdin:
        verb, arguments = json.loads(line)
        try:
            answer: dict[str, Any] = {"ok": getattr(child, verb)(**arguments)}
        except BadShot as error:
            answer = {"error": str(error), "again": True}
        except ValueError as error:
            answer = {"error": str(error)}
        except (child.error, OSError) as error:
            answer = {"error": f"{error or type(error).__name__}; check the camera, and switch it off and on"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
