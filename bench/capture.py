"""Capture under faults: every switch of the simulated bench at every step, kill −9, and what file safety costs."""

from __future__ import annotations

import math
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from bssrdf.errors import BssrdfError
from bssrdf.rig import BenchScene, Event, SimSensor, SimulatedBench, capture_session, published_sample, white_tile
from bssrdf.session import append_frame, recover_frames, sha256_of, sync
from bssrdf.session.records import Frame

SHUTTER_FAULTS = (
    "lost_command",
    "lost_reply",
    "late_reply",
    "garbled_reply",
    "partial_reply",
    "doubled_reply",
    "echo_lost",
    "unplug",
    "crash",
    "stuck_open",
    "stuck_closed",
    "interlock",
)
CAMERA_FAULTS = ("busy", "busy_always", "no_event", "wrong_exposure", "store_full", "truncated_file", "crash")
COMMAND_FAULTS = ("fails", "killed", "late")
COMMAND_SHUTTER_FAULTS = (*COMMAND_FAULTS, "fails after", "mumbles", "stuck_open", "stuck_closed")
COMMAND_CAMERA_FAULTS = (*COMMAND_FAULTS, "no_file", "truncated_file", "wrong_exposure")

PLAN = """\
drift_check = true
settle_s = 0.0
[material]
name = "Skin1"
eta = 1.3
[exposures]
list_s = [0.016, 0.001]
"""
N_FRAMES = 10

_COMMANDS_A_FRAME = 8
"""Commands to the shutter within which a fault is put."""
_SELF_CLOSE_S = 8.0
"""Longest time in which a controller that cannot be reached any more closes by itself."""
BENCHES = (
    ("sc10", "gphoto2", _SELF_CLOSE_S),
    ("scpi", "gphoto2", 2.0),
    ("command", "command", math.inf),
    ("manual", "command", math.inf),
)
"""Drivers of shutter and camera, and the time in which the shutter closes when the capture is killed."""


@dataclass(frozen=True)
class Run:
    """What one disturbed capture came to; `problems` is empty where all is as it should be."""

    device: str
    fault: str
    frame: int
    message: str
    """The error that the capture ended with, or nothing where it coped."""
    problems: tuple[str, ...]


def small_scene() -> BenchScene:
    """A bench whose frames are small and the same each time, so that a resumed capture can be compared."""
    sensor = SimSensor(height_px=80, width_px=120)
    return BenchScene(published_sample("Skin1"), white_tile(), sensor, mm_per_px=0.2, noise="repeatable")


class Campaign:
    """Disturbs captures on one bench and holds them against an undisturbed one."""

    def __init__(self, bench: SimulatedBench, folder: Path) -> None:
        self._bench, self._folder = bench, folder
        self._names = {
            "camera": ("gphoto2 camera", "command camera"),
            "shutter": (str(bench.folder / "shutter"), "command shutter", "command beam", "manual shutter"),
        }
        self._plan = folder / "plan.toml"
        self._plan.write_text(PLAN, encoding="utf-8")
        self._expected = self._listed(self._capture(folder / "undisturbed"))

    def disturb(self, device: str, fault: str, frame: int, after: int = 0) -> Run:
        """Play a fault `after` so many commands from the start of a frame; then repair, resume and compare."""
        session = self._fresh("disturbed")
        problems, message = [], ""

        def arm(event: Event) -> None:
            if event.what == "start" and event.number == frame:
                for _ in range(after):
                    self._bench.world.arm(device, "none")
                self._bench.world.arm(device, fault)

        try:
            self._capture(session, report=arm)
        except BssrdfError as error:
            message = str(error)
            if not any(name in message for name in self._names[device]):
                problems.append("the message does not name the device")
        if not self._dark(fault):
            problems.append("light falls on the sample")
        if fault == "stuck_open" and message and "by hand" not in message:
            problems.append("nobody is told to block the beam")
        problems += self._lost(session)
        self.repair()
        if message:
            self._capture(session, resume=True)
        if self._listed(session) != self._expected:
            problems.append("the session differs from an undisturbed one")
        return Run(device, fault, frame, message, tuple(problems))

    def kill(self, delay_s: float, within_s: float) -> Run:
        """Kill a capture in its own process after a while by SIGKILL; then resume and compare.

        `within_s` is the time in which the world's shutter must be closed after the kill; infinite where nothing
        closes it.
        """
        session = self._fresh("killed")
        code = "import sys; from pathlib import Path as P; from bssrdf.rig.capture import capture_session; "
        code += "capture_session(*map(P, sys.argv[1:]))"
        words = [sys.executable, "-c", code, *map(str, (self._plan, self._bench.rig_file, session))]
        process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        deadline = time.monotonic() + 30
        while not (session / "frames.csv").exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(delay_s)
        process.send_signal(signal.SIGKILL)
        process.wait()
        problems = [] if math.isinf(within_s) or self._closes(within_s) else ["the shutter is open"]
        problems += self._lost(session)
        files = len(list((session / "frames").glob("*"))) - len(recover_frames(session))
        if files > 1:
            problems.append(f"{files} frames were not journalled")
        self._capture(session, resume=True)
        if self._listed(session) != self._expected:
            problems.append("the session differs from an undisturbed one")
        return Run("host", "kill -9", 0, f"after {delay_s:.2f} s", tuple(problems))

    def repair(self) -> None:
        """Bring the bench back to what it was."""
        self._bench.world.clear()
        for part in self._bench.with_process:
            if not self._bench.alive(part) or (part == "shutter" and not (self._bench.folder / "shutter").exists()):
                self._bench.start(part)

    def _capture(self, session: Path, *, resume: bool = False, report: Callable[[Event], None] | None = None) -> Path:
        capture_session(self._plan, self._bench.rig_file, session, resume=resume, report=report)
        return session

    def _fresh(self, name: str) -> Path:
        session = self._folder / name
        shutil.rmtree(session, ignore_errors=True)
        return session

    def _listed(self, session: Path) -> list[tuple[str, str, float, str | None]]:
        return [(frame.file, frame.kind, frame.exposure_s, frame.sha256) for frame in recover_frames(session)]

    def _dark(self, fault: str) -> bool:
        """No light falls, asked of the world; a blade stuck open cannot be helped where the beam has no switch."""
        return self._closes(_SELF_CLOSE_S) or (fault == "stuck_open" and self._bench.world.status()["open"])

    def _closes(self, within_s: float) -> bool:
        deadline = time.monotonic() + within_s
        while self._bench.world.status()["lit"]:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)
        return True

    def _lost(self, session: Path) -> list[str]:
        """Journalled frames that are not what they were."""
        there = {frame.file: frame.sha256 for frame in recover_frames(session)}
        expected = {file: sha256 for file, _, _, sha256 in self._expected}
        wrong = [file for file, sha256 in there.items() if sha256_of(session / file) != sha256]
        wrong += [file for file, sha256 in there.items() if expected.get(file) != sha256]
        return [f"{file} is not as it was taken" for file in wrong]


