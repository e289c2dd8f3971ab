"""The world as a process of its own: one JSON line asked, one answered, over a Unix socket."""

from __future__ import annotations

import json
import socket
import socketserver
import sys
import threading
import time
from pathlib import Path
from typing import Any

from bssrdf.rig.sim.world import World


class WorldClient:
    """The world, from another process; also keeps the bench's time."""

    def __init__(self, path: str | Path, speed: float = 1.0) -> None:
        self.speed = speed
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(path))
        self._stream = self._socket.makefile("rw", encoding="utf-8")
        self._lock = threading.Lock()

    def now(self) -> float:
        """Seconds of the bench: the machine's own clock, which all processes share, run faster."""
        return time.monotonic() * self.speed

    def call(self, verb: str, *arguments: Any) -> Any:
        with self._lock:
            self._stream.write(json.dumps([verb, *arguments]) + "\n")
            self._stream.flush()
            return json.loads(self._stream.readline())

    def open(self, for_s: float | None = None) -> None:
        now = self.now()
        self.call("open", now, None if for_s is None else now + for_s)

    def close(self) -> None:
        self.call("close", self.now())

    def is_open(self) -> bool:
        return bool(self.call("is_open", self.now()))

    def beam(self, on: bool) -> None:
        self.call("beam", self.now(), on)

    def lay(self, subject: str) -> None:
        self.call("lay", subject)

    def lit_share(self, start: float, end: float) -> float:
        return float(self.call("lit_share", start, end))

    def arm(self, device: str, fault: str) -> None:
        self.call("arm", self.now(), device, fault)

    def clear(self) -> None:
        self.call("clear", self.now())

    def fault(self, device: str) -> str | None:
        answer = self.call("fault", device)
        return str(answer) if answer else None

    def habits(self) -> list[str]:
        return list(self.call("habits"))

    def status(self) -> dict[str, Any]:
        return dict(self.call("status", self.now()))

    def release(self) -> None:
        self._stream.close()
        self._socket.close()


def serve(path: str) -> None:
    """Serve one world until the process is ended."""
    world, lock = World(), threading.Lock()

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            for line in self.rfile:
                verb, *arguments = json.loads(line)
                with lock:
                    answer = getattr(world, verb)(*arguments)
                self.wfile.write(json.dumps(answer).encode() + b"\n")

    class Server(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
        daemon_threads = True

    with Server(path, Handler) as server:
        print("ready", flush=True)
        server.serve_forever(poll_interval=0.05)


if __name__ == "__main__":
    serve(sys.argv[1])
