"""`bssrdf convert`: slices and fits between files of their own, CSV and JSON, and Parquet, without loss."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bssrdf.batch.arrow import is_parquet, kind_of_file, names_of
from bssrdf.batch.fit_steps import slice_file
from bssrdf.batch.fits_parquet import NamedFit, read_fits_of, write_fits
from bssrdf.batch.inputs import folders_below
from bssrdf.batch.slices_parquet import Named, read_slices, write_slices
from bssrdf.errors import BssrdfError, InputError, UsageError
from bssrdf.session import inside, make_folder, read_fit, read_slice, sha256_of, write_fit, write_slice
from bssrdf.session.checks import shown

TOGETHER = 1024
"""Files that become rows of one group."""
Progress = Callable[[str, int, int], None]


class Converted(NamedTuple):
    """How many slices or fits were written, and one line for each that could not be."""

    written: int
    failures: list[str]


def to_parquet(inputs: Sequence[Path], out: Path, *, fits: bool, progress: Progress | None = None) -> Converted:
    """Slices (CSV files, sessions, folders that hold them), or `fits` (JSON files likewise), as rows of one file.

    A file that cannot be read is left out and named in the result; InputError where nothing is left, or no file found.
    """
    files = found_files(inputs, fits=fits)
    failures: list[str] = []
    count = 0
    writer: Any = write_fits if fits else write_slices
    with writer(out) as write:
        for start in range(0, len(files), TOGETHER):
            if progress is not None:
                progress("files", start, len(files))
            some = files[start : start + TOGETHER]
            read = [*_read(some, failures, fits=fits)]
            count += len(read)
            write(read)
        if not count:
            raise InputError(failures[0] if len(failures) == 1 else f"{failures[0]} (and {len(failures) - 1} more)")
    return Converted(count, failures)


def from_parquet(source: Path, out: Path, *, progress: Progress | None = None) -> Converted:
    """A file for each slice or fit of a Parquet file, named as its row says, below the folder `out`."""
    if kind_of_file(source) == "slices":
        several = (each for group in read_slices(source) for each in group)
        return _spread(source, out, ((each.name, each.slice) for each in several), ".csv", write_slice, progress)
    return _spread(source, out, read_fits_of(source), ".json", write_fit, progress)


def found_files(inputs: Sequence[Path], *, fits: bool) -> list[Path]:
    """The files that the inputs stand for, in order of their paths below each; InputError for one without any."""
    found: dict[Path, None] = {}
    for path in inputs:
        if is_parquet(path):
            raise UsageError(f"{path}: is Parquet already; give --out a folder to convert it back")
        found |= dict.fromkeys(_below(path, fits=fits) if path.is_dir() else [path])
    return [*found]


def _below(folder: Path, *, fits: bool) -> Sequence[Path]:
    own = folder / "fit.json" if fits else slice_file(folder)
    if own.is_file():
        return [own]
    name = "fit.json" if fits else "slice.csv"
    wanted = sorted(here / name for here, names in folders_below(folder) if name in names)
    wanted = wanted or sorted(folder.glob("[!.]*.json" if fits else "[!.]*.csv"))
    if not wanted:
        raise InputError(f"{folder}: holds no {name}; give the folder that does")
    return wanted


def _read(files: Sequence[Path], failures: list[str], *, fits: bool) -> Iterator[Named | NamedFit]:
    for file in files:
        try:
            yield NamedFit(str(file), read_fit(file)) if fits else Named(str(file), sha256_of(file), read_slice(file))
        except BssrdfError as error:
            failures.append(str(error))


def _spread(
    source: Path,
    out: Path,
    named: Iterator[tuple[str, Any]],
    suffix: str,
    write: Callable[[Path, Any], None],
    progress: Progress | None,
) -> Converted:
    names = names_of(source)
    if not names:
        raise InputError(f"{source}: holds nothing; give a Parquet file that does")
    root = _common(names)
    failures: list[str] = []
    for done, (name, what) in enumerate(named):
        if progress is not None and not done % TOGETHER:
            progress("files", done, len(names))
        if isinstance(what, BssrdfError):
            failures.append(str(what))
            continue
        file = _file(source, out, name, root, suffix)
        make_folder(file.parent)
        write(file, what)
    return Converted(len(names) - len(failures), failures)


def _file(source: Path, out: Path, name: str, root: str, suffix: str) -> Path:
    try:
        return inside(out, _relative(name, root, suffix))
    except InputError as error:
        raise InputError(f"{source}: name {shown(name)} leads outside {out}; give its rows another") from error


def _common(names: Sequence[str]) -> str:
    """The folder that all named files have in common."""
    folders = {os.path.dirname(os.path.normpath(name)) for name in names}  # noqa: PTH120 - names, not files
    try:
        return os.path.commonpath(folders)
    except ValueError:  # some begin at the root and some do not
        return ""


def _relative(name: str, root: str, suffix: str) -> str:
    path = os.path.relpath(os.path.normpath(name), root or ".") if root else os.path.normpath(name).lstrip(os.sep)
    bare, ending = os.path.splitext(path)  # noqa: PTH122
    return bare + suffix if ending in (".csv", ".json") else path + suffix
