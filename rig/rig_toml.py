"""rig.toml: with what to capture. Drivers and ports, and the tables of session.toml that go into every session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from bssrdf.errors import InputError
from bssrdf.rig.drivers import PARTS, PartName, find, names
from bssrdf.session import TABLES, checked_table, records_of
from bssrdf.session.checks import Check, checked, choice, known_keys
from bssrdf.session.keys import POSITIVE, Key, Range, keys_of
from bssrdf.session.records import Geometry
from bssrdf.session.text_file import FORMAT, check_format, parse_toml, read_text


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
    frame_mb: Annotated[float, Key("what a frame takes on the disk", POSITIVE, unit="MB")] = 30.0
    world: Annotated[str | None, Key("socket of a simulated world; none on a real bench")] = None
    speed: Annotated[
        float, Key("how much faster than the clock a simulated bench runs", Range(above=0, at_most=3600))
    ] = 1.0


_OF_EVERY: dict[PartName, dict[str, Check]] = {
    "shutter": {},
    "beam": {},
    "camera": {"frame_mb": keys_of(Rig)["frame_mb"].check},
}
"""Keys that go with any driver."""
_STATIC = ("camera", "geometry", "beam", "reference")
"""Tables of session.toml that go into every session."""


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
    of_simulated = {key: keys_of(Rig)[key].check for key in ("world", "speed")}
    simulated = checked(file, "[simulated] ", document.get("simulated", {}), of_simulated)
    tables = {name: checked_table(file, name, _known(name, document[name])) for name in _STATIC}
    geometry = {"geometry": Geometry(**tables.pop("geometry"))}  # a session's calibration may give its scale
    static = records_of(file, tables, ()) | geometry
    return Rig(file, parts["shutter"], parts["beam"], parts["camera"], static, **common, **simulated)


def _part(file: Path, name: PartName, table: dict[str, Any]) -> Part:
    """The driver's share of a table that it shares with session.toml's keys."""
    called = {"driver": table.get("driver", "")}
    driver = checked(file, f"[{name}] ", called, {"driver": choice(*names(name))})["driver"]
    try:
        found = find(name, driver)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    own = {**found.keys, **_OF_EVERY[name]}
    known_keys(file, f"[{name}] ", table, ["driver", *own, *(keys_of(TABLES[name]) if name in TABLES else ())])
    keys = {key: value for key, value in table.items() if key in own}
    for key in found.required:
        if key not in keys:
            raise InputError(f"{file}: [{name}] lacks {key}; the driver {driver} needs it")
    return Part(driver, checked(file, f"[{name}] ", keys, own))


def _known(name: str, table: dict[str, Any]) -> dict[str, Any]:
    """The share of session.toml."""
    return {key: value for key, value in table.items() if key in keys_of(TABLES[name])}
