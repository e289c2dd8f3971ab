"""The project's own drivers, as its entry points name them: their keys in rig.toml, and how they are made."""

from __future__ import annotations

import shlex
from typing import Any

from bssrdf.errors import InputError
from bssrdf.rig.drivers import Bench, Driver
from bssrdf.rig.folder_camera import FolderCamera
from bssrdf.rig.gphoto2_camera import Gphoto2Camera
from bssrdf.rig.manual import ManualBeam, ManualShutter
from bssrdf.rig.programs import CommandBeam, CommandCamera, CommandShutter
from bssrdf.rig.sc10 import Sc10Shutter
from bssrdf.rig.scpi import ScpiBeam, ScpiController, ScpiShutter
from bssrdf.rig.uniblitz import UniblitzShutter
from bssrdf.session.checks import Check, list_of, number, text

SECONDS = number(above=0, at_most=3600)


def program(value: Any) -> str:
    """Words of a program to run, as a shell would split them; nothing else of a shell is done."""
    line = text(value)
    try:
        words = shlex.split(line)
    except ValueError as error:
        raise ValueError(f"must be a program and its arguments ({str(error).lower()})") from error
    if not words:
        raise ValueError("must be a program and its arguments")
    return line


def exposing(value: Any) -> str:
    """The same, for a camera."""
    line = program(value)
    if "{out}" not in line or "{exposure_s}" not in line:
        raise ValueError("must hold {exposure_s} and {out}, the time to expose and the file to write")
    return line


_PORT: dict[str, Check] = {"port": text, "timeout_s": SECONDS}
_SCPI: dict[str, Check] = {**_PORT, "boot_s": SECONDS, "watchdog_s": SECONDS}


def _controller(bench: Bench, keys: dict[str, Any]) -> ScpiController:
    """Shutter and beam on one port share their controller, made with the keys of both."""
    controllers: dict[str, ScpiController] = bench.shared.setdefault("scpi", {})
    if keys["port"] not in controllers:
        controllers[keys["port"]] = ScpiController(**_of_both(bench, keys))
    return controllers[keys["port"]]


def _of_both(bench: Bench, keys: dict[str, Any]) -> dict[str, Any]:
    """The keys of a controller, and what the other part on its port adds; InputError where the two differ."""
    both = dict(keys)
    for name, part in bench.shared.get("parts", {}).items():
        if part.driver != "scpi" or part.keys["port"] != keys["port"]:
            continue
        for key in _SCPI.keys() & part.keys.keys():
            if both.setdefault(key, part.keys[key]) != part.keys[key]:
                raise InputError(
                    f"{bench.shared['file']}: [{name}] {key} = {part.keys[key]} is not the {both[key]} of the other "
                    f"part on {keys['port']}, which is one controller; give it once"
                )
    return both


def _scpi_beam(bench: Bench, keys: dict[str, Any]) -> ScpiBeam:
    own = {name: value for name, value in keys.items() if name != "level"}
    return ScpiBeam(_controller(bench, own), keys.get("level", 1.0))


def _folder_camera(bench: Bench, keys: dict[str, Any]) -> FolderCamera:
    own = dict(keys)
    port = own.pop("release", None)
    if port is None:
        return FolderCamera(bench.clock, **own)
    controllers: dict[str, ScpiController] = bench.shared.get("scpi", {})
    if port not in controllers:
        raise InputError(
            f"{bench.shared['file']}: [camera] release = {port!r} is not the port of a controller; "
            "give that of [shutter] or [beam] with the driver scpi"
        )
    return FolderCamera(bench.clock, press=controllers[port].press_release, **own)


def _command_shutter(bench: Bench, keys: dict[str, Any]) -> CommandShutter:
    words = {"open": "to_open", "close": "to_close", "state": "to_tell"}
    return CommandShutter(**{words.get(name, name): value for name, value in keys.items()})


SC10 = Driver({**_PORT, "blade_s": SECONDS}, lambda bench, keys: Sc10Shutter(**keys), required=("port",))
UNIBLITZ = Driver(_PORT, lambda bench, keys: UniblitzShutter(**keys), required=("port",))
SCPI_SHUTTER = Driver(_SCPI, lambda bench, keys: ScpiShutter(_controller(bench, keys)), required=("port",))
SCPI_BEAM = Driver(
    {**_SCPI, "level": number(at_least=0, at_most=1)}, _scpi_beam, required=("port",), ping=ScpiBeam.ping
)
MANUAL_SHUTTER = Driver({}, lambda bench, keys: ManualShutter(bench.operator), by_hand=True, kept_alive=False)
MANUAL_BEAM = Driver({}, lambda bench, keys: ManualBeam())
COMMAND_SHUTTER = Driver(
    {"open": program, "close": program, "state": program, "timeout_s": SECONDS},
    _command_shutter,
    required=("open", "close"),
    kept_alive=False,
)
COMMAND_BEAM = Driver(
    {"on": program, "off": program, "timeout_s": SECONDS},
    lambda bench, keys: CommandBeam(**keys),
    required=("on", "off"),
)
COMMAND_CAMERA = Driver(
    {"expose": exposing, "exposures_s": list_of(SECONDS), "timeout_s": SECONDS},
    lambda bench, keys: CommandCamera(bench.clock, **keys),
    required=("expose",),
)
GPHOTO2 = Driver(
    {"port": text, "model": text, "iso": text, "overhead_s": SECONDS},
    lambda bench, keys: Gphoto2Camera(bench.clock, **keys),
)
FOLDER = Driver(
    {"port": text, "exposures_s": list_of(SECONDS), "overhead_s": SECONDS, "release": text},
    _folder_camera,
    required=("port",),
)
