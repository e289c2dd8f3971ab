"""slices.parquet: many slices in one file, a row per curve; the keys of slice.csv are columns, radii and values lists.

Rows with one `name` are the channels of one slice and stand together. Nothing is lost either way: what `slice_csv`
writes, read from there or from here, is the same. What is checked there is checked here, for all rows at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import accumulate, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.batch.arrow import (
    arrow,
    cast,
    check_columns,
    column_of,
    holds_fits,
    is_json,
    kinds,
    opened,
    parquet_files,
    schema_of,
    type_of,
    value_of,
    written,
)
from bssrdf.errors import InputError
from bssrdf.session import overridden, slice_of
from bssrdf.session.checks import shown
from bssrdf.session.keys import checked_keys, keys_of
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.session.slice_checks import (
    COLUMNS,
    LEAST,
    MAY_BE_EMPTY,
    MOST,
    NEEDED,
    Places,
    check_curve,
    check_size,
    check_values,
)

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

KEYS = keys_of(Slice)
KINDS = kinds(KEYS)
_NAMES = ("name", "sha256", "channel")
ROWS = 3072
"""Curves that are read or written together: 15 MB of 200 radii each."""


class Named(NamedTuple):
    """A slice of a file of many, or why it is none."""

    name: str
    sha256: str
    """Of the slice.csv that it comes from; empty where it does not."""
    slice: Slice | InputError


def count_curves(path: Path) -> int:
    """Rows of the file, or of the folder's files."""
    total = 0
    for each in parquet_files(path):
        with opened(each) as file:
            total += file.metadata.num_rows
    return total


def cuts_of(file: Path, together: int, seen: set[str]) -> list[int]:
    """The row at which each run of so many slices begins, and the number of rows.

    Raises InputError where the file does not hold slices, or where a name stands in two places, here or in `seen`,
    the names of files before.
    """
    starts: list[int] = []
    count, last = 0, None
    with opened(file) as stored:
        _check(file, stored)
        for batch in stored.iter_batches(batch_size=65536, columns=["name"]):
            names = batch.column(0).to_pylist()
            begun = [at for at, name in enumerate(names) if name != (names[at - 1] if at else last)]
            for name in (names[at] for at in begun):
                if name in seen:
                    raise InputError(f"{file}: slice {name} stands in two places; sort the rows by name")
                seen.add(name)
            starts += [count + at for at in begun]
            count, last = count + len(names), names[-1]
    return [*starts[::together], count] if count else []


def read_slices(
    path: Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    lean: bool = False,
    rows: tuple[int, int] | None = None,
) -> Iterator[list[Named]]:
    """The slices of a file, or of the files in a folder, some thousand curves at a time.

    `overrides` are keys of slice.csv that win over the columns; `lean` leaves the provenance out; `rows` of a file are
    all if None. A slice that cannot be used is an InputError in its place; raises InputError where the file itself
    cannot.
    """
    given = checked_keys(path, "", {key: each for key, each in (overrides or {}).items() if each is not None}, Slice)
    seen: set[str] = set()
    for file in parquet_files(path):
        for table in _whole(file, lean, rows):
            yield [*_slices(file, table, given, seen)]


@contextmanager
def write_slices(path: Path) -> Iterator[Callable[[Sequence[Named]], None]]:
    """Gives what writes slices, a group at a time; the file appears whole at the end."""
    types = dict.fromkeys(_NAMES, arrow().string()) | {key: type_of(kind) for key, kind in KINDS.items()}
    numbers = {name: arrow().list_(_number(name)) for name in COLUMNS}
    schema = schema_of(types | numbers)
    with written(path, schema) as write:
        yield lambda slices: write(arrow().table(_columns(slices), schema=schema))


def _number(name: str) -> pa.DataType:
    return arrow().int8() if name == "side" else arrow().float64()


