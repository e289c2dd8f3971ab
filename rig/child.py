"""One program of the user's own: run to its end within a time, or ended with all that it has started."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from typing import IO

from bssrdf.errors import DeviceError
from bssrdf.rig.interrupts import deferred

_TICK_S = 0.1
_KILL_S = 2.0
_WORDS_SHOWN = 200
_REMEDY = "run it by itself to see why"


def ended_well(name: str, words: Sequence[str], limit_s: float, keep_alive: Callable[[], None] = lambda: None) -> str:
    """What the program printed; DeviceError where it cannot be run, is late, is killed or fails.

    Its output goes to files: a pipe would stay open as long as anything that the program has left behind.
    """
    what = f"{name}: {shlex.join(words)}"
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as complaint:
        process = None
        try:
            with deferred():
                process = subprocess.Popen(
                    words, stdin=subprocess.DEVNULL, stdout=out, stderr=complaint, start_new_session=True
                )
            code = _code(process, time.monotonic() + limit_s, keep_alive)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise DeviceError(f"{what} cannot be run ({reason}); check the command in rig.toml") from error
        finally:
            if process is not None:
                _end(process)
        if code is None:
            raise DeviceError(f"{what} was not done within {limit_s:.3g} s and was ended; give it a longer timeout_s")
        if code < 0:
            raise DeviceError(f"{what} was killed by signal {_signal_name(-code)}; {_REMEDY}")
        if code:
            raise DeviceError(f"{what} failed with exit code {code}{_last_line(complaint, out)}; {_REMEDY}")
        return _text(out)


def _code(process: subprocess.Popen[bytes], deadline: float, keep_alive: Callable[[], None]) -> int | None:
    while (left_s := deadline - time.monotonic()) > 0:
        try:
            return process.wait(min(_TICK_S, left_s))
        except subprocess.TimeoutExpired:
            keep_alive()
    return process.poll()


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the program with its group; one that belongs to another user may outlive it."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_KILL_S)


def _last_line(*outputs: IO[bytes]) -> str:
    """What the program complained about, in brackets."""
    for output in outputs:
        if lines := _text(output).split("\n")[-1:]:
            said = " ".join("".join(c if c.isprintable() else " " for c in lines[0]).split())
            if said:
                return f" ({said[:_WORDS_SHOWN]})"
    return ""


def _text(output: IO[bytes]) -> str:
    output.seek(0)
    return output.read().decode("utf-8", "replace").strip()


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return str(number)
