"""A key of a file is declared once, at its field: what it means, its limits, and why it is there if nothing uses it.

A field `view_angle_deg: Annotated[float, Key("camera against the surface normal", at_least=0, below=90)] = 45.0` of a
frozen data class is all that there is of a key: what reads and writes files, the options of the command line, the
template of session.toml and the tables in docs/formats.md are made from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache, cached_property
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from bssrdf.session.checks import (
    Check,
    boolean,
    by_channel,
    checked,
    choice,
    list_of,
    matrix3,
    number,
    table,
    text,
    unique,
    whole,
)

_UNITS = {"mm": "mm", "deg": "°", "s": "s", "px": "px", "e": "e⁻", "c": "°C", "nm": "nm", "mm2": "1/mm²"}
"""By the last word of a key's name."""


@dataclass(frozen=True)
class Range:
    """Limits of a number."""

    above: float = -math.inf
    below: float = math.inf
    at_least: float = -math.inf
    at_most: float = math.inf

    def __str__(self) -> str:
        """As a reader wants it: what only keeps a sum from overflowing is left out."""
        above, at_least = (0, -math.inf) if self.at_least == LEAST else (self.above, self.at_least)
        signs = ((">", above), ("≥", at_least), ("<", self.below), ("≤", self.at_most))
        return ", ".join(f"{sign} {limit:g}".replace("-", "−") for sign, limit in signs if abs(limit) < MOST)


LEAST, MOST = 1e-9, 1e6
"""Beyond these a number is a slip, or of another unit, and its square may overflow on the way."""
ANY = Range()
POSITIVE = Range(above=0)
ANGLE = Range(at_least=0, below=90)
COSINE = Range(above=-1, below=1)
SHARE = Range(at_least=0, below=1)
ERROR = Range(at_least=0, at_most=MOST)
LENGTH = Range(at_least=LEAST, at_most=MOST)


@dataclass(frozen=True)
class Key:
    """What is said of a key beside its name, type and default."""

    help: str
    """What it means: a phrase without a full stop."""
    range: Range = ANY
    """Of its number, or of each number in a list or table."""
    unit: str = ""
    """Where its name does not end in it."""
    example: Any = None
    """A value to begin with, where the default is none."""
    ask: bool = False
    """Whether the template gives it a value although there is a default."""
    unless: str = ""
    """It must be given, unless this key of the same table stands in its place."""
    informational: str = ""
    """Why it is there, where no number depends on it."""
    unique: bool = False
    """Whether a list must not name anything twice."""
    check: Check | None = None
    """In place of what type and limits say."""


@dataclass(frozen=True)
class Declared:
    """A key as its field declares it."""

    name: str
    kind: Any
    """Its type, None aside; of several the first."""
    key: Key
    default: Any

    @property
    def needed(self) -> bool:
        return self.default is MISSING or bool(self.key.unless)

    @cached_property
    def by_channel(self) -> bool:
        """Whether it is a number for each channel."""
        return self.kind == dict[str, float]

    @property
    def unit(self) -> str:
        """Of its number, empty where it has none."""
        return self.key.unit or _UNITS.get(self.name.rpartition("_")[2], "")

    @property
    def meaning(self) -> str:
        """What it means, its choices and its unit where its name says none."""
        choices = f" ({self.limits})" if self.limits.startswith('"') and "," in self.limits else ""
        unit = f" [{self.key.unit}]" if self.key.unit and self.key.unit not in self.name else ""
        return self.key.help + choices + unit

    @property
    def example(self) -> Any:
        return self.default if self.key.example is None else self.key.example

    @cached_property
    def check(self) -> Check:
        """Turns a raw value into one of its type, or says what it must be."""
        check = self.key.check or _check_of(self.kind, self.key)
        return (lambda value: () if value == [] else check(value)) if self.default == () else check

    @property
    def limits(self) -> str:
        """Its range or its choices."""
        item = get_args(self.kind)[0] if get_origin(self.kind) is tuple else self.kind
        choices = get_args(item) if get_origin(item) is Literal else ()
        return ", ".join(f'"{choice}"' for choice in choices) or str(self.key.range)


@cache
def keys_of(record: type) -> dict[str, Declared]:
    """The keys that a data class declares, in order; a field without `Key` is none."""
    hints = get_type_hints(record, include_extras=True)
    return {
        field.name: _declared(field.name, hints[field.name], _default(field))
        for field in fields(record)
        if get_origin(hints[field.name]) is Annotated
    }


def missing_keys(keys: Mapping[str, Declared], given: Mapping[str, Any]) -> dict[str, Any]:
    """The keys that must be given and are not, each with an example."""
    return {
        name: declared.example
        for name, declared in keys.items()
        if declared.needed and name not in given and declared.key.unless not in given
    }


def checked_keys(file: Path | str, where: str, raw: Mapping[str, Any], record: type) -> dict[str, Any]:
    """The values of one table, each as the record declares it; InputError naming file, key and value."""
    return checked(file, where, raw, {name: declared.check for name, declared in keys_of(record).items()})


def _default(field: Any) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _declared(name: str, hint: Any, default: Any) -> Declared:
    kind, key = get_args(hint)
    first, *_ = [each for each in get_args(kind) if each is not NoneType] if NoneType in get_args(kind) else [kind]
    return Declared(name, first, key, default)


def _check_of(kind: Any, key: Key) -> Check:
    inside = number(**vars(key.range))
    match get_origin(kind), get_args(kind):
        case origin, choices if origin is Literal:
            return choice(*choices)
        case origin, (row, *_) if origin is tuple and get_origin(row) is tuple:
            return matrix3
        case origin, (item, *_) if origin is tuple:
            return unique(list_of(_check_of(item, key))) if key.unique else list_of(_check_of(item, key))
        case origin, (_, item) if origin is dict:
            return table if item is Any else by_channel(_check_of(item, key))
    checks: dict[Any, Check] = {float: inside, int: whole(inside), bool: boolean, str: text}
    return checks[kind]