def faults_of(shutter: str, camera: str) -> tuple[Sequence[str], Sequence[str]]:
    """What may go wrong with a shutter and with a camera of these drivers; a person makes no fault here."""
    of_shutter = {"manual": (), "command": COMMAND_SHUTTER_FAULTS}
    return of_shutter.get(shutter, SHUTTER_FAULTS), COMMAND_CAMERA_FAULTS if camera == "command" else CAMERA_FAULTS


def every_fault(
    seed: int = 1, shutter: Sequence[str] = SHUTTER_FAULTS, camera: Sequence[str] = CAMERA_FAULTS
) -> list[tuple[str, str, int, int]]:
    """Each switch at each frame, at a random command of it: arguments of `Campaign.disturb`."""
    rng = random.Random(seed)
    faults = [("shutter", fault) for fault in shutter] + [("camera", fault) for fault in camera]
    return [
        (device, fault, frame, rng.randrange(_COMMANDS_A_FRAME) if device == "shutter" else 0)
        for device, fault in faults
        for frame in range(1, N_FRAMES + 1)
    ]


def file_safety_ms(folder: Path, megabytes: int = 25, frames: int = 20) -> float:
    """Median cost [ms] of syncing, renaming, hashing and journalling a frame, beyond writing its file."""
    content = np.random.default_rng(1).bytes(megabytes * 1_000_000)
    folder.mkdir(parents=True, exist_ok=True)
    costs = []
    for number in range(frames):
        part, target = folder / f"{number}.part", folder / f"{number}.dng"
        part.write_bytes(content)
        start = time.perf_counter()
        sync(part)
        part.rename(target)
        sync(folder)
        append_frame(folder, Frame(target.name, "sample", 1.0, sha256=sha256_of(target)))
        costs.append(1e3 * (time.perf_counter() - start))
    return median(costs)


def run_bench(folder: Path, *, kills: int = 100, seed: int = 1) -> str:
    """The whole campaign over every controller, and the kills; a summary, with each problem on a line of its own."""
    lines = [f"file safety: {file_safety_ms(folder / 'files'):.0f} ms a frame of 25 MB"]
    rng = random.Random(seed)
    for shutter, camera, within_s in BENCHES:
        place = folder / shutter
        place.mkdir(parents=True)
        bench = SimulatedBench(place, small_scene(), shutter=shutter, camera=camera)
        try:
            campaign = Campaign(bench, place)
            runs = [campaign.disturb(*arguments) for arguments in every_fault(seed, *faults_of(shutter, camera))]
            runs += [campaign.kill(rng.uniform(0, 2.0), within_s) for _ in range(kills // len(BENCHES))]
        finally:
            bench.stop()
        lines.append(f"{shutter}: {len(runs)} runs, {sum(bool(run.problems) for run in runs)} with problems")
        lines += [f"  {run}" for run in runs if run.problems]
    return "\n".join(lines)


if __name__ == "__main__":
    print(run_bench(Path(sys.argv[1])))
