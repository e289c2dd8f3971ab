"""What a batch works on: sessions, slices, folders of frames and rows of Parquet files, found once and sorted."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any, Literal, NamedTuple

from bssrdf.batch.arrow import is_parquet, parquet_files
from bssrdf.batch.slices_parquet import cuts_of
from bssrdf.errors import InputError, UsageError

Stage = Literal["ingest", "measure", "fit", "report"]
STAGES: tuple[Stage, ...] = ("ingest", "measure", "fit", "report")
OWN = (".batch", "fits", "index.html", "results.csv", "failures.csv")
"""What stands in the batch's folder beside the results."""
_RESULTS = ("measured", "fit.json", "report.html", "validation.png", ".lock")
_SMALL = 1_000_000
"""Bytes up to which a file is told by its content; a larger one by its size and time."""


class BatchInput(NamedTuple):
    """One session, slice or folder of frames; or some rows of a Parquet file."""

    name: str
    """Of the folder, or of the Parquet file, of its results."""
    path: str
    """A path, or an address that fsspec knows; `FILE#FIRST-END` for rows of a Parquet file."""
    rows: tuple[int, int] | None = None
    """The first, and the one after the last."""

    @property
    def file(self) -> str:
        return self.path.rpartition("#")[0] if self.rows else self.path

    @property
    def size(self) -> int:
        """As the progress counts: 1, or the number of rows."""
        return self.rows[1] - self.rows[0] if self.rows else 1


def find_inputs(what: Sequence[str], stages: Sequence[Stage], together: int) -> list[BatchInput]:
    """What the arguments stand for, sorted by path; InputError for one that stands for nothing.

    A folder with a session.toml is a session; any other is searched for sessions, then, if nothing is measured, for
    slices; with `ingest` it is one of frames. A .txt file lists paths, one on each line. A Parquet file, or each of
    those in a folder, is cut after every `together` slices; such files come by themselves.
    """
    listed = [path for each in what for path in _listed(each)]
    bulk = [Path(path) for path in listed if "://" not in path and is_parquet(Path(path))]
    if bulk and (len(bulk) < len(listed) or [*stages] != ["fit"]):
        raise UsageError(f"{bulk[0]}: is Parquet; give such files by themselves, and --stages fit")
    if bulk:
        return _spans(bulk, together)
    paths = sorted({path for each in listed for path in _found(each, stages)})
    return [*map(BatchInput, _names(paths), paths)]


def _spans(what: Sequence[Path], together: int) -> list[BatchInput]:
    """The rows of the files, cut between slices."""
    files = sorted({_absolute(file) for path in what for file in parquet_files(path)})
    spans: list[BatchInput] = []
    seen: set[str] = set()
    for name, file in zip(_names(files), files, strict=True):
        ends = cuts_of(Path(file), together, seen)
        spans += [
            BatchInput(f"{name.removesuffix('.parquet')}-{at:06}", f"{file}#{first}-{end}", (first, end))
            for at, (first, end) in enumerate(pairwise(ends))
        ]
    if not spans:
        raise InputError(f"{what[0]}: holds no slice; give Parquet files that do")
    return spans


def _listed(what: str) -> list[str]:
    """The lines of a list, or what was given itself."""
    is_list = "://" not in what and what.endswith(".txt") and Path(what).is_file()
    return _lines(Path(what)) if is_list else [what]


def _found(what: str, stages: Sequence[Stage]) -> Iterator[str]:
    if "://" in what:
        yield from _remote(what)
        return
    path = Path(what)
    if path.is_file():
        if "measure" in stages or path.suffix != ".csv":
            raise InputError(f"{path}: is a file; give sessions, folders of them, or with --stages fit slices (.csv)")
        yield _absolute(path)
    elif not path.is_dir():
        raise InputError(f"{path}: is not there; check the path")
    elif (path / "session.toml").is_file() or ("ingest" in stages and not (path / "frames.csv").is_file()):
        yield _absolute(path)
    else:
        yield from _below(path, stages)


def _absolute(path: Path) -> str:
    """One spelling of a path: links keep their names, but `..` goes where the system goes."""
    return str(path.resolve() if ".." in path.parts else path.absolute())


def _below(folder: Path, stages: Sequence[Stage]) -> list[str]:
    every = [*folders_below(folder)]
    sessions = [_absolute(here) for here, names in every if "session.toml" in names]
    tables = [_absolute(here / name) for here, names in every for name in names if name.endswith(".csv")]
    slices = [] if sessions or "measure" in stages else tables
    if not sessions and not slices:
        raise InputError(
            f"{folder}: holds no session.toml{'' if 'measure' in stages else ' and no slice'}; give sessions"
        )
    return sessions or slices


