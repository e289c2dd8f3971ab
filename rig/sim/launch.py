"""Start the simulated bench: a world, a shutter controller, a camera, each in its own process, and its rig.toml."""

from __future__ import annotations

import os
import select
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bssrdf.errors import DeviceError
from bssrdf.rig.sim.command_camera import CURRENTS
from bssrdf.rig.sim.scene import BRACKET_S, BenchScene, write_scene
from bssrdf.rig.sim.world_server import WorldClient
from bssrdf.session.text_file import toml_table

_START_S = 30.0
_REPLY_S = 0.3
SCALE_REL_SD = 0.002
TILE_SD = 0.001
"""What rig.toml states as the errors of the scale, relative, and of the tile's reflectance."""
VIEW_ANGLE_SD_DEG = 0.2
_OVERHEAD_S = 2.0
_COMMAND_S = 8.0
_WITHOUT_PROCESS = ("manual", "command")
"""Parts that run only when they are asked for something."""
_VERBS = ("open", "close", "state", "on", "off")
_WATCHDOG_S = 1.5
"""Of our time, however fast the bench runs."""


class SimulatedBench:
    """The processes of one bench, in a folder of its own."""

    def __init__(
        self,
        folder: Path,
        scene: BenchScene,
        *,
        shutter: str = "sc10",
        camera: str = "gphoto2",
        speed: float = 20.0,
        controller: Sequence[str | Path] = (),
    ) -> None:
        """`controller` is a program that plays the shutter in place of this package's, given link, world and speed."""
        self._controller = controller
        self.folder, self.speed, self._shutter, self._camera = folder, speed, shutter, camera
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._socket = folder / "world"
        self._camera_port = 0
        self.scene_file = folder / "scene.json"
        write_scene(self.scene_file, scene)
        try:
            self.start("world")
            self.world = WorldClient(self._socket, speed)
            for part in self.with_process:
                self.start(part)
            if camera == "command":
                np.savez(folder / CURRENTS, **scene.photo_currents())  # type: ignore[arg-type]  # names to arrays
        except BaseException:
            self.stop()
            raise
        self.rig_file = folder / "rig.toml"
        self.rig_file.write_text(self._rig_toml(scene), encoding="utf-8")

    @property
    def with_process(self) -> tuple[str, ...]:
        """Parts beside the world that are processes of their own."""
        parts = {"shutter": self._shutter, "camera": self._camera}
        return tuple(part for part, driver in parts.items() if driver not in _WITHOUT_PROCESS)

    def start(self, part: str) -> None:
        """Start one process, or start it again after it was ended."""
        if part in self._processes:
            self.end(part)
        processes: dict[str, tuple[str, list[object]]] = {
            "world": ("world_server", [self._socket]),
            "shutter": ("serial_process", [self._shutter, self.folder / "shutter", self._socket, self.speed]),
            "camera": ("camera_process", [self.scene_file, self._socket, self.speed, self._camera_port]),
        }
        module, arguments = processes[part]
        words = [sys.executable, "-m", f"bssrdf.rig.sim.{module}", *map(str, arguments)]
        if part == "shutter" and self._controller:
            words = [*map(str, self._controller), *map(str, arguments[1:])]
        process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        self._processes[part] = process
        assert process.stdout is not None
        ready, _, _ = select.select([process.stdout], [], [], _START_S)
        said = process.stdout.readline().strip() if ready else ""
        if not said:
            raise DeviceError(f"simulated {part}: did not start within {_START_S:g} s; see {' '.join(words)}")
        if part == "camera":
            self._camera_port = int(said)

    def end(self, part: str) -> None:
        """Kill one process."""
        process = self._processes.pop(part)
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()

    def alive(self, part: str) -> bool:
        return part in self._processes and self._processes[part].poll() is None

    def stop(self) -> None:
        if hasattr(self, "world"):
            self.world.release()
        for part in list(self._processes):
            self.end(part)

    def _rig_toml(self, scene: BenchScene) -> str:
        shutter, beam = self._shutter_tables()
        view = scene.view
        geometry: dict[str, Any] = {"view_angle_deg": view.view_angle_deg, "view_axis": view.view_axis}
        geometry |= {"view_angle_sd_deg": VIEW_ANGLE_SD_DEG, "mm_per_px_rel_sd": SCALE_REL_SD}
        if scene.perspective:
            geometry["homography"] = view.homography().tolist()
        else:
            geometry["mm_per_px"] = view.mm_per_px * (1 + scene.scale_error)
        tables = {
            "shutter": shutter,
            "beam": {**beam, "kind": "white", "spot_radius_mm": scene.spot_radius_mm},
            "camera": {
                **self._camera_table(),
                "frame_mb": 2 * scene.sensor.height_px * scene.sensor.width_px / 1e6,
            },
            "geometry": geometry,
            "reference": {
                "name": scene.tile.name,
                "reflectance": [factor * (1 + scene.tile_error) for factor in scene.radiance_factors(scene.tile)],
                "reflectance_sd": (TILE_SD,) * len(scene.tile.media),
                "coplanar": True,
            },
            "simulated": {"world": str(self._socket), "speed": self.speed},
        }
        return "\n".join(f"[{name}]\n{toml_table(table)}" for name, table in tables.items())

    def _shutter_tables(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Drivers of shutter and beam, and their keys."""
        serial: dict[str, Any] = {"driver": self._shutter, "port": str(self.folder / "shutter"), "timeout_s": _REPLY_S}
        lamp: dict[str, Any] = {"driver": "manual"}
        if self._shutter == "scpi":
            return {**serial, "watchdog_s": _WATCHDOG_S * self.speed}, serial
        if self._shutter == "command":
            do = {verb: self._words("command_shutter", self._socket, self.speed, verb) for verb in _VERBS}
            own = {"driver": "command", "timeout_s": _COMMAND_S}
            return (
                {**own, **{verb: do[verb] for verb in ("open", "close", "state")}},
                {**own, **{verb: do[verb] for verb in ("on", "off")}},
            )
        return ({"driver": "manual"} if self._shutter == "manual" else serial), lamp

    def _camera_table(self) -> dict[str, Any]:
        if self._camera == "command":
            arguments = (self.scene_file, self._socket, self.speed, "{exposure_s}", "{out}")
            words = self._words("command_camera", *arguments)
            return {"driver": "command", "expose": words, "exposures_s": BRACKET_S, "timeout_s": _COMMAND_S}
        return {
            "driver": "gphoto2",
            "port": f"ptpip:127.0.0.1:{self._camera_port}:{self._camera_port}",
            "model": "PTP/IP Camera",
            "iso": "100",
            "overhead_s": _OVERHEAD_S,
        }

    def _words(self, module: str, *arguments: object) -> str:
        return shlex.join([sys.executable, "-m", f"bssrdf.rig.sim.{module}", *map(str, arguments)])


@contextmanager
def simulated_bench(scene: BenchScene, *, shutter: str = "sc10", speed: float = 20.0) -> Iterator[SimulatedBench]:
    """A bench in a temporary folder, for as long as the block lasts."""
    if os.name != "posix":
        raise DeviceError("simulated bench: needs ptys, which this system does not have; use Linux or macOS")
    with tempfile.TemporaryDirectory(prefix="bssrdf-") as folder:
        bench = SimulatedBench(Path(folder), scene, shutter=shutter, speed=speed)
        try:
            yield bench
        finally:
            bench.stop()
