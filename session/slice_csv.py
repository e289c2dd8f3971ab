"""slice.csv: R_d(r) by channel under a TOML header in `#` lines. Radii in mm, R_d in 1/mm²."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise, repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.atomic import atomic_write
from bssrdf.session.checks import known_keys
from bssrdf.session.keys import checked_keys, keys_of, missing_keys
from bssrdf.session.records import Array, ChannelSlice, Slice
from bssrdf.session.slice_checks import COLUMNS, MAY_BE_EMPTY, NEEDED, Places, check_curve, check_size, check_values
from bssrdf.session.slice_units import Columns, column_unit, factor, in_mm
from bssrdf.session.text_file import FORMAT, check_format, csv_text, parse_columns, parse_toml, read_text, toml_table

HEADER = {**keys_of(Slice), **keys_of(Columns)}
"""What may stand above the table: what a slice is, and how its columns are written."""
_NEEDED = ("channel", *NEEDED)
_ELSEWHERE = ("material", "flags", "provenance")
_COMMENTS = re.compile(r"(?:#[^\n]*\n?)*")


def read_slice(path: Path, **overrides: Any) -> Slice:
    """The curve in `path`; `overrides` are keys of its header that win over it, by channel; None is not given."""
    header_text, table_text = _split(read_text(path))
    raw = parse_toml(path, header_text)
    check_format(path, raw.pop("format", FORMAT))
    written = raw.pop("unit", None)
    given = overrides.pop("unit", None) or written
    unit = None if given is None else checked_keys(path, "", {"unit": given}, Columns)["unit"]
    channels = dict(_channels(path, table_text, unit))
    return slice_of(path, channels, overridden(raw, overrides, channels))


def slice_of(path: Path | str, channels: dict[str, ChannelSlice], raw: Mapping[str, Any]) -> Slice:
    """The slice of channels and the keys of a header, each checked; `path` stands for it in an InputError."""
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
    columns = [name for name in COLUMNS if any(getattr(part, name) is not None for part in curve.channels.values())]
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


def overridden(raw: Mapping[str, Any], overrides: Mapping[str, Any], channels: Iterable[str]) -> dict[str, Any]:
    """The header's keys with those that win over it; None is not given."""
    return {**raw} | {key: _over(raw.get(key), each, channels) for key, each in overrides.items() if each is not None}


def _over(value: Any, override: Any, channels: Iterable[str]) -> Any:
    """The override; one for some channels leaves the value of the others as it is."""
    if value is None or not isinstance(override, Mapping):
        return override
    return {**(value if isinstance(value, Mapping) else dict.fromkeys(channels, value)), **override}


def _split(content: str) -> tuple[str, str]:
    """The TOML header and the CSV table, each with the other's lines empty, so that line numbers stay the file's."""
    found = _COMMENTS.match(content)
    end = found.end() if found and "\n#" not in content[found.end() :] else len(content)
    above, below = content[:end], content[end:]
    lines = above.split("\n")
    commented = [line[:1] == "#" for line in lines]
    header = [line[1:] if comment and line[1:2] != "#" else "" for line, comment in zip(lines, commented, strict=True)]
    table = ["" if comment else line for line, comment in zip(lines, commented, strict=True)]
    return "\n".join(header).rstrip(), "\n".join(table) + below


def _channels(path: Path, content: str, unit: str | None) -> Iterator[tuple[str, ChannelSlice]]:
    """The channels in the order in which they first appear; lengths are in `unit`, in mm if None."""
    table = parse_columns(path, _in_mm(path, content, unit), ["channel", *COLUMNS], _NEEDED)
    if not table.lines.size:
        raise InputError(f"{path}: holds no row below its header; add {','.join(_NEEDED)} of each point")
    points = Places(str(path), table.lines)
    texts = dict(zip(table.header, table.columns, strict=True))
    names = [*map(str.strip, texts.pop("channel"))]
    if "" in names:
        points.refuse(np.array(names) == "", "channel", names, "must be a name, such as G")
    columns = {name: _numbers(name, column, points) for name, column in texts.items()}
    if unit is not None:
        columns = {name: column * factor(name, unit) for name, column in columns.items()}
    check_values(columns, points)
    if "side" in columns:
        columns["side"] = columns["side"].astype(np.int8)
    for name, here in _places(names).items():
        part = ChannelSlice(**{key: column[here] for key, column in columns.items()})
        check_curve(name, part, points.of(here))
        yield name, part


def _places(names: list[str]) -> dict[str, Any]:
    """The rows of each channel: as a slice where the channels stand one after another, as they mostly do."""
    starts = [0, *(at for at, (one, other) in enumerate(pairwise(names), 1) if one != other)]
    firsts = [names[at] for at in starts]
    if len(set(firsts)) == len(firsts):
        return {name: slice(*ends) for name, ends in zip(firsts, pairwise([*starts, None]), strict=True)}
    return {name: np.array(names) == name for name in dict.fromkeys(firsts)}


def _in_mm(path: Path, content: str, unit: str | None) -> str:
    """The table with its header's columns named as for mm; InputError where they name another unit than `unit`."""
    body = content.lstrip()
    head, end, rows = body.partition("\n")
    names = [name.strip() for name in head.split(",")]
    units = dict.fromkeys(filter(None, (column_unit(name) for name in names if in_mm(name) in COLUMNS)))
    if len(units) > 1:
        raise InputError(
            f"{path}: has columns in {' and in '.join(units)}; write all lengths in one unit, R_d included"
        )
    for name in names:
        named = column_unit(name)
        if named not in (None, "mm", unit) and in_mm(name) in COLUMNS:
            remedy = "rename the columns" if unit else f'give --unit {named}, or a line `# unit = "{named}"`'
            raise InputError(f"{path}: column {name} is in {named}, not in {unit or 'mm'}; {remedy}")
    renamed = ",".join(in_mm(name) if in_mm(name) in COLUMNS else name for name in names)
    return content.removesuffix(body) + renamed + end + rows


def _numbers(name: str, column: Sequence[str], points: Places) -> Any:
    """The column as numbers, NaN where it is empty and may be."""
    try:
        values = np.fromiter(map(float, column), float, len(column))
    except ValueError:
        values = np.array([_number_or_nan(text) for text in column])
    if np.isnan(values).any():
        empty = np.array([name in MAY_BE_EMPTY and not text.strip() for text in column])
        points.refuse(np.isnan(values) & ~empty, name, column, "must be a finite number")
    check_size(name, values, column, points)
    return values


def _number_or_nan(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _texts(part: ChannelSlice, name: str) -> list[str]:
    """The column as text in the shortest form that reads back the same; empty where NaN."""
    values: Array | NDArray[np.int8] | None = getattr(part, name)
    if values is None:
        raise ValueError(f"{name} is given for some channels only")
    return ["" if value != value else repr(value) for value in values.tolist()]
