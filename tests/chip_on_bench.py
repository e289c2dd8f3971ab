"""The controller's firmware as a device of the simulated bench: `python chip_on_bench.py BUILD LINK WORLD SPEED`.

What its pins do is done to the world; the world's interlock is the chip's. The light is not: it would come too late.
"""

from __future__ import annotations

import contextlib
import select
import subprocess
import sys

from bssrdf.rig.sim.world_server import WorldClient

SET_UP = b"SHUT:TYPE TTL\n"
LOOK_S = 0.005


def main(build: str, link: str, world_path: str, speed: float) -> None:
    chip = subprocess.Popen(
        [f"{build}/chip", f"{build}/controller.elf", link, str(speed)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,
    )
    assert chip.stdin is not None
    assert chip.stdout is not None
    world = WorldClient(world_path, speed)
    while (words := chip.stdout.readline().split())[0] != b"ready":
        pass
    start_s = float(words[1])
    chip.stdin.write(f"send {SET_UP.hex()}\n".encode())
    world.beam(False)
    print("ready", flush=True)
    pending, was_tripped = b"", False
    while True:
        if select.select([chip.stdout], [], [], LOOK_S)[0]:
            if not (said := chip.stdout.read(4096)):
                return
            *lines, pending = (pending + said).split(b"\n")
            for line in lines:
                act(world, line.decode(), start_s)
        if (tripped := bool(world.status()["interlock"])) != was_tripped:
            chip.stdin.write(f"interlock {int(tripped)}\n".encode())
        was_tripped = tripped


def act(world: WorldClient, line: str, start_s: float) -> None:
    """Do to the world what a pin did, at its time."""
    pin, level, cycle = line.split()
    t = start_s * world.speed + int(cycle) / 16e6
    if pin == "shutter" and level == "1":
        world.call("open", t, None)
    elif pin == "shutter":
        world.call("close", t)
    elif pin == "beam":
        world.call("beam", t, level != "0")


if __name__ == "__main__":
    with contextlib.suppress(OSError, ValueError):  # the world has ended
        main(*sys.argv[1:4], float(sys.argv[4]))
