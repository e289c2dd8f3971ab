"""A simulated shutter or lamp as a program: `python -m bssrdf.rig.sim.command_shutter WORLD SPEED VERB`.

VERB is open, close, state, on or off. Faults that the world may have it play: fails, killed, late, fails after (it has
acted), mumbles (prints something that is not a state).
"""

from __future__ import annotations

import os
import signal
import sys
import time

from bssrdf.rig.sim.world_server import WorldClient

LATE_S = 60.0


def disturbed(fault: str | None) -> None:
    """Play what a program may do instead of its work."""
    if fault == "fails":
        sys.exit("the relay does not answer")
    if fault == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if fault == "late":
        time.sleep(LATE_S)


def main(world_path: str, speed: str, verb: str) -> None:
    """Do it."""
    world = WorldClient(world_path, float(speed))
    fault = world.fault("shutter")
    disturbed(fault)
    if verb == "state":
        print("ajar" if fault == "mumbles" else "open" if world.is_open() else "closed")
    elif verb in ("on", "off"):
        world.beam(verb == "on")
    else:
        getattr(world, verb)()
    if fault == "fails after":
        sys.exit("the relay does not answer")


if __name__ == "__main__":
    main(*sys.argv[1:])
