"""A simulated serial device as a process: `python -m bssrdf.rig.sim.serial_process DEVICE LINK WORLD SPEED`.

LINK is made to point at the pty, as udev does for a real port. A pty has no baud rate to get wrong.
"""

from __future__ import annotations

import os
import pty
import select
import sys
import time
import tty
from pathlib import Path

from bssrdf.rig.sim.serial_devices import DEVICES, SerialDevice
from bssrdf.rig.sim.world_server import WorldClient

LATE_S = 0.6
"""Delay of a late reply; drivers on the simulated bench wait for less."""
_IDLE_S = 0.02


def serve(device: SerialDevice, link: Path, world: WorldClient) -> None:
    """Play the device on a pty until the process is ended."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    link.unlink(missing_ok=True)
    link.symlink_to(os.ttyname(slave))
    print("ready", flush=True)
    os.write(master, device.banner)
    incoming = b""
    while True:
        readable, _, _ = select.select([master], [], [], _IDLE_S)
        if not readable:
            device.idle()
            continue
        incoming += os.read(master, 4096)
        command, incoming = device.take(incoming)
        while command is not None:
            fault = world.fault("shutter")
            if fault == "unplug":
                _unplugged(device, link, [master, slave])
            if fault == "crash":
                world.close()  # without power the spring closes the blade
                os._exit(1)
            os.write(master, _reply(device, command, fault))
            command, incoming = device.take(incoming)


def _reply(device: SerialDevice, command: bytes, fault: str | None) -> bytes:
    """What comes back on the line, with the fault played."""
    if fault == "lost_command":
        return b""
    echo, reply = device.execute(command)
    if fault == "late_reply":
        time.sleep(LATE_S)
    answers = {
        "lost_reply": b"",
        "echo_lost": reply,
        "garbled_reply": bytes(byte ^ 0x15 for byte in echo + reply),
        "partial_reply": (echo + reply)[:-2],
        "doubled_reply": 2 * (echo + reply),
    }
    return answers.get(fault or "", echo + reply)


def _unplugged(device: SerialDevice, link: Path, handles: list[int]) -> None:
    """The cable is out; the device goes on by itself."""
    link.unlink(missing_ok=True)
    for handle in handles:
        os.close(handle)
    while True:
        time.sleep(_IDLE_S)
        device.idle()


if __name__ == "__main__":
    _, name, link_path, world_path, speed = sys.argv
    client = WorldClient(world_path, float(speed))
    serve(DEVICES[name](client), Path(link_path), client)
