"""A process kept for work: it runs one task after another on its main thread, and goes when its parent goes.

`python -m bssrdf.batch.child` reads pickled tasks from stdin and answers on stdout; only `KeptProcess` starts it. One
that ends in a task, or takes more memory than it may, is started anew.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from typing import Any

from bssrdf.batch.state import Told
from bssrdf.errors import BssrdfError

_TICK_S = 0.2
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class ProcessDiedError(BssrdfError):
    """The process ended in the middle of a task."""

    exit_code = 3


class KeptProcess:
    """A kept process with so many threads, and at most so much memory [bytes]; started when it is first asked."""

    def __init__(self, threads: int, memory: float | None = None) -> None:
        self.threads, self.memory = threads, memory
        self._process: subprocess.Popen[bytes] | None = None
        self._said: Said = queue.SimpleQueue()

    def ask(self, task: dict[str, Any], told: Told = lambda message: None) -> Any:
        """The task's result, its messages told as they come; ProcessDiedError where the process does not live on."""
        process = self._process if self._process is not None and self._process.poll() is None else self._start()
        assert process.stdin is not None
        try:
            pickle.dump(task, process.stdin)
            process.stdin.flush()
            while True:
                kind, answer = self._next(process)
                if kind == "done":
                    return answer
                if kind == "error":
                    raise answer
                told(answer)
        except (EOFError, BrokenPipeError):
            code = process.wait()
            self._process = None
            ended = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
            raise ProcessDiedError(f"its process ended by {ended}") from None
        except BaseException as error:
            if not isinstance(error, BssrdfError):
                self.close()
            raise

    def close(self) -> None:
        """End the process, whatever it does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _start(self) -> subprocess.Popen[bytes]:
        environment = os.environ | dict.fromkeys(THREADS, str(self.threads))
        words = [sys.executable, "-m", "bssrdf.batch.child", str(os.getpid())]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        self._said = queue.SimpleQueue()
        threading.Thread(target=_listen, args=(self._process, self._said), daemon=True).start()
        return self._process

    def _next(self, process: subprocess.Popen[bytes]) -> tuple[str, Any]:
        """The next message, while the process keeps within its memory; EOFError where it has ended."""
        while True:
            with contextlib.suppress(queue.Empty):
                if (message := self._said.get(timeout=_TICK_S)) is None:
                    raise EOFError
                return message
            if self.memory is not None and resident(process.pid) > self.memory:
                self.close()
                raise ProcessDiedError(f"it takes more than the {self.memory / 1e9:.3g} GB that a worker may")


Said = queue.SimpleQueue[tuple[str, Any] | None]


def _listen(process: subprocess.Popen[bytes], said: Said) -> None:
    """Hand on what the process says, and None at its end."""
    assert process.stdout is not None
    try:
        while True:
            said.put(pickle.load(process.stdout))
    except (EOFError, OSError, pickle.UnpicklingError, ValueError):
        said.put(None)


def resident(pid: int) -> float:
    """Memory that the process holds [bytes]; 0 where the system does not tell."""
    try:
        with open(f"/proc/{pid}/statm") as file:  # noqa: PTH123 - asked often
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError, ValueError):
        return 0.0


def _go_with(parent: int) -> None:
    """End this process when its parent is gone."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(1, signal.SIGKILL)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_TICK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def main() -> None:
    """Answer tasks until stdin ends."""
    _go_with(int(sys.argv[1]))
    channel = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever else prints must not come between answers

    def tell(kind: str, message: Any) -> None:
        pickle.dump((kind, message), channel)
        channel.flush()

    while True:
        try:
            task = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            from bssrdf.batch.tasks import TASKS

            tell("done", TASKS[task["task"]](task, lambda message: tell("told", message)))
        except BssrdfError as error:
            tell("error", error)


if __name__ == "__main__":
    main()
