"""One program at a time on a port and in a session: locks of the system, which go with the process, even by SIGKILL."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import platformdirs
from filelock import FileLock, Timeout

from bssrdf.errors import DeviceError, UsageError


@contextmanager
def lock_ports(ports: set[str]) -> Iterator[None]:
    """Hold every port, or DeviceError that names the one in use and by what process."""
    platformdirs.user_cache_path("bssrdf", ensure_exists=True)
    with ExitStack() as held:
        for port in sorted(ports):
            _refuse(port, held.enter_context(_lock(_file_of(port))))
        yield


def check_ports(ports: set[str]) -> None:
    """The same DeviceError where a port is in use; nothing is held afterwards."""
    for port in sorted(ports):
        if (file := _file_of(port)).exists():
            with _lock(file) as holder:
                _refuse(port, holder)


def _file_of(port: str) -> Path:
    one = os.path.realpath(port) if Path(port).exists() else port  # a port has several names
    name = hashlib.sha256(one.encode()).hexdigest()[:16]
    return platformdirs.user_cache_path("bssrdf") / f"port-{name}.lock"


def _refuse(port: str, holder: str) -> None:
    if holder:
        raise DeviceError(f"{port}: in use by process {holder}; wait for it or stop it")


@contextmanager
def lock_session(session: Path) -> Iterator[None]:
    """Hold the session folder, or UsageError that names the process that does."""
    with _lock(session / ".lock") as holder:
        if holder:
            raise UsageError(f"{session}: process {holder} is capturing into it; wait for it")
        yield


@contextmanager
def _lock(file: Path) -> Iterator[str]:
    """Hold the lock; yields nothing, or the process that holds it already, as it wrote beside the lock."""
    holder = file.with_name(f"{file.name}.pid")
    lock = FileLock(file, mode=0o600, thread_local=False)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        yield _told(holder)
        return
    try:
        holder.write_text(str(os.getpid()), encoding="utf-8")
        yield ""
    finally:
        lock.release()


def _told(holder: Path) -> str:
    try:
        return holder.read_text(encoding="utf-8") or "unknown"
    except OSError:
        return "unknown"
