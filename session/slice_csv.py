"""slice.csv: R_d(r) by channel under a TOML header in `#` lines. Radii in mm, R_d in 1/mm²."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.atomic import atomic_write
from bssrdf.session.checks import known_keys, shown
from bssrdf.session.keys import checked_keys, keys_of, missing_keys
from bssrdf.session.records import Array, ChannelSlice, Slice
from bssrdf.session.slice_units import Columns, column_unit, factor, in_mm
from bssrdf.session.text_file import FORMAT, check_format, csv_text, parse_csv, parse_toml, read_text, toml_table

HEADER = {**keys_of(Slice), **keys_of(Columns)}
"""What may stand above the table: what a slice is, and how its columns are written."""
_COLUMNS = tuple(field.name for field in fields(ChannelSlice))
_NEEDED = ("channel", "r_mm", "rd_per_mm2", "sd_per_mm2")
_ELSEWHERE = ("material", "flags", "provenance")
_MAY_BE_EMPTY = ("sd_per_mm2",)
_LEAST, _MOST = 1e-60, 1e60
"""Sizes of numbers whose squares and products a fit can still hold."""

Lines = NDArray[np.int64]
"""The line of the file that each row stands on."""


def read_slice(path: Path, **overrides: Any) -> Slice:
    """The curve in `path`; `overrides` are keys of its header that win over it, by channel; None is not given."""
    header_text, table_text = _split(read_text(path))
    raw = parse_toml(path, header_text)
    check_format(path, raw.pop("format", FORMAT))
    written = raw.pop("unit", None)
    given = overrides.pop("unit", None) or written
    unit = None if given is None else checked_keys(path, "", {"unit": given}, Columns)["unit"]
    channels = dict(_channels(path, table_text, unit))
    raw |= {key: _over(raw.get(key), value, channels) for key, value in overrides.items() if value is not None}
    header = checked_keys(path, "", raw, Slice)
    if lacking := missing_keys(HEADER, header):
        lines = toml_table(lacking).rstrip().replace("\n", "`, `# ")
        options = " ".join(f"--{key}" for key in lacking)
        raise InputError(f"{path}: lacks {', '.join(lacking)}; add lines such as `# {lines}`, or give {options}")
    for key in (name for name, declared in HEADER.items() if declared.by_channel and name in header):
        if isinstance(header[key], float):
            header[key] = dict.fromkeys(channels, header[key])
        known_keys(path, f"channel in {key} ", header[key], channels)
    return Slice(channels=channels, **header)


def write_slice(path: Path, curve: Slice) -> None:
    """Write `curve` so that `read_slice` gives it back to the last bit."""
    header = {key: getattr(curve, key) for key in keys_of(Slice) if key != "provenance"}
    document = toml_table({"format": FORMAT} | {key: value for key, value in header.items() if value not in ({}, ())})
    if curve.provenance:
        document += "[provenance]\n" + toml_table(curve.provenance)
    columns = [name for name in _COLUMNS if any(getattr(part, name) is not None for part in curve.channels.values())]
    rows: list[Iterable[str]] = [["channel", *columns]]
    for channel, part in curve.channels.items():
        rows += zip(repeat(channel), *(_texts(part, name) for name in columns), strict=False)
    commented = "".join(f"# {line}\n" for line in document.rstrip("\n").split("\n"))
    with atomic_write(path) as unfinished:
        unfinished.write_text(commented + csv_text(rows), encoding="utf-8", newline="")


def about(curve: Slice) -> dict[str, Any]:
    """The keys that only inform, as far as they were given: they go with the result. Some have a place of their own."""
    keys = (name for name, declared in keys_of(Slice).items() if declared.key.informational)
    return {
        name: value for name in keys if name not in _ELSEWHERE and (value := getattr(curve, name)) not in (None, {})
    }


def _over(value: Any, override: Any, channels: Iterable[str]) -> Any:
    """The override; one for some channels leaves the value of the others as it is."""
    if value is None or not isinstance(override, Mapping):
        return override
    return {**(value if isinstance(value, Mapping) else dict.fromkeys(channels, value)), **override}


def _split(content: str) -> tuple[str, str]:
    """The TOML header and the CSV table, each with the other's lines empty, so that line numbers stay the file's."""
    lines = content.split("\n")
    header = [line[1:] if line.startswith("#") and not line.startswith("##") else "" for line in lines]
    table = ["" if line.startswith("#") else line for line in lines]
    return "\n".join(header).rstrip(), "\n".join(table)


def _channels(path: Path, content: str, unit: str | None) -> Iterator[tuple[str, ChannelSlice]]:
    """The channels in the order in which they first appear; lengths are in `unit`, in mm if None."""
    table = parse_csv(path, _in_mm(path, content, unit), ["channel", *_COLUMNS], _NEEDED)
    if not table.rows:
        raise InputError(f"{path}: holds no row below its header; add {','.join(_NEEDED)} of each point")
    lines = np.array(table.lines)
    texts = dict(zip(table.header, zip(*table.rows, strict=True), strict=True))
    names = np.array([name.strip() for name in texts.pop("channel")])
    _refuse(path, names == "", "channel", names, lines, "must be a name, such as G")
    columns = {name: _numbers(path, name, column, lines) for name, column in texts.items()}
    if unit is not None:
        columns = {name: column * factor(name, unit) for name, column in columns.items()}
    _check_values(path, columns, lines)
    for name in dict.fromkeys(names.tolist()):
        here = names == name
        part = ChannelSlice(**{key: column[here] for key, column in columns.items()})
        _check_ascending(path, name, part, lines[here])
        _check_doubled(path, name, part, lines[here])
        yield name, part


def _in_mm(path: Path, content: str, unit: str | None) -> str:
    """The table with its header's columns named as for mm; InputError where they name another unit than `unit`."""
    lines = content.split("\n")
    at = next((at for at, line in enumerate(lines) if line.strip()), 0)
    names = [name.strip() for name in lines[at].split(",")]
    units = dict.fromkeys(filter(None, (column_unit(name) for name in names if in_mm(name) in _COLUMNS)))
    if len(units) > 1:
        raise InputError(
            f"{path}: has columns in {' and in '.join(units)}; write all lengths in one unit, R_d included"
        )
    for name in names:
        named = column_unit(name)
        if named not in (None, "mm", unit) and in_mm(name) in _COLUMNS:
            remedy = "rename the columns" if unit else f'give --unit {named}, or a line `# unit = "{named}"`'
            raise InputError(f"{path}: column {name} is in {named}, not in {unit or 'mm'}; {remedy}")
    lines[at] = ",".join(in_mm(name) if in_mm(name) in _COLUMNS else name for name in names)
    return "\n".join(lines)


