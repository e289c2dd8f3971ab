"""rig.toml: with what to capture. Drivers and ports, and the tables of session.toml that go into every session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bssrdf.errors import InputError
from bssrdf.session.checks import (
    Check,
    check_format,
    checked,
    choice,
    known_keys,
    list_of,
    number,
    parse_toml,
    read_text,
    text,
)
from bssrdf.session.records import FORMAT, Beam, Camera, Geometry, Reference
from bssrdf.session.session_toml import TABLES

_SECONDS = number(above=0, at_most=3600)

DRIVERS: dict[str, dict[str, dict[str, Check]]] = {
    "shutter": {
        "sc10": {"port": text, "timeout_s": _SECONDS, "blade_s": _SECONDS},
        "uniblitz": {"port": text, "timeout_s": _SECONDS},
        "scpi": {"port": text, "timeout_s": _SECONDS, "boot_s": _SECONDS, "watchdog_s": _SECONDS},
    },
    "beam": {
        "manual": {},
        "scpi": {"port": text, "timeout_s": _SECONDS, "boot_s": _SECONDS, "watchdog_s": _SECONDS, "level": number()},
    },
    "camera": {
        "gphoto2": {"port": text, "model": text, "iso": text, "overhead_s": _SECONDS, "frame_mb": number(above=0)},
        "folder": {
            "port": text,
            "exposures_s": list_of(_SECONDS),
            "overhead_s": _SECONDS,
            "frame_mb": number(above=0),
        },
    },
}
"""Keys of each driver. The port of a `folder` camera is the folder."""
_REQUIRED = {"sc10": ["port"], "uniblitz": ["port"], "scpi": ["port"], "folder": ["port"]}


@dataclass(frozen=True)
class Part:
    """One device: its driver and the driver's keys."""

    driver: str
    keys: dict[str, Any]


@dataclass(frozen=True)
class Rig:
    """A bench."""

    shutter: Part
    beam: Part
    camera: Part
    session_tables: dict[str, Any]
    """`camera`, `geometry`, `beam`, `reference`: records that go into every session.toml."""
    world: str | None = None
    """Socket of the simulated world; None on a real bench."""
    speed: float = 1.0
    """How much faster than the clock a simulated bench runs."""


def read_rig(file: Path) -> Rig:
    """The bench that the file describes; InputError names file, key and value."""
    document = parse_toml(file, read_text(file))
    check_format(file, document.pop("format", FORMAT))
    known_keys(file, "", document, [*DRIVERS, "geometry", "reference", "simulated"])
    for name, table in document.items():
        if not isinstance(table, dict):
            raise InputError(f"{file}: {name} must be a table; write [{name}] and its keys below")
    for name in ("shutter", "camera", "geometry", "reference"):
        if name not in document:
            raise InputError(f"{file}: lacks the table [{name}]; add it")
    document.setdefault("beam", {"driver": "manual"})
    parts = {name: _part(file, name, document[name]) for name in DRIVERS}
    simulated = checked(file, "[simulated] ", document.get("simulated", {}), {"world": text, "speed": _SECONDS})
    records: dict[str, type] = {"camera": Camera, "geometry": Geometry, "beam": Beam, "reference": Reference}
    tables = {name: _record(file, name, record, document[name]) for name, record in records.items()}
    return Rig(parts["shutter"], parts["beam"], parts["camera"], tables, **simulated)


def _part(file: Path, name: str, table: dict[str, Any]) -> Part:
    """The driver's share of a table that it shares with session.toml's keys."""
    drivers = DRIVERS[name]
    driver = checked(file, f"[{name}] ", {"driver": table.get("driver", "")}, {"driver": choice(*drivers)})["driver"]
    static = TABLES.get(name, (None, {}))[1]
    known_keys(file, f"[{name}] ", table, ["driver", *drivers[driver], *static])
    keys = {key: value for key, value in table.items() if key in drivers[driver]}
    for key in _REQUIRED.get(driver, []):
        if key not in keys:
            raise InputError(f"{file}: [{name}] lacks {key}; the driver {driver} needs it")
    return Part(driver, checked(file, f"[{name}] ", keys, drivers[driver]))


def _record(file: Path, name: str, record: type, table: dict[str, Any]) -> Any:
    checks = TABLES[name][1]
    own = {key: value for key, value in table.items() if key in checks}
    try:
        return record(**checked(file, f"[{name}] ", own, checks))
    except TypeError as error:
        raise InputError(f"{file}: [{name}] is incomplete ({error}); add the key") from error
