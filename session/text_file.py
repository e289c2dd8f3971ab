"""Text as people write it: TOML documents and CSV tables, read and written."""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from numbers import Integral, Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.checks import known_keys, shown

FORMAT = 1
_NOT_TEXT = {
    b"PK\x03\x04": "a zip archive such as a workbook (.xlsx, .ods)",
    b"\xd0\xcf\x11\xe0": "an old workbook (.xls)",
    b"\xff\xfe": "text in UTF-16",
    b"\xfe\xff": "text in UTF-16",
}


def read_text(file: Path) -> str:
    """The UTF-8 text of a file (a byte order mark is dropped); InputError where there is none."""
    try:
        content = file.read_bytes()
        for beginning, kind in _NOT_TEXT.items():
            if content.startswith(beginning):
                raise InputError(f"{file}: is {kind}, whatever its name; save it as plain text in UTF-8")
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: is not UTF-8 text (byte {error.start}); save it as plain text in UTF-8") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{file}: cannot be read ({reason}); check the path") from error


def check_format(file: Path, value: Any) -> None:
    """InputError unless the file's format number is one this version reads."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise InputError(f"{file}: format = {shown(value)} must be {FORMAT}")
    if value > FORMAT:
        raise InputError(f"{file}: format = {value} is newer than this version reads ({FORMAT}); update bssrdf")


def parse_toml(file: Path, document: str) -> dict[str, Any]:
    """The TOML document; InputError with the place where it is malformed."""
    try:
        return tomllib.loads(document)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: is not TOML: {error}; fix it there") from error


class Table(NamedTuple):
    """The fields of each row as they stand, as many as the header has, and the line of the file that it stands on."""

    header: list[str]
    rows: list[list[str]]
    lines: list[int]


def parse_csv(file: Path, content: str, known: Sequence[str], needed: Sequence[str]) -> Table:
    """The table; InputError for an unknown, missing or repeated column, or a row that is not as long as the header."""
    try:
        numbered = [(line, row) for line, row in enumerate(csv.reader(StringIO(content), strict=True), 1) if row]
    except csv.Error as error:
        raise InputError(f"{file}: is not a CSV table ({error}); write it anew") from error
    if not numbered:
        raise InputError(f"{file}: holds no table; it must begin with the line {','.join(needed)}")
    header = [name.strip() for name in numbered[0][1]]
    _check_commas(file, header, needed)
    known_keys(file, "column ", header, known)
    for name in needed:
        if name not in header:
            raise InputError(f"{file}: lacks the column {name}; add it")
    if len(set(header)) < len(header):
        raise InputError(f"{file}: the header {','.join(header)} names a column twice; take one out")
    for line, row in numbered:
        if len(row) != len(header):
            raise InputError(f"{file}: line {line} has {len(row)} fields, not {len(header)} as the header; complete it")
    return Table(header, [row for _, row in numbered[1:]], [line for line, _ in numbered[1:]])


class TextColumns(NamedTuple):
    """The fields of each column as they stand, and the line of the file that each row stands on."""

    header: list[str]
    columns: list[Sequence[str]]
    lines: NDArray[np.int64]


def parse_columns(file: Path, content: str, known: Sequence[str], needed: Sequence[str]) -> TextColumns:
    """`parse_csv` by columns; a plain table of many rows is cut at its commas at once, each line's end a field too."""
    body = content.strip("\n")
    head, _, rows = body.partition("\n")
    width, count = head.count(",") + 1, rows.count("\n") + 1
    fields = rows.replace("\n", ",\n,").split(",")
    whole = len(fields) == count * (width + 1) - 1 and {*fields[width :: width + 1]} <= {"\n"}
    if not rows or not whole or '"' in body:
        table = parse_csv(file, content, known, needed)
        columns: list[Sequence[str]] = list(zip(*table.rows, strict=True))
        return TextColumns(table.header, columns or [()] * len(table.header), np.array(table.lines, int))
    header = parse_csv(file, head, known, needed).header
    first = content.index(body) + 2
    return TextColumns(header, [fields[at :: width + 1] for at in range(width)], np.arange(first, first + count))


def _check_commas(file: Path, header: Sequence[str], needed: Sequence[str]) -> None:
    """InputError that names what stands in the place of commas, or of a header."""
    if header and header[0].startswith("#"):
        raise InputError(f"{file}: begins with a comment; begin it with the line {','.join(needed)}")
    if len(header) == 1:
        for separator, name in {";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}.items():
            if separator in header[0]:
                raise InputError(f"{file}: separates its fields by {name}; write commas, and points in decimals")
    if header and all(map(_is_number, header)):
        raise InputError(f"{file}: begins with numbers; put the line {','.join(needed)} above them")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def csv_text(rows: Iterable[Iterable[str]]) -> str:
    """The rows as lines of CSV."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def toml_table(values: Mapping[str, Any]) -> str:
    """`key = value` lines; a key whose value is None is left out."""
    return "".join(f"{_key(key)} = {toml_value(value)}\n" for key, value in values.items() if value is not None)


def toml_value(value: Any) -> str:
    """One value, on one line; TypeError for what TOML has no form for."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        return repr(float(value))
    if isinstance(value, Mapping):
        items = (f"{_key(key)} = {toml_value(each)}" for key, each in value.items() if each is not None)
        return "{ " + ", ".join(items) + " }" if value else "{}"
    if isinstance(value, list | tuple | np.ndarray):
        return "[" + ", ".join(toml_value(each) for each in value) + "]"
    raise TypeError(f"{type(value).__name__} {value!r} has no TOML form")


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else toml_value(key)
