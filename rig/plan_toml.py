"""plan.toml: what to capture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from bssrdf.errors import InputError
from bssrdf.session import checked_table, records_of
from bssrdf.session.checks import known_keys, shown
from bssrdf.session.keys import Key, Range, checked_keys, keys_of
from bssrdf.session.records import Material
from bssrdf.session.text_file import FORMAT, check_format, parse_toml, read_text

Subject = Literal["sample", "reference"]
Order = Literal["alternating", "blocks"]


_TIME = Range(above=0, at_most=3600)


@dataclass(frozen=True)
class ExposurePlan:
    """`[exposures]` of plan.toml: one of three ways to say which."""

    list_s: Annotated[tuple[float, ...] | None, Key("these exposure times", _TIME, unique=True)] = None
    first_s: Annotated[float | None, Key("from this one, with last_s and steps_stops", _TIME)] = None
    last_s: Annotated[float | None, Key("to this one", _TIME)] = None
    steps_stops: Annotated[float | None, Key("apart from each other by", Range(above=0, at_most=10), unit="stops")] = (
        None
    )
    auto: Annotated[bool, Key("chosen by metering shots")] = False


@dataclass(frozen=True)
class CapturePlan:
    """What to capture. Exposure times are as asked for; the camera has its own."""

    material: Material
    kinds: Annotated[tuple[Subject, ...], Key("what to take", unique=True)] = ("sample", "reference")
    list_s: tuple[float, ...] = ()
    """Exposure times; empty where metering shots are to choose them (`auto`)."""
    repeats: Annotated[int, Key("frames of each exposure", Range(at_least=1, at_most=100))] = 1
    settle_s: Annotated[
        float, Key("wait after the shutter has opened, before the camera is released", Range(at_least=0, at_most=60))
    ] = 0.1
    order: Annotated[Order, Key("a dark follows each frame, or all darks of a subject follow all its frames")] = (
        "alternating"
    )
    drift_check: Annotated[bool, Key("take the first frames once more at the end")] = True


def read_plan(file: Path) -> CapturePlan:
    """The plan in the file; InputError names file, key and value."""
    document = parse_toml(file, read_text(file))
    check_format(file, document.pop("format", FORMAT))
    known_keys(file, "", document, [*keys_of(CapturePlan), "material", "exposures"])
    tables = {name: _table(file, document, name) for name in ("material", "exposures")}
    material = records_of(file, {"material": checked_table(file, "material", tables["material"])}, ())["material"]
    exposures = _exposures(file, checked_keys(file, "[exposures] ", tables["exposures"], ExposurePlan))
    top = checked_keys(file, "", document, CapturePlan)
    return CapturePlan(material, list_s=exposures, **top)


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
