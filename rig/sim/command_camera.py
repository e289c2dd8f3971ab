"""A simulated camera as a program: `python -m bssrdf.rig.sim.command_camera SCENE WORLD SPEED EXPOSURE_S OUT`.

Beside the scene lies `photo_currents.npz`, made from it once. Faults that the world may have it play: fails, killed,
late, no_file, truncated_file, wrong_exposure.
"""

from __future__ import annotations

import json
import sys
import time
import zlib
from pathlib import Path

import numpy as np

from bssrdf.rig.sim.command_shutter import disturbed
from bssrdf.rig.sim.raw_files import dng_bytes
from bssrdf.rig.sim.sensor import SimSensor, expose
from bssrdf.rig.sim.world_server import WorldClient

CURRENTS = "photo_currents.npz"


def main(scene_path: str, world_path: str, speed: str, exposure: str, out: str) -> None:
    """Take one frame."""
    world, scene = WorldClient(world_path, float(speed)), json.loads(Path(scene_path).read_text(encoding="utf-8"))
    fault, exposure_s = world.fault("camera"), float(exposure)
    disturbed(fault)
    if fault == "no_file":
        return
    if fault == "wrong_exposure":
        exposure_s /= 2
    start = world.now()
    time.sleep(exposure_s / world.speed)
    lit = world.lit_share(start, start + exposure_s)
    subject = str(world.status()["subject"])
    content = _frame(scene, Path(scene_path).with_name(CURRENTS), subject, exposure_s, lit)
    Path(out).write_bytes(content[: len(content) // 3] if fault == "truncated_file" else content)


def _frame(scene: dict, currents: Path, subject: str, exposure_s: float, lit: float) -> bytes:
    """The same frame each time for the same exposure of the same light."""
    sensor = SimSensor(**scene["sensor"])
    seed = [scene["seed"], zlib.crc32(f"{subject} {exposure_s:.4f} {lit:.3f}".encode())]
    with np.load(currents) as light:
        dn = expose(sensor, lit * light[subject], exposure_s, np.random.default_rng(seed))
    return dng_bytes(dn, sensor, exposure_s)


if __name__ == "__main__":
    main(*sys.argv[1:])