def _columns(slices: Sequence[Named]) -> list[Any]:
    rows = [(each, channel, part) for each in slices for channel, part in _good(each).channels.items()]
    text = arrow().string()
    columns = [
        arrow().array([each.name for each, _, _ in rows], text),
        arrow().array([each.sha256 or None for each, _, _ in rows], text),
        arrow().array([channel for _, channel, _ in rows], text),
    ]
    for key, kind in KINDS.items():
        values = [getattr(each.slice, key) for each, _, _ in rows]
        if KEYS[key].by_channel:
            values = [(value or {}).get(channel) for value, (_, channel, _) in zip(values, rows, strict=True)]
        columns.append(column_of(kind, values))
    return columns + [_lists(name, [getattr(part, name) for _, _, part in rows]) for name in COLUMNS]


def _good(named: Named) -> Slice:
    if isinstance(named.slice, InputError):
        raise named.slice
    return named.slice


def _lists(name: str, arrays: Sequence[NDArray[Any] | None]) -> Any:
    pa = arrow()
    sizes = [0 if each is None else each.size for each in arrays]
    values = np.concatenate([each for each in arrays if each is not None] or [np.zeros(0)])
    missing = np.array([each is None for each in arrays])
    return pa.ListArray.from_arrays(
        pa.array(np.concatenate([[0], np.cumsum(sizes)]), pa.int32()),
        pa.array(values, _number(name), from_pandas=True),
        mask=pa.array(missing) if missing.any() else None,
    )


def _check(path: Path, file: pq.ParquetFile) -> None:
    if holds_fits(file):
        raise InputError(f"{path}: holds fits already; give the Parquet file of their slices")
    check_columns(path, file.schema_arrow.names, [*_NAMES, *KEYS, *COLUMNS], ["name", "channel", *NEEDED])


def _tables(file: pq.ParquetFile, columns: Sequence[str], rows: tuple[int, int] | None) -> Iterator[Any]:
    """Tables of some rows of the file; groups of rows without any of them are not read."""
    first, end = rows or (0, file.metadata.num_rows)
    sizes = [file.metadata.row_group(at).num_rows for at in range(file.num_row_groups)]
    begins = [0, *accumulate(sizes)]
    groups = [at for at, (begin, after) in enumerate(pairwise(begins)) if begin < end and after > first]
    row = begins[groups[0]] if groups else 0
    for batch in file.iter_batches(batch_size=ROWS, row_groups=groups, columns=columns):
        from_, to = max(first - row, 0), min(end - row, len(batch))
        row += len(batch)
        if from_ < to:
            yield arrow().Table.from_batches([batch.slice(from_, to - from_)])


def _whole(path: Path, lean: bool, rows: tuple[int, int] | None) -> Iterator[Any]:
    """The rows as tables in which no slice is cut."""
    pa = arrow()
    with opened(path) as file:
        _check(path, file)
        wanted = [name for name in file.schema_arrow.names if not (lean and name == "provenance")]
        rest = None
        for table in _tables(file, wanted, rows):
            table = table if rest is None else pa.concat_tables([rest, table])
            start = _last_start(table["name"])
            rest = table.slice(start)
            if start:
                yield table.slice(0, start)
        if rest is not None and len(rest):
            yield rest


def _last_start(names: Any) -> int:
    """The row at which the last name's run begins."""
    last, start = names[-1], len(names) - 1
    while start and names[start - 1] == last:
        start -= 1
    return start


class _Rows(NamedTuple):
    """What stands on each row of a table."""

    names: list[Any]
    sha256: list[Any]
    channels: list[Any]
    keys: dict[str, list[Any]]
    lists: dict[str, _Lists]


class _Lists(NamedTuple):
    """A column of lists, end to end."""

    values: NDArray[Any]
    starts: list[int]
    there: list[bool]
    sound: bool
    """Whether no value of any row is of a size that must be refused."""

    def of(self, row: int) -> NDArray[Any] | None:
        return self.values[self.starts[row] : self.starts[row + 1]] if self.there[row] else None


def _slices(path: Path, table: Any, given: Mapping[str, Any], seen: set[str]) -> Iterator[Named]:
    rows = _rows(path, table)
    count = len(rows.names)
    starts = [0, *(at for at in range(1, count) if rows.names[at] != rows.names[at - 1]), count]
    for first, end in pairwise(starts):
        name, where = rows.names[first], f"{path}: slice {rows.names[first]}"
        if not name:
            raise InputError(f"{path}: has a row without a name; give the rows of each slice one")
        try:
            if name in seen:
                raise InputError(f"{where}: stands in two places; sort the rows by name, one for each channel")
            seen.add(name)
            found: Slice | InputError = _slice(where, rows, range(first, end), given)
        except InputError as error:
            found = error
        yield Named(name, rows.sha256[first] or "", found)


