"""The devices that rig.toml names, connected or reported together."""

from __future__ import annotations

import select
import sys
from dataclasses import dataclass
from typing import Protocol

from bssrdf.errors import DeviceError
from bssrdf.rig.folder_camera import FolderCamera
from bssrdf.rig.gphoto2_camera import Gphoto2Camera
from bssrdf.rig.plan_toml import Subject
from bssrdf.rig.ports import Beam, BenchClock, Camera, Clock, Identity, Shutter
from bssrdf.rig.rig_toml import Part, Rig
from bssrdf.rig.sc10 import Sc10Shutter
from bssrdf.rig.scpi import ScpiBeam, ScpiController, ScpiShutter
from bssrdf.rig.uniblitz import UniblitzShutter

_OPERATOR_S = 1800.0


class Operator(Protocol):
    """Whoever puts the sample or the white tile under the beam."""

    def lay(self, subject: Subject) -> None: ...


class ConsoleOperator:
    """The person at the keyboard."""

    def lay(self, subject: Subject) -> None:
        print(f"Lay the {subject} under the beam, then press Enter.", file=sys.stderr, flush=True)
        ready, _, _ = select.select([sys.stdin], [], [], _OPERATOR_S)
        if not ready or not sys.stdin.readline():
            raise DeviceError(f"operator: nobody laid the {subject} within {_OPERATOR_S:g} s; go on with --resume")


class SimulatedOperator:
    """Moves the things on a simulated bench."""

    def __init__(self, world: str) -> None:
        self._world = world

    def lay(self, subject: Subject) -> None:
        from bssrdf.rig.sim.world_server import WorldClient

        client = WorldClient(self._world)
        client.lay(subject)
        client.release()


class ManualBeam:
    """A lamp that is on as long as its own switch says so."""

    name = "manual beam"

    def connect(self) -> Identity:
        return Identity("manual", "", "")

    def on(self) -> None:
        pass

    def off(self) -> None:
        pass

    def release(self) -> None:
        pass


@dataclass(frozen=True)
class Devices:
    """A bench, ready to be connected."""

    shutter: Shutter
    beam: Beam
    camera: Camera
    clock: Clock
    operator: Operator

    def connect(self) -> dict[str, Identity]:
        """Connect each device; DeviceError with what every one of them has to say, if any fails."""
        found, failures = {}, []
        parts: dict[str, Shutter | Beam | Camera] = {"shutter": self.shutter, "beam": self.beam, "camera": self.camera}
        for part, device in parts.items():
            try:
                found[part] = device.connect()
            except DeviceError as error:
                failures.append(str(error))
        if failures:
            raise DeviceError("; ".join(failures))
        return found

    def release(self) -> None:
        for device in (self.camera, self.beam, self.shutter):
            device.release()


def devices_of(rig: Rig) -> Devices:
    """The drivers, not yet connected. A shutter and a beam on one SCPI port share its controller."""
    clock = BenchClock(rig.speed)
    shutter, controllers = _shutter(rig.shutter)
    return Devices(
        shutter,
        _beam(rig.beam, controllers),
        _camera(rig.camera, clock),
        clock,
        SimulatedOperator(rig.world) if rig.world else ConsoleOperator(),
    )


def ports_of(rig: Rig) -> set[str]:
    """Ports that a capture holds."""
    return {str(part.keys["port"]) for part in (rig.shutter, rig.beam, rig.camera) if "port" in part.keys}


def _shutter(part: Part) -> tuple[Shutter, dict[str, ScpiController]]:
    if part.driver == "sc10":
        return Sc10Shutter(**part.keys), {}
    if part.driver == "uniblitz":
        return UniblitzShutter(**part.keys), {}
    controller = ScpiController(**part.keys)
    return ScpiShutter(controller), {part.keys["port"]: controller}


def _beam(part: Part, controllers: dict[str, ScpiController]) -> Beam:
    if part.driver == "manual":
        return ManualBeam()
    keys = dict(part.keys)
    level = keys.pop("level", 1.0)
    controller = controllers.get(keys["port"]) or ScpiController(**keys)
    return ScpiBeam(controller, level)


def _camera(part: Part, clock: Clock) -> Camera:
    keys = {key: value for key, value in part.keys.items() if key != "frame_mb"}
    return FolderCamera(clock, **keys) if part.driver == "folder" else Gphoto2Camera(clock, **keys)
