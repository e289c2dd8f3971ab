"""Start the simulated bench: a world, a shutter controller, a camera, each in its own process, and its rig.toml."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bssrdf.errors import DeviceError
from bssrdf.rig.sim.scene import Scene, write_scene
from bssrdf.rig.sim.world_server import WorldClient
from bssrdf.session.toml_text import toml_table

_START_S = 30.0
_REPLY_S = 0.3
SCALE_REL_SD = 0.002
TILE_SD = 0.001
"""What rig.toml states as the errors of the scale, relative, and of the tile's reflectance."""
VIEW_ANGLE_SD_DEG = 0.2
_OVERHEAD_S = 2.0
_WATCHDOG_S = 1.5
"""Of our time, however fast the bench runs."""


class SimulatedBench:
    """The processes of one bench, in a folder of its own."""

    def __init__(self, folder: Path, scene: Scene, *, shutter: str = "sc10", speed: float = 20.0) -> None:
        self.folder, self.speed, self._shutter = folder, speed, shutter
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._socket = folder / "world"
        self._camera_port = 0
        self.scene_file = folder / "scene.json"
        write_scene(self.scene_file, scene)
        try:
            self.start("world")
            self.world = WorldClient(self._socket, speed)
            self.start("shutter")
            self.start("camera")
        except BaseException:
            self.stop()
            raise
        self.rig_file = folder / "rig.toml"
        self.rig_file.write_text(self._rig_toml(scene), encoding="utf-8")

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

    def _rig_toml(self, scene: Scene) -> str:
        serial: dict[str, Any] = {"port": str(self.folder / "shutter"), "timeout_s": _REPLY_S}
        shutter: dict[str, Any] = {"driver": self._shutter, **serial}
        beam: dict[str, Any] = {"driver": "manual"}
        if self._shutter == "scpi":
            shutter["watchdog_s"] = _WATCHDOG_S * self.speed
            beam = {"driver": "scpi", **serial}
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
                "driver": "gphoto2",
                "port": f"ptpip:127.0.0.1:{self._camera_port}:{self._camera_port}",
                "model": "PTP/IP Camera",
                "iso": "100",
                "overhead_s": _OVERHEAD_S,
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


@contextmanager
def simulated_bench(scene: Scene, *, shutter: str = "sc10", speed: float = 20.0) -> Iterator[SimulatedBench]:
    """A bench in a temporary folder, for as long as the block lasts."""
    if os.name != "posix":
        raise DeviceError("simulated bench: needs ptys, which this system does not have; use Linux or macOS")
    with tempfile.TemporaryDirectory(prefix="bssrdf-") as folder:
        bench = SimulatedBench(Path(folder), scene, shutter=shutter, speed=speed)
        try:
            yield bench
        finally:
            bench.stop()
