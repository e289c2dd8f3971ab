"""Which of the serial ports has the project's controller: its board says so when it starts.

Nothing is sent, since a byte may open the shutter of another device. Opening the port resets an Arduino, which then
says its name, as it would at the start of a capture; a port that a capture holds is left alone.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

from bssrdf.errors import DeviceError
from bssrdf.rig.locks import lock_ports
from bssrdf.rig.scpi import BAUD
from bssrdf.rig.serial_line import BadReply, SerialLine, Wire, open_wire

_BOARDS = (0x2341, 0x2A03, 0x1A86, 0x0403)
"""USB vendors of what a controller's board talks through: Arduino (two), WCH's CH340, FTDI."""
_LISTEN_S = 2.5
"""A bootloader takes 1 to 2 s before the firmware starts."""
_BANNER = re.compile(r"bssrdf rig (\S+) (\S+)")


class Port(Protocol):
    """What is used of pyserial's `ListPortInfo`."""

    device: str
    description: str
    vid: int | None


def described(ports: list[Port], *, open_port: Callable[[str, int, float], Wire] = open_wire) -> list[str]:
    """A line for each port; the boards among them are listened to at the same time."""
    with ThreadPoolExecutor(max(len(ports), 1)) as threads:
        return list(threads.map(lambda port: f"{port.device}: {_name(port, open_port)}", ports))


def _name(port: Port, open_port: Callable[[str, int, float], Wire]) -> str:
    if port.vid not in _BOARDS:
        return port.description
    try:
        with lock_ports({port.device}):
            controller = _controller(SerialLine(port.device, open_port(port.device, BAUD, _LISTEN_S)))
    except DeviceError as error:
        return f"{port.description} ({str(error).removeprefix(f'{port.device}: ')})"
    return f"{controller} ({port.description})" if controller else port.description


def _controller(line: SerialLine) -> str:
    """The controller's name as it starts, or nothing where another device is silent or says something else."""
    deadline = time.monotonic() + _LISTEN_S
    try:
        while time.monotonic() < deadline:
            heard = line.receive(b"\n", after=b"").decode("ascii", "replace")
            if found := _BANNER.search(heard):
                return f"bssrdf controller (driver scpi), serial number {found[1]}, firmware {found[2]}"
    except BadReply:
        pass
    finally:
        line.release()
    return ""
