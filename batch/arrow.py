"""What a declared key is in a table of Arrow, and back; columns are made from the declarations in `session.records`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import numpy as np

from bssrdf.errors import InputError, UsageError
from bssrdf.session import atomic_write
from bssrdf.session.checks import known_keys, shown
from bssrdf.session.keys import Declared
from bssrdf.session.text_file import FORMAT

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

Kind = Literal["slices", "fits"]
_FORMAT = b"bssrdf format"
_SHOWN = "[!.]*.parquet"


def arrow() -> Any:
    """pyarrow, or UsageError that says how to get it."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError("Parquet needs pyarrow; install it by `pip install 'bssrdf[batch]'`") from error
    return pyarrow


@cache
def type_of(kind: Any) -> pa.DataType:
    """The type of a column for values of this kind; text, which is JSON, for what has no plain one."""
    pa, origin, arguments = arrow(), get_origin(kind), get_args(kind)
    if origin is Literal:
        return pa.string()
    if origin is tuple:
        return pa.list_(type_of(arguments[0]))
    if origin is dict and arguments[1] is not Any:
        return pa.map_(pa.string(), type_of(arguments[1]))
    plain = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
    return plain.get(kind, pa.string())


def is_json(kind: Any) -> bool:
    """Whether values of this kind stand as JSON in their column."""
    origin = get_origin(kind)
    return kind not in (float, int, bool, str) and (origin not in (Literal, tuple, dict) or get_args(kind)[-1] is Any)


def column_of(kind: Any, values: Sequence[Any]) -> pa.Array:
    """The values as a column, null for None, NaN and infinity."""
    pa = arrow()
    if kind is float:
        numbers = np.array([math.nan if value is None else value for value in values], float)
        return pa.array(np.where(np.isfinite(numbers), numbers, np.nan), from_pandas=True)
    if is_json(kind):
        return pa.array([to_json(value) for value in values], pa.string())
    if get_origin(kind) is dict:
        there = [value for value in values if value is not None]
        keys = pa.array([key for value in there for key in value], pa.string())
        return pa.MapArray.from_arrays(
            _offsets(values), keys, column_of(get_args(kind)[1], _flat(map(dict.values, there)))
        )
    if get_origin(kind) is tuple:
        items = column_of(get_args(kind)[0], _flat(value for value in values if value is not None))
        return pa.ListArray.from_arrays(_offsets(values), items)
    return pa.array(values, type_of(kind))


def _flat(values: Iterable[Iterable[Any]]) -> list[Any]:
    return [each for value in values for each in value]


def _offsets(values: Sequence[Any]) -> pa.Array:
    """Where each list begins in what is flat, and the end; null for None."""
    ends = [0, *accumulate(0 if value is None else len(value) for value in values)]
    missing = [*(value is None for value in values), False]
    return arrow().array(ends, arrow().int32(), mask=np.array(missing))


def value_of(kind: Any, value: Any) -> Any:
    """What a cell of such a column, as Arrow gives it to Python, stands for; None for null."""
    if value is None:
        return None
    if is_json(kind):
        return json.loads(value)
    if get_origin(kind) is dict:
        return {key: value_of(get_args(kind)[1], each) for key, each in value}
    return value


def to_json(value: Any) -> str | None:
    """One line of JSON, None for None or nothing; TypeError for what JSON has no form for."""
    return None if value is None or value == {} else json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def schema_of(fields: dict[str, pa.DataType]) -> pa.Schema:
    """The columns, with what tells a file of ours."""
    pa = arrow()
    return pa.schema(list(fields.items()), metadata={_FORMAT: str(FORMAT).encode()})


def parquet_files(path: Path) -> list[Path]:
    """The file, or those in the folder in order of their names; InputError where there is none."""
    if not path.is_dir():
        return [path]
    files = sorted(path.glob(_SHOWN))
    if not files:
        raise InputError(f"{path}: holds no .parquet file; give one, or the folder that holds them")
    return files


