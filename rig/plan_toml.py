"""plan.toml: what to capture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bssrdf.errors import InputError
from bssrdf.session.checks import boolean, checked, choice, known_keys, list_of, number, shown, unique
from bssrdf.session.records import Material
from bssrdf.session.session_toml import TABLES
from bssrdf.session.text_file import FORMAT, check_format, parse_toml, read_text

Subject = Literal["sample", "reference"]
Order = Literal["alternating", "blocks"]


@dataclass(frozen=True)
class Plan:
    """What to capture. Exposure times are as asked for; the camera has its own."""

    material: Material
    kinds: tuple[Subject, ...] = ("sample", "reference")
    list_s: tuple[float, ...] = ()
    """Exposure times; empty where metering shots are to choose them (`auto`)."""
    repeats: int = 1
    settle_s: float = 0.1
    """Wait after the shutter has opened, before the camera is released."""
    order: Order = "alternating"
    """With "alternating" a dark follows each frame, with "blocks" all darks of a subject follow all its frames."""
    drift_check: bool = True


_TOP = {
    "kinds": unique(list_of(choice("sample", "reference"))),
    "repeats": number(at_least=1, at_most=100),
    "settle_s": number(at_least=0, at_most=60),
    "order": choice("alternating", "blocks"),
    "drift_check": boolean,
}
_TIME = number(above=0, at_most=3600)
_EXPOSURES = {
    "list_s": unique(list_of(_TIME)),
    "first_s": _TIME,
    "last_s": _TIME,
    "steps_stops": number(above=0, at_most=10),
    "auto": boolean,
}


def read_plan(file: Path) -> Plan:
    """The plan in the file; InputError names file, key and value."""
    document = parse_toml(file, read_text(file))
    check_format(file, document.pop("format", FORMAT))
    known_keys(file, "", document, [*_TOP, "material", "exposures"])
    tables = {name: _table(file, document, name) for name in ("material", "exposures")}
    material = checked(file, "[material] ", tables["material"], TABLES["material"][1])
    for key in ("name", "eta"):
        if key not in material:
            raise InputError(f"{file}: [material] lacks {key}; add it")
    exposures = _exposures(file, checked(file, "[exposures] ", tables["exposures"], _EXPOSURES))
    top = checked(file, "", document, _TOP)
    if "repeats" in top:
        top["repeats"] = int(top["repeats"])
    return Plan(Material(**material), list_s=exposures, **top)


def _table(file: Path, document: dict[str, Any], name: str) -> dict[str, Any]:
    table = document.pop(name, None)
    if not isinstance(table, dict):
        raise InputError(f"{file}: lacks the table [{name}]; add it")
    return table


def _exposures(file: Path, given: dict[str, Any]) -> tuple[float, ...]:
    """Exposure times in descending order, none for `auto`; exactly one of the three forms must be there."""
    series = {"first_s", "last_s", "steps_stops"}
    forms = [{"list_s"} <= given.keys(), bool(series & given.keys()), bool(given.get("auto"))]
    if sum(forms) != 1:
        raise InputError(
            f"{file}: [exposures] needs one of list_s, auto = true, or first_s with last_s and steps_stops"
        )
    if forms[0]:
        return tuple(sorted(given["list_s"], reverse=True))
    if forms[2]:
        return ()
    if missing := sorted(series - given.keys()):
        raise InputError(f"{file}: [exposures] lacks {missing[0]}; add it")
    low, high = sorted((given["first_s"], given["last_s"]))
    count = round(math.log2(high / low) / given["steps_stops"])
    if count > 200:
        raise InputError(
            f"{file}: [exposures] steps_stops = {shown(given['steps_stops'])} gives {count} steps; widen it"
        )
    return tuple(high / 2 ** (given["steps_stops"] * step) for step in range(count + 1))
