"""Files and folders that appear whole or not at all, and paths that stay inside their session."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bssrdf.errors import InputError


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Path of a `.part` file beside `path`; it takes the place of `path` when the block ends, and goes if it fails."""
    part = path.with_name(path.name + ".part")
    try:
        yield part
        sync(part)
        part.replace(path)
        sync(path.parent)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    except BaseException:
        part.unlink(missing_ok=True)
        raise


@contextmanager
def replace_folder(target: Path) -> Iterator[Path]:
    """Empty folder to fill; it takes the place of `target` as a whole when the block ends, and goes if it fails."""
    part, old = target.with_name(target.name + ".part"), target.with_name(target.name + ".old")
    if old.exists() and not target.exists():  # killed between the two renames below
        old.rename(target)
    shutil.rmtree(old, ignore_errors=True)
    shutil.rmtree(part, ignore_errors=True)
    try:
        part.mkdir()
        yield part
        for file in part.iterdir():
            sync(file)
        sync(part)
        if target.exists():
            target.rename(old)
        part.rename(target)
        sync(target.parent)
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
        if target.exists():
            shutil.rmtree(old, ignore_errors=True)


def make_folder(path: Path) -> None:
    """The folder and those above it; InputError where it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror or error}); choose another place") from error


def sync(path: Path) -> None:
    """Have the file or folder on disk before going on."""
    if path.is_dir() and os.name == "nt":
        return  # Windows cannot open a folder
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sha256_of(path: Path) -> str:
    """Hexadecimal SHA-256 of the file; InputError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def inside(session_path: Path, relative: str, *, named_in: str = "") -> Path:
    """`session_path / relative`, which must stay inside the session after links are resolved; else InputError.

    `named_in` is the file of the session that names the path.
    """
    path = session_path / relative
    try:
        is_inside = path.resolve().is_relative_to(session_path.resolve())
    except (OSError, RuntimeError, ValueError):  # a loop of links, a NUL in the name
        is_inside = False
    if not is_inside or Path(relative).is_absolute():
        raise InputError(
            f"{session_path / named_in}: path {relative!r} leads outside the session; "
            "copy the file into the session and name it relatively"
        )
    return path