def is_parquet(path: Path) -> bool:
    """Whether the path names a Parquet file, or a folder of them."""
    return path.suffix == ".parquet" or (path.is_dir() and any(path.glob(_SHOWN)))


@contextmanager
def opened(path: Path) -> Iterator[pq.ParquetFile]:
    """The file, open; InputError where it is not Parquet, damaged, or of a later version."""
    pa = arrow()
    try:
        with path.open("rb") as stream, pa.parquet.ParquetFile(stream, memory_map=False) as file:
            check_version(path, file.schema_arrow.metadata or {})
            yield file
    except FileNotFoundError as error:
        raise InputError(f"{path}: is not there; check the path") from error
    except pa.ArrowInvalid as error:
        raise InputError(f"{path}: is not a whole Parquet file ({first_line(error)}); write it anew") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or first_line(error)}); check it") from error


@contextmanager
def written(path: Path, schema: pa.Schema) -> Iterator[Callable[[pa.Table], None]]:
    """Gives what adds a table to the file, which appears whole at the end."""
    pa = arrow()
    with (
        atomic_write(path) as part,
        part.open("wb") as stream,
        pa.parquet.ParquetWriter(stream, schema, compression="zstd") as writer,
    ):
        yield writer.write_table


def check_version(path: Path, metadata: dict[bytes, bytes]) -> None:
    """InputError for a format that is newer than this version reads; a file made elsewhere need not say one."""
    said = metadata.get(_FORMAT, str(FORMAT).encode()).decode("utf-8", "replace")
    if not said.isdecimal() or int(said) < 1:
        raise InputError(f"{path}: format = {shown(said)} must be {FORMAT}")
    if int(said) > FORMAT:
        raise InputError(f"{path}: format = {said} is newer than this version reads ({FORMAT}); update bssrdf")


def kind_of_file(path: Path) -> Kind:
    """Whether it holds slices or fits."""
    with opened(parquet_files(path)[0]) as file:
        return "fits" if holds_fits(file) else "slices"


def holds_fits(file: pq.ParquetFile) -> bool:
    """Whether the open file is one of fits."""
    return "sigma_a_per_mm" in file.schema_arrow.names


def names_of(path: Path) -> list[str]:
    """The names of the file's slices or fits, or of those in the folder's files, each once."""
    names: dict[str, None] = {}
    for each in parquet_files(path):
        with opened(each) as file:
            check_columns(each, file.schema_arrow.names, file.schema_arrow.names, ["name"])
            for batch in file.iter_batches(batch_size=65536, columns=["name"]):
                names |= dict.fromkeys(map(str, batch.column(0).to_pylist()))
    return [*names]


def check_columns(path: Path, names: Sequence[str], known: Sequence[str], needed: Sequence[str]) -> None:
    """InputError for a column that is not known, that stands twice or that is missing."""
    if index := [name for name in names if name.startswith("__index_level_")]:
        raise InputError(f"{path}: column {index[0]} is the index of pandas; write it by to_parquet(index=False)")
    known_keys(path, "column ", names, known)
    for name in needed:
        if name not in names:
            raise InputError(f"{path}: lacks the column {name}; add it")
    if len(set(names)) < len(names):
        raise InputError(f"{path}: has a column twice; take one out")


def cast(path: Path, name: str, column: Any, wanted: pa.DataType) -> Any:
    """The column in the type that it must have; InputError where it has another that does not turn into it."""
    pa = arrow()
    if column.type == wanted:
        return column
    refusal = InputError(f"{path}: column {name} is of type {column.type}; write it as {wanted}")
    if "bool" in str(column.type):  # Arrow would make 1 of true
        raise refusal
    try:
        return column.cast(wanted)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, pa.ArrowTypeError) as error:
        raise refusal from error


def first_line(error: Exception) -> str:
    """What an error of Arrow says first, in some 80 letters."""
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")[:80]


def kinds(keys: dict[str, Declared]) -> dict[str, Any]:
    """The type of each key's column before Arrow's: a key by channel has one number on each row."""
    return {name: float if declared.by_channel else declared.kind for name, declared in keys.items()}
