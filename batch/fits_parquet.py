"""fits.parquet: many fits in one file, a row per channel, columns the keys of fit.json; a failed input is a row too."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from bssrdf.batch.arrow import (
    arrow,
    cast,
    check_columns,
    column_of,
    opened,
    parquet_files,
    schema_of,
    type_of,
    value_of,
    written,
)
from bssrdf.errors import BssrdfError, InputError
from bssrdf.session import from_plain
from bssrdf.session.keys import keys_of
from bssrdf.session.records import ChannelFit, Fit

_WHOLE: dict[str, Any] = {
    "version": str,
    "input_path": str,
    "input_sha256": str,
    "options": dict[str, Any],
    "material": str,
    "eta": float,
    "g": float,
    "about": dict[str, Any],
}
_CHANNEL: dict[str, Any] = {name: declared.kind for name, declared in keys_of(ChannelFit).items()}
_FAILURE = {"error_code": int, "error": str}
_NEEDED = ("name", "channel", "sigma_a_per_mm", "sigma_sp_per_mm", "status")
_ROWS = 4096


class NamedFit(NamedTuple):
    """A fit of a file of many, or why there is none."""

    name: str
    fit: Fit | BssrdfError


@contextmanager
def write_fits(path: Path) -> Iterator[Callable[[Sequence[NamedFit]], None]]:
    """Gives what writes fits, a group at a time; the file appears whole at the end."""
    every = {"name": str, "channel": str, **_WHOLE, **_CHANNEL, **_FAILURE}
    schema = schema_of({name: type_of(kind) for name, kind in every.items()})
    with written(path, schema) as write:
        yield lambda fits: write(arrow().table(_columns(fits), schema=schema))


def read_fits_of(path: Path) -> Iterator[NamedFit]:
    """The fits of a file, or of the files in a folder; InputError where it is no such file."""
    for file in parquet_files(path):
        for name, rows in groupby(_rows(file), key=lambda row: row["name"]):
            try:
                yield NamedFit(name, _fit([*rows]))
            except (TypeError, ValueError, KeyError, AttributeError) as error:
                raise InputError(f"{file}: fit {name} is not laid out as one ({error}); run the fit again") from error


def _columns(fits: Sequence[NamedFit]) -> list[Any]:
    """A row for each channel, and one for a failure."""
    rows = [
        (each.name, each.fit, channel, part)
        for each in fits
        for channel, part in (each.fit.channels if isinstance(each.fit, Fit) else {None: None}).items()
    ]
    wholes = [fit if isinstance(fit, Fit) else None for _, fit, _, _ in rows]
    errors = [fit if isinstance(fit, BssrdfError) else None for _, fit, _, _ in rows]
    columns = [column_of(str, [name for name, _, _, _ in rows]), column_of(str, [channel for _, _, channel, _ in rows])]
    columns += [column_of(kind, [getattr(fit, key, None) for fit in wholes]) for key, kind in _WHOLE.items()]
    columns += [column_of(kind, [getattr(part, key, None) for *_, part in rows]) for key, kind in _CHANNEL.items()]
    columns.append(column_of(int, [error and error.exit_code for error in errors]))
    return [*columns, column_of(str, [None if error is None else str(error) for error in errors])]


def _rows(file: Path) -> Iterator[dict[str, Any]]:
    every = {"name": str, "channel": str, **_WHOLE, **_CHANNEL, **_FAILURE}
    with opened(file) as stored:
        names = stored.schema_arrow.names
        check_columns(file, names, [*every], _NEEDED)
        for batch in stored.iter_batches(batch_size=_ROWS):
            table = arrow().Table.from_batches([batch])
            columns = [
                [
                    value_of(every[name], value)
                    for value in cast(file, name, table[name], type_of(every[name])).to_pylist()
                ]
                for name in names
            ]
            yield from (dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True))


def _fit(rows: Sequence[dict[str, Any]]) -> Fit | BssrdfError:
    first = rows[0]
    if first.get("error") is not None:
        return InputError(first["error"])
    channels = {row["channel"]: from_plain(ChannelFit, {**_empty(), **_stated(row, _CHANNEL)}) for row in rows}
    whole = {key: first.get(key) for key in _WHOLE}
    return Fit(channels=channels, **whole | {"options": whole["options"] or {}, "about": whole["about"] or {}})


def _stated(row: dict[str, Any], keys: dict[str, Any]) -> dict[str, Any]:
    return {key: row[key] for key in keys if key in row and (row[key] is not None or keys[key] is float)}


def _empty() -> dict[str, Any]:
    return {name: declared.default for name, declared in keys_of(ChannelFit).items() if not declared.needed}
