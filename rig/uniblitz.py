"""Uniblitz VMM shutter driver: single bytes, 64 opens and 65 closes; it never answers, so its state is assumed."""

from __future__ import annotations

from collections.abc import Callable

from bssrdf.errors import DeviceError
from bssrdf.rig.ports import Identity
from bssrdf.rig.serial_line import SerialLine, Wire, open_wire

BAUD = 9600
_OPEN, _CLOSE = b"@", b"A"


class UniblitzShutter:
    """The shutter of a VMM. Nothing in it closes the shutter when this program is killed."""

    after_kill = ""

    def __init__(
        self, port: str, *, timeout_s: float = 1.0, open_port: Callable[[str, int, float], Wire] = open_wire
    ) -> None:
        self.name = f"uniblitz on {port}"
        self._port, self._timeout_s, self._open_port = port, timeout_s, open_port
        self._line: SerialLine | None = None

    def connect(self) -> Identity:
        self._line = SerialLine(self.name, self._open_port(self._port, BAUD, self._timeout_s))
        self.close()
        return Identity("uniblitz", self._port, "assumed")

    def open_for(self, longest_s: float) -> None:
        self._send(_OPEN)

    def close(self) -> None:
        self._send(_CLOSE)

    def state(self) -> None:
        return None

    def release(self) -> None:
        if self._line is not None:
            self._line.release()
            self._line = None

    def _send(self, byte: bytes) -> None:
        if self._line is None:
            raise DeviceError(f"{self.name}: is not connected")
        self._line.send(byte)
