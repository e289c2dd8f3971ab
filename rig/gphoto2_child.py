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

_NOISE_REDUCTION = ("longexpnr", "d06b")
_OFF = ("Off", "0", "off")
_POLL_S = 0.002


class Child:
    """One camera."""

    def __init__(self) -> None:
        import gphoto2  # an extra: everything else must import without it

        self._gp: Any = gphoto2
        self._camera: Any = None
        self._exposure: str | None = None

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
        for name in _NOISE_REDUCTION:
            if (value := self._get(name)) is not None and value not in _OFF:
                raise ValueError(f"long-exposure noise reduction {name} is {value}; switch it off in the camera")
        if iso:
            self._set("iso", iso)
        shutter = self._camera.get_single_config("shutterspeed")
        version = " ".join(self._get(name) or "" for name in ("manufacturer", "cameramodel", "deviceversion"))
        return {
            "version": version.strip(),
            "exposures": [str(choice) for choice in shutter.get_choices()],
            "settings": {name: self._get(name) for name in ("iso", "imageformat", *_NOISE_REDUCTION)},
        }

    def take(self, exposure: str, part: str, within_s: float) -> dict[str, Any]:
        """One frame into a file `part` + suffix; raises TimeoutError when the camera does not bring it in time."""
        deadline = time.monotonic() + within_s
        if exposure != self._exposure:
            self._set("shutterspeed", exposure)
            self._exposure = exposure
        self._trigger(deadline)
        folder, name = self._new_file(deadline)
        file = self._camera.file_get(folder, name, self._gp.GP_FILE_TYPE_NORMAL)
        path = part + Path(name).suffix.lower()
        file.save(path)
        self._camera.file_delete(folder, name)
        return {"path": path}

    def _trigger(self, deadline: float) -> None:
        while True:
            try:
                self._camera.trigger_capture()
                return
            except self.error as error:
                if error.code != self._gp.GP_ERROR_CAMERA_BUSY or time.monotonic() > deadline:
                    raise
            time.sleep(0.05)

    def _new_file(self, deadline: float) -> tuple[str, str]:
        while time.monotonic() < deadline:
            kind, data = self._camera.wait_for_event(100)
            if kind == self._gp.GP_EVENT_FILE_ADDED:
                return data.folder, data.name
            if kind == self._gp.GP_EVENT_TIMEOUT:
                time.sleep(_POLL_S)
        raise TimeoutError("the camera announced no file in time")

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
        except (child.error, ValueError, OSError) as error:
            answer = {"error": str(error) or type(error).__name__}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
