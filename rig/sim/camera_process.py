"""A simulated camera as a process: `python -m bssrdf.rig.sim.camera_process SCENE WORLD SPEED PORT`.

It speaks PTP/IP, so that the real libgphoto2 drives it, and serves DNGs of what the world lets it see. It prints its
port. Habits that the world may give it:

raw+jpeg, jpeg+raw, jpeg: what it brings of each shot, in this order; without them RAW alone
stale: the first shot after it was connected brings an older frame as well, before its own; burst: each shot does
rounded labels: it offers 1/8000 s and the like, and calls them by whole units of 0.1 ms, as some Nikons do
automatic iso: ISO 400 below 0.1 s, whatever it is set to; other iso: ISO 200 for the sample
no focus: it does not release; automatic focus, automatic exposure: it says that it is set so
"""

from __future__ import annotations

import os
import struct
import sys
import threading
import time
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from bssrdf.rig.sim import ptpip
from bssrdf.rig.sim.ptpip import Answer
from bssrdf.rig.sim.raw_files import dng_bytes
from bssrdf.rig.sim.scene import BRACKET_S, BenchScene, read_scene
from bssrdf.rig.sim.sensor import expose
from bssrdf.rig.sim.world_server import WorldClient

_DNG, _JPEG = 0x3811, 0x3801
_STORE = 0x10001
_EXPOSURE, _ISO, _NOISE_REDUCTION, _FOCUS, _MODE = 0x500D, 0x500F, 0xD06B, 0x500A, 0x500E
_MANUAL, _AUTOMATIC = 1, 2
_UNIT_S = 1e-4
"""PTP gives exposure times in units of 0.1 ms."""
_ROUNDED_S = (1 / 8000, 1 / 4000, 1 / 3200, 1 / 2000, 0.001, 1 / 500, 1 / 250, 1 / 125, 1 / 60, 1 / 30, 1 / 8, 0.5, 2.0)
_UINT8, _UINT16, _UINT32 = 2, 4, 6
_OPERATIONS = [0x1001, 0x1002, 0x1003, 0x1004, 0x1005, 0x1006, 0x1007, 0x1008, 0x1009, 0x100B]
_OPERATIONS += [0x100E, 0x1014, 0x1015, 0x1016]
_LATENCY_S = 0.01
"""Time from the end of an exposure to its file, for us."""