def folders_below(folder: Path) -> Iterator[tuple[Path, list[str]]]:
    """Each folder, this one first, and the names of its files: through links, none twice, without what is hidden.

    A batch's folder below is left out. Raises InputError where one cannot be read.
    """
    seen: set[str] = set()

    def refuse(error: OSError) -> None:
        raise InputError(f"{error.filename}: cannot be read ({error.strerror}); let it be read, or give the others")

    for path, folders, names in os.walk(folder, onerror=refuse, followlinks=True):
        real = os.path.realpath(path)
        if real in seen or (".batch" in folders and Path(path) != folder):
            folders.clear()
            continue
        seen.add(real)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield Path(path), sorted(name for name in names if not name.startswith("."))


def _lines(file: Path) -> list[str]:
    try:
        lines = [line.strip() for line in file.read_text(encoding="utf-8-sig").splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: cannot be read ({error}); write one path on each line") from error
    paths = [line for line in lines if line and not line.startswith("#")]
    if not paths:
        raise InputError(f"{file}: lists nothing; write one path on each line")
    for path in paths:
        if "://" not in path and not Path(path).exists():
            raise InputError(f"{file}: lists {path}, which is not there; paths begin in the folder of the command")
    return paths


def filesystem(address: str) -> tuple[Any, str]:
    """The file system of an address and the path in it; UsageError where what reads it is not installed."""
    try:
        import fsspec

        system, path = fsspec.core.url_to_fs(address)
    except (ImportError, ValueError) as error:
        raise UsageError(f"{address}: cannot be reached ({error}); see docs/scale.md for what to install") from error
    return system, str(path)


def _remote(address: str) -> list[str]:
    system, root = filesystem(address)
    try:
        if system.exists(f"{root}/session.toml"):
            return [address]
        found = [PurePosixPath(path).parent.as_posix() for path in system.find(root) if path.endswith("/session.toml")]
    except Exception as error:  # each file system has errors of its own
        raise InputError(f"{address}: cannot be read ({error}); check address and credentials") from error
    if not found:
        raise InputError(f"{address}: holds no session.toml; give sessions, or a folder of them")
    return [system.unstrip_protocol(path) for path in found]


def _names(paths: Sequence[str]) -> list[str]:
    """For each path its last part, with as many of those before it as tell it from the others."""
    parts = [
        [part for part in PurePosixPath(path.replace("://", "/")).parts if part not in ("/", "\\")] for path in paths
    ]
    names = []
    for own in parts:
        size = 1
        while size < len(own) and sum(other[-size:] == own[-size:] for other in parts) > 1:
            size += 1
        name = "-".join(own[-size:]).removesuffix(".csv")
        names.append(f"{name}-" if name in OWN else name)
    if len(set(names)) < len(names):  # a-b/c and a/b-c
        names = [
            f"{name}-{hashlib.sha256(path.encode()).hexdigest()[:8]}" for name, path in zip(names, paths, strict=True)
        ]
    return names


def signature(path: str) -> str:
    """A digest of what the input's files are now: small ones by content, others by size and time."""
    digest = hashlib.sha256()
    for line in sorted(_remote_marks(path) if "://" in path else _marks(Path(path))):
        digest.update(f"{line}\n".encode())
    return digest.hexdigest()


def _marks(path: Path) -> Iterator[str]:
    below = [] if path.is_file() else [here / name for here, names in folders_below(path) for name in names]
    files = [path] if path.is_file() else [file for file in below if not _is_result(file, path)]
    slice_of_session = path / "measured" / "slice.csv"
    for file in [*files, *([slice_of_session] if slice_of_session.is_file() else [])]:
        try:
            stat = file.stat()
            small = stat.st_size <= _SMALL
            told = hashlib.sha256(file.read_bytes()).hexdigest() if small else f"{stat.st_mtime_ns}"
        except OSError as error:
            told, stat = f"cannot be read: {error.strerror}", None
        yield json.dumps([str(file.relative_to(path)), stat and stat.st_size, told])


def _is_result(file: Path, session: Path) -> bool:
    return file.relative_to(session).parts[0] in _RESULTS


def _remote_marks(address: str) -> Iterator[str]:
    system, root = filesystem(address)
    for path, about in system.find(root, detail=True).items():
        marks = [
            str(about.get(key)) for key in ("size", "ETag", "etag", "mtime", "LastModified", "created") if key in about
        ]
        yield json.dumps([path, *marks])
