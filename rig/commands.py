"""What `bssrdf capture`, `bssrdf rig` and `bssrdf doctor` call."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from bssrdf.errors import BssrdfError, DeviceError, UsageError
from bssrdf.rig.capture import Captured, Report, capture_session
from bssrdf.rig.devices import devices_of, ports_of
from bssrdf.rig.drivers import PARTS, names
from bssrdf.rig.find import described
from bssrdf.rig.locks import check_ports, lock_ports
from bssrdf.rig.plan_toml import CapturePlan, read_plan
from bssrdf.rig.pulse_test import pulse_test
from bssrdf.rig.rig_toml import Rig, read_rig
from bssrdf.rig.steps import Step, snapped, steps_of

_DEFAULT_RIG = Path("rig.toml")
_OVERHEAD_S = 0.5
"""Typical time around an exposure: shutter, transfer, check."""


def run_capture(
    plan: Path,
    session: Path,
    *,
    rig: Path | None = None,
    resume: bool = False,
    simulate: bool = False,
    report: Report | None = None,
) -> Captured:
    """Capture a session; `rig` defaults to rig.toml in the working folder, or to the simulated bench."""
    truth = session.with_name(f"{session.name}.truth.json")
    with _bench(plan, rig, simulate, truth) as rig_file:
        return capture_session(plan, rig_file, session, resume=resume, report=report)


def dry_run(plan: Path, session: Path, *, rig: Path | None = None, simulate: bool = False) -> str:
    """What a capture would do, as text: each frame, its exposure as the camera has it, duration, bytes, disk free.

    Nothing is written, and neither shutter nor beam is touched.
    """
    with _bench(plan, rig, simulate) as rig_file:
        return _outlook(read_plan(plan), read_rig(rig_file), session)


def rig_list(*, listen: bool = False) -> list[str]:
    """Serial ports and cameras that are connected, and the drivers that are installed, one per line.

    `listen` opens the ports of boards, and names the controllers among them.
    """
    from serial.tools import list_ports

    ports = sorted(list_ports.comports())
    lines = described(ports) if listen else [f"{port.device}: {port.description}" for port in ports]
    lines += cameras()
    lines = lines or ["no serial port and no camera is connected"]
    return [*lines, *(f"drivers for [{part}]: {', '.join(names(part))}" for part in PARTS)]


def cameras() -> list[str]:
    """Cameras that libgphoto2 sees, asked in a process of its own; none where it is not installed."""
    import subprocess
    import sys

    words = [sys.executable, "-c", "import gphoto2; [print(f'{p}: {n}') for n, p in gphoto2.Camera.autodetect()]"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=20)
    except subprocess.TimeoutExpired:
        return ["gphoto2: did not answer within 20 s; unplug the camera and plug it in again"]
    return done.stdout.splitlines()


def rig_status(rig: Path | None = None) -> list[str]:
    """Each device of the bench and its state, one per line; the shutter is closed by connecting to it."""
    described = read_rig(rig or _DEFAULT_RIG)
    with lock_ports(ports_of(described)):
        devices = devices_of(described)
        try:
            found = devices.connect()
            lines = [f"{part}: {one.driver} {one.port} {one.version}".rstrip() for part, one in found.items()]
            lines.append(f"shutter is {devices.shutter.state() or 'assumed closed'}")
            return [*lines, f"if this program is killed: {_after_kill(devices.shutter.after_kill)}"]
        finally:
            devices.release()


def rig_test(rig: Path | None = None, *, set_clock: bool = False) -> Iterator[str]:
    """Pulses of the project's controller as it measures them, and its clock, line by line."""
    yield from pulse_test(rig or _DEFAULT_RIG, set_clock=set_clock)


def rig_close(rig: Path | None = None) -> list[str]:
    """Close the shutter and switch the beam off, even while another program holds the ports; what was done."""
    devices = devices_of(read_rig(rig or _DEFAULT_RIG))
    done, failures = [], []
    for device, act, word in (
        (devices.shutter, devices.shutter.close, "closed"),
        (devices.beam, devices.beam.off, "off"),
    ):
        try:
            device.connect()
            act()
            done.append(f"{device.name}: {word}")
        except BssrdfError as error:
            failures.append(str(error))
    devices.release()
    if failures:
        raise DeviceError("; ".join([*done, *failures, "block the beam by hand"]))
    return done


@contextmanager
def _bench(plan: Path, rig: Path | None, simulate: bool, truth: Path | None = None) -> Iterator[Path]:
    """The rig.toml to use; with `simulate` that of a bench which stands as long as the block lasts.

    What is true on it is written to `truth`.
    """
    if not simulate:
        yield rig or _DEFAULT_RIG
        return
    if rig is not None:
        raise UsageError(f"--simulate brings its own bench; leave out --rig {rig}")
    from bssrdf.rig.sim.launch import simulated_bench
    from bssrdf.rig.sim.media import sample_of, white_tile
    from bssrdf.rig.sim.scene import BenchScene

    scene = BenchScene(sample_of(read_plan(plan).material), white_tile())
    with simulated_bench(scene) as bench:
        if truth is not None:
            truth.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(bench.scene_file, truth)
        yield bench.rig_file


def _outlook(plan: CapturePlan, rig: Rig, session: Path) -> str:
    devices = devices_of(rig)
    check_ports(ports_of(rig))
    try:
        devices.camera.connect()
        offered = devices.camera.exposures_s()
    finally:
        devices.camera.release()
    folder = next(parent for parent in (session, *session.absolute().parents) if parent.exists())
    free_gb = shutil.disk_usage(folder).free / 1e9
    tail = [f"disk free: {free_gb:.1f} GB", f"if this program is killed: {_after_kill(devices.shutter.after_kill)}"]
    if not plan.list_s:
        return "\n".join(["exposures: chosen by metering shots when the capture begins", *tail])
    steps = steps_of(plan, dict.fromkeys(plan.kinds, snapped(plan.list_s, offered)))
    duration_s = sum(step.exposure_s + plan.settle_s + _OVERHEAD_S for step in steps)
    lines = [f"{step.name}: {step.kind} {step.exposure_s:g} s" for step in steps]
    lines.append(
        f"{len(steps)} frames, about {duration_s / 60:.1f} min, about {len(steps) * rig.frame_mb / 1e3:.2f} GB"
    )
    if devices.by_hand:
        order = "" if plan.order == "blocks" else '; fewer with order = "blocks"'
        lines.append(f"the card is moved {_moves(steps)} times by hand{order}")
    return "\n".join([*lines, *tail])


def _moves(steps: Sequence[Step]) -> int:
    """How often a card is put or taken: before each subject and at the end it is in the beam."""
    moves, lit, subject = 0, False, None
    for step in steps:
        moves += lit and step.subject != subject
        lit = lit and step.subject == subject
        moves += lit != step.lit
        lit, subject = step.lit, step.subject
    return moves + lit


def _after_kill(words: str) -> str:
    return words or "NOTHING closes the shutter; stay beside it, or use a controller with a timer or a watchdog"
