"""frames.csv: one line per frame; also the journal while capturing, to which lines are only added."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, get_origin

from bssrdf.errors import InputError
from bssrdf.session.atomic import atomic_write, inside
from bssrdf.session.checks import shown
from bssrdf.session.keys import keys_of
from bssrdf.session.records import Card, Frame
from bssrdf.session.text_file import csv_text, parse_csv, read_text

_CARD = tuple(keys_of(Card))
_KEYS = {**keys_of(Frame), **keys_of(Card)}
COLUMNS = tuple(_KEYS)
SAME_EXPOSURE = 1e-3
"""Relative difference up to which a dark has its frame's exposure."""


def read_frames(session_path: Path, *, must_exist: bool = True) -> list[Frame]:
    """The frames of a session, in order; InputError for a bad line, or a missing file where it `must_exist`."""
    file = session_path / "frames.csv"
    frames = _parse(session_path, file, read_text(file))
    if not frames:
        raise InputError(f"{file}: lists no frame; add a line file,kind,exposure_s for each")
    for frame in frames:
        if must_exist and not (session_path / frame.file).is_file():
            raise InputError(f"{file}: {frame.file} is not there; put the file back or take its line out")
    return frames


def recover_frames(session_path: Path) -> list[Frame]:
    """The frames journalled so far, none where there is no journal; a last line that was not finished is cut off."""
    file = session_path / "frames.csv"
    if not file.exists():
        return []
    try:
        with file.open("r+b") as journal:
            content = journal.read()
            end = content.rfind(b"\n") + 1
            if end < len(content):
                journal.truncate(end)
                os.fsync(journal.fileno())
    except OSError as error:
        raise InputError(f"{file}: cannot be resumed ({error.strerror}); check its permissions") from error
    return _parse(session_path, file, read_text(file)) if end else []


def append_frame(session_path: Path, frame: Frame) -> None:
    """Add one line to the journal and have it on disk; the header is written first where the file is new."""
    file = session_path / "frames.csv"
    header = _header(file)
    values = dict(zip(COLUMNS, _texts(frame), strict=True))
    for column in COLUMNS:
        if values[column] and column not in (header or COLUMNS):
            raise InputError(f"{file}: has no column {column}, which a captured frame needs; start with a new session")
    line = csv_text([[values[column] for column in header]] if header else [COLUMNS, list(values.values())])
    try:
        with file.open("ab") as journal:
            journal.write(line.encode())
            journal.flush()
            os.fsync(journal.fileno())
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}); check its permissions") from error


def write_frames(session_path: Path, frames: Iterable[Frame]) -> None:
    """Write frames.csv as a whole; optional columns that no frame fills are left out."""
    rows = [_texts(frame) for frame in frames]
    used = [i for i in range(len(COLUMNS)) if i < 3 or any(row[i] for row in rows)]
    table = [[row[i] for i in used] for row in [list(COLUMNS), *rows]]
    with atomic_write(session_path / "frames.csv") as part:
        part.write_text(csv_text(table), encoding="utf-8", newline="")


def dark_for(frame: Frame, frames: Iterable[Frame]) -> list[Frame]:
    """The darks of a frame: of its own kind, else `dark`, of its exposure; InputError where there is none."""
    listed = list(frames)
    for kind in (f"{frame.kind}_dark", "dark"):
        darks = [dark for dark in listed if dark.kind == kind and _same_exposure(dark, frame)]
        if darks:
            return darks
    raise InputError(
        f"{frame.file}: no {frame.kind}_dark or dark of {frame.exposure_s:g} s in frames.csv; "
        "take one with the beam blocked, or leave this exposure out"
    )


def _same_exposure(dark: Frame, frame: Frame) -> bool:
    return abs(dark.exposure_s - frame.exposure_s) <= SAME_EXPOSURE * frame.exposure_s


def _parse(session_path: Path, file: Path, content: str) -> list[Frame]:
    table = parse_csv(file, content, COLUMNS, COLUMNS[:3])
    frames = [
        _frame(file, line, dict(zip(table.header, row, strict=True)))
        for line, row in zip(table.lines, table.rows, strict=True)
    ]
    seen: set[str] = set()
    for frame in frames:
        inside(session_path, frame.file, named_in=file.name)
        if frame.file in seen:
            raise InputError(f"{file}: {frame.file} is listed twice; take one line out")
        seen.add(frame.file)
    return frames


def _frame(file: Path, line: int, fields_of_row: dict[str, str]) -> Frame:
    where = f"{file}: line {line}: "
    values = {name: text.strip() for name, text in fields_of_row.items()}
    if not values["file"] or not values["file"].isprintable():
        raise InputError(f"{where}file {shown(values['file'])} must be a path relative to the session")
    given = [name for name in COLUMNS if values.get(name) or name in COLUMNS[:3]]
    known = {name: _read(where, name, values[name]) for name in given}
    return Frame(card=Card(**{name: known.pop(name) for name in _CARD if name in known}), **known)


def _read(where: str, column: str, text: str) -> Any:
    declared = _KEYS[column]
    try:
        return declared.check(_raw(declared.kind, text))
    except ValueError as error:
        unit = f" [{declared.unit}]" if declared.unit and declared.kind is float else ""
        raise InputError(f"{where}{column} {shown(text)} {error}{unit}") from error


def _raw(kind: Any, text: str) -> Any:
    """The text as its kind wants it; where it is none of that kind, as it stands, for the check to refuse."""
    if get_origin(kind) is tuple:
        return [_raw(float, word) for word in text.split()]
    try:
        return float(text) if kind in (int, float) else text
    except ValueError:
        return text


def _header(file: Path) -> list[str]:
    """Columns of the journal there is; empty where it is new. InputError where its last line is unfinished."""
    if not file.exists() or not file.stat().st_size:
        return []
    content = read_text(file)
    if not content.endswith("\n"):
        raise InputError(f"{file}: its last line is not finished; resume the session first")
    return parse_csv(file, content, COLUMNS, COLUMNS[:3]).header


def _texts(frame: Frame) -> list[str]:
    values = [getattr(frame.card if name in _CARD else frame, name) for name in COLUMNS]
    return [" ".join(map(str, value)) if isinstance(value, tuple) else _text(value) for value in values]


def _text(value: Any) -> str:
    return "" if value is None else str(value)
