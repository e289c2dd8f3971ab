"""Checks of the values that people write: each turns a raw value into ours, or says what it must be."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from bssrdf.errors import InputError

_SHARE_AT_MOST = 1.2
"""A number between 0 and this is a share: who writes 45 means per cent."""
Check = Callable[[Any], Any]
"""Returns the value, normalised; raises ValueError with what it must be."""


def number(
    above: float = -math.inf, below: float = math.inf, *, at_least: float = -math.inf, at_most: float = math.inf
) -> Check:
    """A finite number in the given range."""
    limits = [(">", above), (">=", at_least), ("<", below), ("<=", at_most)]
    is_share = max(above, at_least) == 0 and min(below, at_most) <= _SHARE_AT_MOST
    inside = " and ".join(f"{sign} {limit:g}" for sign, limit in limits if math.isfinite(limit))
    wanted = f"a finite number {inside}".rstrip()

    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"must be {wanted}")
        if is_share and 2 < value <= 100:
            raise ValueError(f"must be a share, not per cent: give {value / 100:g}")
        if not (above < value < below and at_least <= value <= at_most):
            raise ValueError(f"must be {wanted}")
        return float(value)

    return check


def text(value: Any) -> str:
    """A string with something in it."""
    if not isinstance(value, str) or not value.strip():
        raise ValueError("must be a text in quotes")
    return value


def boolean(value: Any) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise ValueError("must be true or false")
    return value


def choice(*names: str) -> Check:
    """One of the names."""

    def check(value: Any) -> str:
        if value not in names:
            raise ValueError(f"must be one of {', '.join(names)}")
        return str(value)

    return check


def list_of(item: Check, size: int | None = None) -> Check:
    """A list with something in it, each item checked; of `size` items where given."""

    def check(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple) or not value or (size is not None and len(value) != size):
            raise ValueError(f"must be a list of {size} values" if size else "must be a list of at least one value")
        return tuple(item(each) for each in value)

    return check


def unique(check: Check) -> Check:
    """The same, and no item twice."""

    def without_repeats(value: Any) -> tuple[Any, ...]:
        items: tuple[Any, ...] = check(value)
        if len(set(items)) < len(items):
            raise ValueError("must not name anything twice")
        return items

    return without_repeats


def by_channel(item: Check) -> Check:
    """One value for all channels, or a table of values by channel, each checked."""

    def check(value: Any) -> Any:
        return {channel: item(each) for channel, each in value.items()} if isinstance(value, Mapping) else item(value)

    return check


def table(value: Any) -> dict[str, Any]:
    """Keys and values of any kind."""
    if not isinstance(value, Mapping):
        raise ValueError("must be a table")
    return dict(value)


def whole(check: Check) -> Check:
    """The same, of a number without a fraction."""

    def without_fraction(value: Any) -> int:
        if (number := check(value)) % 1:
            raise ValueError("must be a whole number")
        return int(number)

    return without_fraction


def time(value: Any) -> str:
    """ISO 8601."""
    try:
        datetime.fromisoformat(value)
    except ValueError as error:
        raise ValueError("must be a time such as 2001-08-12T10:00:00Z") from error
    return str(value)


def levels(value: Any) -> tuple[float, ...]:
    """One number, or several."""
    if len(value) not in (1, 3, 4):
        raise ValueError("must be one number, or one for each place of the pattern, with spaces between them")
    numbers: tuple[float, ...] = list_of(number())(value)
    return numbers


def sha256(value: Any) -> str:
    """A checksum in hexadecimal."""
    if not re.fullmatch("[0-9a-f]{64}", value):
        raise ValueError("must be 64 hexadecimal digits")
    return str(value)


def layout(value: Any) -> str:
    """A colour filter pattern, or a word for having none."""
    if value not in ("mono", "rgb") and not (isinstance(value, str) and re.fullmatch("[RGBCMYEW]{4}", value)):
        raise ValueError('must be a 2x2 colour filter pattern such as "RGGB", or "mono", or "rgb"')
    return str(value)


def backing(value: Any) -> str | float:
    """What lies under a sample: a word, or a diffuse reflectance, which the command line gives as text."""
    try:
        share = float(value)
    except (TypeError, ValueError):
        return text(value)
    if isinstance(value, bool) or not 0 <= share < 1:
        raise ValueError('must be "black", "air", or a diffuse reflectance of at least 0 and below 1')
    return share


def matrix3(value: Any) -> tuple[tuple[float, float, float], ...]:
    """3×3 numbers, not singular."""
    rows: tuple[tuple[float, float, float], ...] = list_of(list_of(number(), 3), 3)(value)
    (a, b, c), (d, e, f), (g, h, i) = rows
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    scale = math.prod(math.hypot(*row) for row in rows)
    if not abs(determinant) > 1e-12 * scale:
        raise ValueError("must be a 3x3 matrix that can be inverted")
    return rows


def checked(file: Path | str, where: str, raw: Mapping[str, Any], checks: Mapping[str, Check]) -> dict[str, Any]:
    """The values of one table by key, checked; InputError naming file, key and value."""
    known_keys(file, where, raw, checks)
    values = {}
    for key, value in raw.items():
        try:
            values[key] = checks[key](value)
        except ValueError as error:
            raise InputError(f"{file}: {where}{key} = {shown(value)} {error}") from error
    return values


def known_keys(file: Path | str, where: str, given: Iterable[str], known: Iterable[str]) -> None:
    """InputError for the first given name that is not a known one, with the nearest, or all where none is near."""
    names = list(known)
    for key in given:
        if key not in names:
            near = difflib.get_close_matches(key, names, n=1)
            remedy = f"did you mean {near[0]}?" if near else f"take one of {', '.join(names)}"
            raise InputError(f"{file}: {where}{shown(key)[1:-1]} is not known; {remedy}")


def shown(value: Any) -> str:
    """The value as one short line of printable characters."""
    line = repr(value)
    return line if len(line) <= 60 else line[:50] + "…" + line[-8:]