class SimulatedCamera:
    """State of the camera, and what each PTP operation does to it."""

    def __init__(self, scene: BenchScene, world: WorldClient, port: int) -> None:
        self._scene = scene
        self._world = world
        self._currents = scene.photo_currents()
        self._choices = {
            _EXPOSURE: ("I", _UINT32, list(_labelled(BRACKET_S))),
            _ISO: ("H", _UINT16, [100, 200, 400, 800]),
            _NOISE_REDUCTION: ("B", _UINT8, [0, 1]),
            _FOCUS: ("H", _UINT16, [_MANUAL, _AUTOMATIC]),
            _MODE: ("H", _UINT16, [_MANUAL, _AUTOMATIC]),
        }
        self._values = {_EXPOSURE: 80, _ISO: 100, _NOISE_REDUCTION: 0, _FOCUS: _MANUAL, _MODE: _MANUAL}
        self._true_s = _labelled(BRACKET_S)
        self._habits: list[str] = []
        self._files: dict[int, tuple[str, bytes]] = {}
        self._taken = 0
        self.responder = ptpip.Responder(self.operate, "bssrdf camera", port)

    def operate(self, code: int, parameters: list[int], data: bytes, transaction: int) -> Answer:
        handlers = {
            0x1001: lambda: Answer(ptpip.OK, self._device_info()),
            0x1002: self._begin,
            0x1003: lambda: Answer(ptpip.OK),
            0x1004: lambda: Answer(ptpip.OK, ptpip.array([_STORE], "I")),
            0x1005: lambda: Answer(ptpip.OK, _storage_info()),
            0x1006: lambda: Answer(ptpip.OK, None, [len(self._files)]),
            0x1007: lambda: Answer(ptpip.OK, ptpip.array(sorted(self._files), "I")),
            0x1008: lambda: Answer(ptpip.OK, self._object_info(parameters[0])),
            0x1009: lambda: Answer(ptpip.OK, self._files[parameters[0]][1]),
            0x100B: lambda: self._delete(parameters[0]),
            0x100E: lambda: self._capture(transaction),
            0x1014: lambda: self._describe(parameters[0]),
            0x1015: lambda: self._value(parameters[0]),
            0x1016: lambda: self._set(parameters[0], data),
        }
        if code not in handlers:
            return Answer(ptpip.NOT_SUPPORTED)
        try:
            return handlers[code]()
        except KeyError:
            return Answer(ptpip.GENERAL_ERROR)

    def _begin(self) -> Answer:
        """A session is opened: the habits of now are taken on."""
        self._habits, self._shots = self._world.habits(), 0
        self._true_s = _labelled(_ROUNDED_S if "rounded labels" in self._habits else BRACKET_S)
        self._choices[_EXPOSURE] = ("I", _UINT32, list(self._true_s))
        self._values[_EXPOSURE] = next(iter(self._true_s))
        self._values[_FOCUS] = _AUTOMATIC if "automatic focus" in self._habits else _MANUAL
        self._values[_MODE] = _AUTOMATIC if "automatic exposure" in self._habits else _MANUAL
        return Answer(ptpip.OK)

    def _device_info(self) -> bytes:
        return (
            struct.pack("<HIH", 100, 0, 0)
            + ptpip.text("")
            + struct.pack("<H", 0)
            + ptpip.array(_OPERATIONS)
            + ptpip.array([ptpip.OBJECT_ADDED, 0x4006, ptpip.CAPTURE_COMPLETE])
            + ptpip.array(list(self._choices))
            + ptpip.array([_DNG])
            + ptpip.array([_JPEG, _DNG])
            + ptpip.text("bssrdf")
            + ptpip.text("simulated camera")
            + ptpip.text("0.1")
            + ptpip.text("0001")
        )

    def _object_info(self, handle: int) -> bytes:
        name, content = self._files[handle]
        height, width = self._scene.sensor.shape
        numbers = struct.pack(
            "<IHHIHIIIIIIIHII", _STORE, _DNG, 0, len(content), 0, 0, 0, 0, width, height, 16, 0, 0, 0, 0
        )
        when = ptpip.text(time.strftime("%Y%m%dT%H%M%S"))
        return numbers + ptpip.text(name) + when + when + ptpip.text("")

    def _delete(self, handle: int) -> Answer:
        del self._files[handle]
        return Answer(ptpip.OK)

    def _describe(self, code: int) -> Answer:
        form, kind, choices = self._choices[code]
        head = struct.pack(f"<HHB{form}{form}", code, kind, 1, choices[0], self._values[code])
        return Answer(ptpip.OK, head + struct.pack(f"<BH{len(choices)}{form}", 2, len(choices), *choices))

    def _value(self, code: int) -> Answer:
        return Answer(ptpip.OK, struct.pack("<" + self._choices[code][0], self._values[code]))

    def _set(self, code: int, data: bytes) -> Answer:
        value = int.from_bytes(data, "little")
        if value not in self._choices[code][2]:
            return Answer(ptpip.INVALID_VALUE)
        self._values[code] = value
        return Answer(ptpip.OK)

    def _capture(self, transaction: int) -> Answer:
        fault = self._world.fault("camera")
        if "no focus" in self._habits:
            return Answer(ptpip.GENERAL_ERROR)
        if fault == "busy":
            return Answer(ptpip.BUSY)
        if fault == "store_full":
            return Answer(ptpip.STORE_FULL)
        if fault == "crash":
            os._exit(1)
        threading.Thread(target=self._expose, args=(transaction, fault), daemon=True).start()
        return Answer(ptpip.OK)

    def _expose(self, transaction: int, fault: str | None) -> None:
        units = self._values[_EXPOSURE]
        if fault == "wrong_exposure":
            choices = self._choices[_EXPOSURE][2]
            units = choices[choices.index(units) - 1]
        exposure_s = self._true_s[units]
        start = self._world.now()
        time.sleep(exposure_s / self._world.speed)
        lit = self._world.lit_share(start, start + exposure_s)
        content = self._file(exposure_s, lit)
        time.sleep(_LATENCY_S)
        if fault == "truncated_file":
            content = content[: len(content) // 3]
        for prefix, suffix, bytes_of_file in self._brought(exposure_s, content):
            self._taken += 1
            self._files[self._taken] = (f"{prefix}_{self._taken:04d}{suffix}", bytes_of_file)
            if fault != "no_event":
                self.responder.send_event(ptpip.OBJECT_ADDED, transaction, [self._taken])
        if fault != "no_event":
            self.responder.send_event(ptpip.CAPTURE_COMPLETE, transaction, [])

    def _brought(self, exposure_s: float, content: bytes) -> list[tuple[str, str, bytes]]:
        """Beginning and end of the name, and content, of each file of a shot."""
        raw, jpeg = ("SIM", ".DNG", content), ("SIM", ".JPG", _jpeg())
        of_habit = {"raw+jpeg": [raw, jpeg], "jpeg+raw": [jpeg, raw], "jpeg": [jpeg]}
        files = next((of_habit[habit] for habit in self._habits if habit in of_habit), [raw])
        self._shots += 1
        if "burst" in self._habits or ("stale" in self._habits and self._shots == 1):
            files = [("OLD", ".DNG", self._file(exposure_s, 0.7)), *files]
        return files

    def _file(self, exposure_s: float, lit: float) -> bytes:
        subject = str(self._world.status()["subject"])
        seed = [self._scene.seed, zlib.crc32(f"{subject} {exposure_s:.4f} {lit:.3f}".encode())]
        if self._scene.noise == "fresh":
            seed.append(self._taken)
        sensor, iso = self._scene.sensor, self._iso(subject, exposure_s)
        amplified = replace(sensor, gain_e_per_dn=sensor.gain_e_per_dn * self._values[_ISO] / iso)
        dn = expose(amplified, lit * self._currents[subject], exposure_s, np.random.default_rng(seed))
        return dng_bytes(dn, sensor, exposure_s, iso)

    def _iso(self, subject: str, exposure_s: float) -> int:
        if "automatic iso" in self._habits and exposure_s < 0.1:
            return 400
        return 200 if "other iso" in self._habits and subject == "sample" else self._values[_ISO]


def _labelled(times_s: tuple[float, ...]) -> dict[int, float]:
    """True exposure times by the whole units that the camera calls them."""
    return {int(seconds / _UNIT_S + 1e-6): seconds for seconds in times_s}


def _jpeg() -> bytes:
    _, content = cv2.imencode(".jpg", np.full((400, 600, 3), 128, np.uint8))
    return content.tobytes()


def _storage_info() -> bytes:
    return struct.pack("<HHHQQI", 3, 2, 0, 1 << 34, 1 << 33, 9999) + ptpip.text("card") + ptpip.text("card")


if __name__ == "__main__":
    _, scene_path, world_path, bench_speed, tcp_port = sys.argv
    camera = SimulatedCamera(read_scene(Path(scene_path)), WorldClient(world_path, float(bench_speed)), int(tcp_port))
    print(camera.responder.port, flush=True)
    camera.responder.serve()
