"""rig.toml: with what to capture. Drivers and ports, and the tables of session.toml that go into every session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bssrdf.errors import InputError
from bssrdf.rig.drivers import PARTS, PartName, find, names
from bssrdf.session.checks import Check, checked, choice, known_keys, number, text
from bssrdf.session.records import Beam, Camera, Geometry, Reference
from bssrdf.session.session_toml import TABLES
from bssrdf.session.text_file import FORMAT, check_format, parse_toml, read_text

_SECONDS = number(above=0, at_most=3600)
_OF_EVERY: dict[PartName, dict[str, Check]] = {"shutter": {}, "beam": {}, "camera": {"frame_mb": number(above=0)}}
"""Keys that go with any driver."""


@dataclass(frozen=True)
class Part:
    """One device: its driver and the driver's keys."""

    driver: str
    keys: dict[str, Any]
    """The driver's own."""


@dataclass(frozen=True)
class Rig:
    """A bench."""

    file: Path
    shutter: Part
    beam: Part
    camera: Part
    session_tables: dict[str, Any]
    """`camera`, `geometry`, `beam`, `reference`: records that go into every session.toml."""
    world: str | None = None
    """Socket of the simulated world; None on a real bench."""
    frame_mb: float = 30.0
    """What a frame takes on the disk."""
    speed: float = 1.0
    """How much faster than the clock a simulated bench runs."""


def read_rig(file: Path) -> Rig:
    """The bench that the file describes; InputError names file, key and value."""
    document = parse_toml(file, read_text(file))
    check_format(file, document.pop("format", FORMAT))
    known_keys(file, "", document, [*PARTS, "geometry", "reference", "simulated"])
    for name, table in document.items():
        if not isinstance(table, dict):
            raise InputError(f"{file}: {name} must be a table; write [{name}] and its keys below")
    for name in ("shutter", "camera", "geometry", "reference"):
        if name not in document:
            raise InputError(f"{file}: lacks the table [{name}]; add it")
    document.setdefault("beam", {"driver": "manual"})
    parts = {name: _part(file, name, document[name]) for name in PARTS}
    common = {key: parts["camera"].keys.pop(key) for key in _OF_EVERY["camera"] if key in parts["camera"].keys}
    simulated = checked(file, "[simulated] ", document.get("simulated", {}), {"world": text, "speed": _SECONDS})
    records: dict[str, type] = {"camera": Camera, "geometry": Geometry, "beam": Beam, "reference": Reference}
    tables = {name: _record(file, name, record, document[name]) for name, record in records.items()}
    return Rig(file, parts["shutter"], parts["beam"], parts["camera"], tables, **common, **simulated)


def _part(file: Path, name: PartName, table: dict[str, Any]) -> Part:
    """The driver's share of a table that it shares with session.toml's keys."""
    called = {"driver": table.get("driver", "")}
    driver = checked(file, f"[{name}] ", called, {"driver": choice(*names(name))})["driver"]
    try:
        found = find(name, driver)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    own = {**found.keys, **_OF_EVERY[name]}
    known_keys(file, f"[{name}] ", table, ["driver", *own, *TABLES.get(name, (None, {}))[1]])
    keys = {key: value for key, value in table.items() if key in own}
    for key in found.required:
        if key not in keys:
            raise InputError(f"{file}: [{name}] lacks {key}; the driver {driver} needs it")
    return Part(driver, checked(file, f"[{name}] ", keys, own))


def _record(file: Path, name: str, record: type, table: dict[str, Any]) -> Any:
    checks = TABLES[name][1]
    own = {key: value for key, value in table.items() if key in checks}
    try:
        return record(**checked(file, f"[{name}] ", own, checks))
    except TypeError as error:
        raise InputError(f"{file}: [{name}] is incomplete ({error}); add the key") from error