def _numbers(path: Path, name: str, column: Sequence[str], lines: Lines) -> Any:
    """The column as numbers, NaN where it is empty and may be."""
    empty = np.array([name in _MAY_BE_EMPTY and not text.strip() for text in column])
    try:
        values = np.array([float(text or "nan") for text in column])
    except ValueError:
        values = np.array([_number_or_nan(text) for text in column])
    _refuse(path, ~np.isfinite(values) & ~empty, name, column, lines, "must be a finite number")
    limits = f"is out of reach: give 0, or a size from {_LEAST:g} to {_MOST:g}"
    size = np.abs(values)
    _refuse(path, ((size > _MOST) | (size < _LEAST)) & (size != 0), name, column, lines, limits)
    return values


def _number_or_nan(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _check_values(path: Path, columns: dict[str, Any], lines: Lines) -> None:
    def refuse(bad: NDArray[np.bool_], name: str, remedy: str) -> None:
        _refuse(path, bad, name, columns[name], lines, remedy)

    r = columns["r_mm"]
    refuse(r < 0, "r_mm", "must be 0 or more; radii count from the beam outwards")
    refuse(columns["sd_per_mm2"] <= 0, "sd_per_mm2", "must be above 0; leave it empty where it is unknown")
    if ("r_lo_mm" in columns) != ("r_hi_mm" in columns):
        raise InputError(f"{path}: has one of the columns r_lo_mm and r_hi_mm; a bin needs both")
    if "r_lo_mm" in columns:
        lo, hi = columns["r_lo_mm"], columns["r_hi_mm"]
        refuse(lo < 0, "r_lo_mm", "must be 0 or more")
        refuse(hi <= lo, "r_hi_mm", "must be above r_lo_mm")
        refuse((r < lo) | (r > hi), "r_mm", "must lie between r_lo_mm and r_hi_mm")
    if "side" in columns:
        refuse(np.abs(columns["side"]) != 1, "side", "must be -1 or 1")
        columns["side"] = columns["side"].astype(np.int8)


def _check_ascending(path: Path, channel: str, part: ChannelSlice, lines: Lines) -> None:
    for side in [None] if part.side is None else [-1, 1]:
        here = slice(None) if part.side is None else part.side == side
        falls = np.append(False, np.diff(part.r_mm[here]) < 0)
        remedy = f"comes after a larger one in channel {shown(channel)}; sort the rows by radius"
        _refuse(path, falls, "r_mm", part.r_mm[here], lines[here], remedy)


def _check_doubled(path: Path, channel: str, part: ChannelSlice, lines: Lines) -> None:
    """A row that stands twice would count as two measurements and halve the variance."""
    if not np.any(np.diff(np.sort(part.r_mm)) == 0):
        return
    seen: dict[tuple[Any, ...], int] = {}
    columns = [column.tolist() for name in _COLUMNS if (column := getattr(part, name)) is not None]
    for line, row in zip(lines.tolist(), zip(*columns, strict=True), strict=True):
        known = seen.setdefault(tuple(map(repr, row)), line)
        if known != line:
            where = f"r_mm = {row[0]!r} in channel {shown(channel)}"
            raise InputError(f"{path}: line {line} is line {known} again ({where}); take out rows that stand twice")


def _refuse(path: Path, bad: Any, name: str, column: Any, lines: Lines, remedy: str) -> None:
    """InputError for the first bad row, with its line and value."""
    if bad.any():
        at = int(np.argmax(bad))
        value = column[at].item() if isinstance(column, np.ndarray) else column[at]
        raise InputError(f"{path}: line {lines[at]}: {name} = {shown(value)} {remedy}")


def _texts(part: ChannelSlice, name: str) -> list[str]:
    """The column as text in the shortest form that reads back the same; empty where NaN."""
    values: Array | NDArray[np.int8] | None = getattr(part, name)
    if values is None:
        raise ValueError(f"{name} is given for some channels only")
    return ["" if value != value else repr(value) for value in values.tolist()]
