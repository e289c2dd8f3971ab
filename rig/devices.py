"""The devices that rig.toml names, connected or reported together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from bssrdf.errors import DeviceError
from bssrdf.rig.drivers import Bench, find
from bssrdf.rig.interrupts import Interrupts
from bssrdf.rig.operators import ConsoleOperator, Operator, SimulatedOperator
from bssrdf.rig.ports import BeamPort, BenchClock, CameraPort, Clock, Identity, ShutterPort
from bssrdf.rig.rig_toml import Rig


@dataclass(frozen=True)
class Devices:
    """A bench, ready to be connected."""

    shutter: ShutterPort
    beam: BeamPort
    camera: CameraPort
    clock: Clock
    operator: Operator
    by_hand: bool
    """Whether a person is the shutter."""
    pings: tuple[Callable[[], object], ...]
    """What to call now and then while the camera works: controllers with a watchdog want to hear of us."""

    def connect(self) -> dict[str, Identity]:
        """Connect each device; DeviceError with what every one of them has to say, if any fails."""
        found, failures = {}, []
        parts: dict[str, ShutterPort | BeamPort | CameraPort] = {
            "shutter": self.shutter,
            "beam": self.beam,
            "camera": self.camera,
        }
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


def devices_of(rig: Rig, signals: Interrupts | None = None) -> Devices:
    """The drivers, not yet connected; `signals` as they are handled while a person is asked."""
    operator = SimulatedOperator(rig.world) if rig.world else ConsoleOperator(signals or Interrupts())
    parts = {"shutter": rig.shutter, "beam": rig.beam}
    bench = Bench(BenchClock(rig.speed), operator, {"file": rig.file, "parts": parts})
    shutter, beam = find("shutter", rig.shutter.driver), find("beam", rig.beam.driver)
    the_shutter, the_beam = shutter.make(bench, dict(rig.shutter.keys)), beam.make(bench, dict(rig.beam.keys))
    pings: list[Callable[[], object]] = [lambda: the_shutter.state()] if shutter.kept_alive else []
    if beam.ping and not (shutter.kept_alive and rig.beam.keys.get("port") == rig.shutter.keys.get("port")):
        pings.append(partial(beam.ping, the_beam))
    return Devices(
        the_shutter,
        the_beam,
        find("camera", rig.camera.driver).make(bench, dict(rig.camera.keys)),
        bench.clock,
        operator,
        by_hand=shutter.by_hand,
        pings=tuple(pings),
    )


def ports_of(rig: Rig) -> set[str]:
    """What a capture holds alone: the ports of its devices, and its rig.toml, since not every device has a port."""
    parts = (rig.shutter, rig.beam, rig.camera)
    return {str(rig.file.resolve()), *(str(part.keys["port"]) for part in parts if "port" in part.keys)}