def _rows(path: Path, table: Any) -> _Rows:
    nothing: list[Any] = [None] * len(table)
    plain = {
        name: _values(path, name, KINDS.get(name, str), table[name])
        for name in (*_NAMES, *KEYS)
        if name in table.column_names and table[name].null_count < len(table)
    }
    names, sha256, channels = (plain.pop(name, nothing) for name in _NAMES)
    lists = {name: _unpacked(path, name, table[name]) for name in COLUMNS if name in table.column_names}
    return _Rows(names, sha256, channels, plain, lists)


def _values(path: Path, name: str, kind: Any, column: Any) -> list[Any]:
    values: list[Any] = cast(path, name, column, type_of(kind)).to_pylist()
    if kind is float:
        return [None if value != value else value for value in values]
    if not is_json(kind):
        return values
    try:
        return [value_of(kind, value) for value in values]
    except ValueError as error:
        raise InputError(f"{path}: column {name} holds what is not JSON ({error}); write it by `convert`") from error


def _unpacked(path: Path, name: str, column: Any) -> _Lists:
    pa = arrow()
    whole = pa.concat_arrays(cast(path, name, column, pa.list_(_number(name))).chunks)
    values = whole.values.to_numpy(zero_copy_only=False)
    size = np.abs(values)
    odd = ~((size >= LEAST) & (size <= MOST) | (size == 0))
    sound = not (odd & ~np.isnan(size)).any() if name in MAY_BE_EMPTY else not odd.any()
    return _Lists(values, whole.offsets.to_pylist(), whole.is_valid().to_pylist(), sound)


def _slice(where: str, rows: _Rows, here: range, given: Mapping[str, Any]) -> Slice:
    channels: dict[str, ChannelSlice] = {}
    for row in here:
        name = rows.channels[row]
        if not name or name in channels:
            raise InputError(f"{where}: channel {shown(name)} must be a name that no other row of the slice has")
        arrays = {key: each.of(row) for key, each in rows.lists.items()}
        channels[name] = _channel(where, name, arrays, [key for key, each in rows.lists.items() if not each.sound])
    raw = {key: _value(where, key, values, rows, here) for key, values in rows.keys.items()}
    stated = {key: each for key, each in raw.items() if each not in (None, {}, [])}
    return slice_of(where, channels, overridden(stated, given, channels))


def _value(where: str, key: str, values: list[Any], rows: _Rows, here: range) -> Any:
    """The key's value for the slice, by channel where it has one for each."""
    if KEYS[key].by_channel:
        return {rows.channels[row]: values[row] for row in here if values[row] is not None}
    first = values[here[0]]
    for row in here:
        if values[row] != first:
            ours, theirs = rows.channels[here[0]], rows.channels[row]
            raise InputError(
                f"{where}: {key} = {shown(first)} in channel {ours} and {shown(values[row])} in {theirs}; "
                "one slice has one value: give rows of another medium another name"
            )
    return first


def _channel(where: str, name: str, arrays: Mapping[str, NDArray[Any] | None], doubtful: Sequence[str]) -> ChannelSlice:
    where = f"{where}: channel {name}"
    columns = {key: each for key, each in arrays.items() if each is not None}
    for key in NEEDED:
        if key not in columns:
            raise InputError(f"{where}: lacks {key}; give a list, or take the row out")
    count = columns["r_mm"].size
    for key, each in columns.items():
        if each.size != count:
            raise InputError(f"{where}: {key} has {each.size} values and r_mm {count}; give as many of each")
    if not count:
        raise InputError(f"{where}: has no radius; take the row out")
    places = Places(where, np.arange(1, count + 1), "value")
    for key in doubtful:
        if key in columns:
            check_size(key, columns[key], columns[key], places)
    check_values(columns, places)
    part = ChannelSlice(**columns)
    check_curve(name, part, places)
    return part
