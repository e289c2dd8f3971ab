"""What a batch works on: sessions, slices and folders of frames, found once, sorted, and named for their results."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, Literal, NamedTuple

from bssrdf.errors import InputError, UsageError

Stage = Literal["ingest", "measure", "fit", "report"]
STAGES: tuple[Stage, ...] = ("ingest", "measure", "fit", "report")
OWN = (".batch", "index.html", "results.csv", "failures.csv")
"""What stands in the batch's folder beside the results."""
_RESULTS = ("measured", "fit.json", "report.html", "validation.png", ".lock")
_SMALL = 1_000_000
"""Bytes up to which a file is told by its content; a larger one by its size and time."""


class BatchInput(NamedTuple):
    """One session, slice or folder of frames."""

    name: str
    """Of the folder of its results."""
    path: str
    """A path, or an address that fsspec knows."""


def find_inputs(what: Sequence[str], stages: Sequence[Stage]) -> list[BatchInput]:
    """What the arguments stand for, sorted by path; InputError for one that stands for nothing.

    A folder with a session.toml is a session; any other is searched for sessions, then, if nothing is measured, for
    slices; with `ingest` it is one of frames. A .txt file lists paths, one on each line.
    """
    paths = sorted({path for each in what for path in _found(each, stages)})
    return [*map(BatchInput, _names(paths), paths)]


def _found(what: str, stages: Sequence[Stage]) -> Iterator[str]:
    if "://" in what:
        yield from _remote(what)
        return
    path = Path(what)
    if path.suffix == ".txt" and path.is_file():
        for line in _lines(path):
            yield from _found(line, stages)
    elif path.is_file():
        if "measure" in stages or path.suffix != ".csv":
            raise InputError(f"{path}: is a file; give sessions, folders of them, or with --stages fit slices (.csv)")
        yield str(path.absolute())
    elif not path.is_dir():
        raise InputError(f"{path}: is not there; check the path")
    elif (path / "session.toml").is_file() or ("ingest" in stages and not (path / "frames.csv").is_file()):
        yield str(path.absolute())
    else:
        yield from _below(path, stages)


def _below(folder: Path, stages: Sequence[Stage]) -> list[str]:
    sessions = [str(file.parent.absolute()) for file in folder.rglob("session.toml") if ".batch" not in file.parts]
    slices = [] if sessions or "measure" in stages else [str(file.absolute()) for file in folder.rglob("*.csv")]
    if not sessions and not slices:
        raise InputError(
            f"{folder}: holds no session.toml{'' if 'measure' in stages else ' and no slice'}; give sessions"
        )
    return sessions or slices


def _lines(file: Path) -> list[str]:
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: cannot be read ({error}); write one path on each line") from error
    return [line.strip() for line in lines if line.strip() and not line.startswith("#")]


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
    files = [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file() and not _is_result(f, path)]
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
