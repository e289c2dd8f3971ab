"""The capture engine: frame by frame, each checked before it counts, the shutter closed first in every way out."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

from bssrdf.errors import DeviceError, UsageError
from bssrdf.rig.devices import Devices, devices_of, ports_of
from bssrdf.rig.frame_check import SeenFrame, check, drift
from bssrdf.rig.interrupts import Interrupts, interrupts
from bssrdf.rig.locks import lock_ports, lock_session
from bssrdf.rig.metering import metered
from bssrdf.rig.plan_toml import CapturePlan, Subject, read_plan
from bssrdf.rig.ports import BadShot
from bssrdf.rig.record import Record, begin, frames_there, resumed, write_record
from bssrdf.rig.rig_toml import Rig, read_rig
from bssrdf.rig.steps import Step, snapped, steps_of
from bssrdf.session import SAME_EXPOSURE, append_frame, card_of_file, differences, sha256_of, sync
from bssrdf.session.records import Frame

DRIFT_FLAGGED = 0.003
_TRIES = 3
_ISO_ROUNDED = 0.05
"""Relative; the next step of ISO is 26 % off."""
_WATCH_S = 0.25
"""How often the shutter is asked for its state during an exposure."""


class Event(NamedTuple):
    """What the engine tells while it works."""

    what: Literal["start", "done", "rejected", "drift"]
    step: Step
    number: int
    total: int
    left_s: float
    peak: float = 0.0
    """Brightest pixel over the white level."""
    message: str = ""


Report = Callable[[Event], None]


@dataclass(frozen=True)
class Captured:
    """A finished session."""

    frames: int
    taken_now: int
    drift: dict[str, float]


def capture_session(
    plan_file: Path, rig_file: Path, session: Path, *, resume: bool = False, report: Report | None = None
) -> Captured:
    """Capture what the plan asks for into `session`, or go on with it.

    DeviceError where a device fails, with the shutter closed; KeyboardInterrupt where a signal stopped it, likewise.
    Everything journalled until then is kept, and `resume` goes on from there.
    """
    plan, rig = read_plan(plan_file), read_rig(rig_file)
    if resume and not (session / "capture.toml").is_file():
        raise UsageError(f"{session}: holds no capture to go on with; start it without --resume")
    if not resume and session.exists() and any(session.iterdir()):
        raise UsageError(f"{session}: exists already; choose another --out, or go on with --resume")
    with ExitStack() as held:
        held.enter_context(lock_ports(ports_of(rig)))
        session.mkdir(parents=True, exist_ok=True)
        held.enter_context(lock_session(session))
        signals = held.enter_context(interrupts())
        devices = devices_of(rig, signals)
        held.enter_context(safe(devices, signals))
        run = _Run(plan, rig, devices, session, signals, report or (lambda event: None))
        return run.resume() if resume else run.start(plan_file)


@contextmanager
def safe(devices: Devices, signals: Interrupts) -> Iterator[None]:
    """However the block ends, the shutter is closed first, then the beam is switched off and the ports are let go."""
    try:
        yield
    except BaseException as failure:
        signals.making_safe = True
        if problem := make_safe(devices):
            raise DeviceError(f"{failure}; then {problem}: block the beam by hand") from failure
        raise
    else:
        signals.making_safe = True
        if problem := make_safe(devices):
            raise DeviceError(f"{problem}: block the beam by hand")


def make_safe(devices: Devices) -> str:
    """Close the shutter, switch the beam off, release; what did not work, or nothing."""
    problem = ""
    for _ in range(1 if devices.by_hand else _TRIES):
        try:
            devices.shutter.close()
            problem = ""
            break
        except DeviceError as error:
            problem = f"closing the shutter failed ({error}), so that its state is unknown"
            with contextlib.suppress(DeviceError):  # a port that was lost may be back
                devices.shutter.release()
                devices.shutter.connect()
    try:
        devices.beam.off()
    except DeviceError as error:
        problem = f"{problem or 'the shutter is closed'}, but the beam did not go off ({error})"
    devices.release()
    return problem


def _same(one_s: float, other_s: float) -> bool:
    return math.isclose(one_s, other_s, rel_tol=SAME_EXPOSURE)


class _Run:
    """One capture."""

    def __init__(
        self, plan: CapturePlan, rig: Rig, devices: Devices, session: Path, signals: Interrupts, report: Report
    ) -> None:
        self._plan, self._rig, self._session = plan, rig, session
        self._devices, self._signals, self._report = devices, signals, report
        self._white = rig.session_tables["camera"].white
        self._laid: Subject | None = None
        self._first: dict[Subject, SeenFrame] = {}
        self._before: dict[Subject, SeenFrame] = {}
        self._drift: dict[str, float] = {}
        self._kept: list[Frame] = []
        self._watched = 0.0
        self._overhead_s = 0.5

    def start(self, plan_file: Path) -> Captured:
        identities = self._devices.connect()
        self._devices.beam.on()
        exposures = self._exposures()
        started = self._devices.clock.utc()
        record = Record(identities, self._devices.camera.settings(), exposures, started)
        begin(self._session, plan_file, self._plan, self._rig, record)
        return self._take_all(record, [])

    def resume(self) -> Captured:
        there = frames_there(self._session)
        identities = self._devices.connect()
        record = resumed(self._session, self._plan, identities, self._devices.camera.settings())
        self._devices.beam.on()
        return self._take_all(record, there)

    def _exposures(self) -> dict[Subject, tuple[float, ...]]:
        offered = self._devices.camera.exposures_s()
        if self._plan.list_s:
            times = snapped(self._plan.list_s, offered)
            return dict.fromkeys(self._plan.kinds, times)
        return {subject: self._meter(subject, offered) for subject in self._plan.kinds}

    def _meter(self, subject: Subject, offered: tuple[float, ...]) -> tuple[float, ...]:
        self._lay(subject)
        part = self._session / "metering"

        def shot(exposure_s: float) -> SeenFrame:
            file = self._expose(Step("metering", subject, exposure_s), part)
            try:
                seen, wrong = check(file, Step("metering", subject, exposure_s), None, self._white)
            finally:
                file.unlink()
            if seen is None:
                raise DeviceError(f"{self._devices.camera.name}: metering shot of {exposure_s:g} s: {wrong}")
            return seen

        return metered(shot, offered)

    def _take_all(self, record: Record, there: list[Frame]) -> Captured:
        steps = steps_of(self._plan, record.exposures_s)
        done = {Path(frame.file).stem: self._session / frame.file for frame in there}
        self._kept = list(there)
        compared = self._compared([step for step in steps if step.name in done])
        for number, step in enumerate(steps, 1):
            event = Event("start", step, number, len(steps), self._left_s(steps[number - 1 :]))
            if step.name in done:
                if step in compared:
                    self._remember(step, self._seen(done[step.name], step), event)
                continue
            if self._signals.finish_frame:
                raise KeyboardInterrupt
            self._report(event)
            began = time.monotonic()
            self._remember(step, self._take(step, event), event)
            self._overhead_s = time.monotonic() - began - step.exposure_s / self._devices.clock.speed
        write_record(self._session, replace(record, finished=self._devices.clock.utc(), drift=self._drift))
        return Captured(len(steps), len(steps) - len(there), self._drift)

    def _left_s(self, steps: list[Step]) -> float:
        """Time that the steps will take, each with as much around it as the last one had."""
        return sum(step.exposure_s / self._devices.clock.speed + self._overhead_s for step in steps)

    def _compared(self, done: list[Step]) -> set[Step]:
        """The frames that new ones are compared with: the first and the last of each subject."""
        lit = [[step for step in done if step.lit and step.subject == subject] for subject in self._plan.kinds]
        return {step for steps in lit for step in (*steps[:1], *steps[-1:])}

    def _take(self, step: Step, event: Event) -> SeenFrame:
        """One frame that passes its check, on disk and in the journal."""
        self._lay(step.subject)
        wrong = ""
        for _ in range(_TRIES):
            file = self._expose(step, self._session / "frames" / f"{step.name}.part")
            seen, wrong = check(file, step, self._longer(step), self._white)
            frame = self._line(step, file, seen)
            wrong = self._set_otherwise(frame) or self._taken_before(frame, seen) or wrong
            if seen is not None and not wrong:
                self._keep(step, file, frame)
                self._report(event._replace(what="done", peak=seen.peak))
                return seen
            file.unlink()
            self._report(event._replace(what="rejected", message=wrong))
            if self._devices.by_hand:
                self._devices.shutter.release()  # the person may have moved it wrongly: ask again
        raise DeviceError(
            f"{self._devices.camera.name} with {self._devices.shutter.name}: frame {step.name} was wrong "
            f"{_TRIES} times, at last because {wrong}; fix that and go on with --resume"
        )

    def _longer(self, step: Step) -> SeenFrame | None:
        """The last frame of the subject, or its first one where that was the longer: short ones are too noisy."""
        before = self._before.get(step.subject)
        return before if before is None or before.exposure_s >= step.exposure_s else self._first[step.subject]

    def _expose(self, step: Step, part: Path) -> Path:
        """Take a frame, with another shot where one went wrong."""
        for _ in range(_TRIES - 1):
            try:
                return self._shot(step, part)
            except BadShot:
                if not self._devices.by_hand:
                    self._devices.shutter.close()
        return self._shot(step, part)

    def _shot(self, step: Step, part: Path) -> Path:
        """One shot with the shutter as the step wants it; closed when this returns, unless a person is the shutter."""
        shutter, camera = self._devices.shutter, self._devices.camera
        if not step.lit:
            self._shut()
            return camera.take(step.exposure_s, part, self._keep_alive)
        shutter.open_for(self._longest_open_s(step))
        if self._devices.by_hand:
            self._light_again()
        self._settle()
        file = camera.take(step.exposure_s, part, self._keep_alive)
        try:
            self._expect_shutter("open")
        except DeviceError:
            file.unlink()
            raise
        if not self._devices.by_hand:
            shutter.close()
        return file

    def _shut(self) -> None:
        """Have the shutter closed: a card that a person moves may still be out from the frames before."""
        if self._devices.by_hand:
            self._devices.shutter.close()
        self._expect_shutter("closed")

    def _longest_open_s(self, step: Step) -> float:
        """The frame's own time and all that the camera may take around it, on the bench's clock."""
        overhead_s = self._devices.camera.overhead_s + 2
        return step.exposure_s + self._plan.settle_s + overhead_s * self._devices.clock.speed

    def _expect_shutter(self, wanted: str) -> None:
        state = self._devices.shutter.state()
        if state not in (wanted, None):
            raise DeviceError(f"{self._devices.shutter.name}: is {state} when it should be {wanted}; check interlock")

    def _keep_alive(self) -> None:
        """Talk to the controllers now and then, so that their watchdogs see that we live."""
        if self._devices.pings and time.monotonic() - self._watched > _WATCH_S:
            for ping in self._devices.pings:
                ping()
            self._watched = time.monotonic()

    def _settle(self) -> None:
        left = self._plan.settle_s
        while left > 0:
            part = min(left, _WATCH_S * self._devices.clock.speed)
            self._devices.clock.sleep(part)
            self._keep_alive()
            left -= part

    def _line(self, step: Step, file: Path, seen: SeenFrame | None) -> Frame:
        """The frame's line of frames.csv, with what its file says of itself."""
        name = f"frames/{step.name}{file.suffix}"
        exposure_s, rel_sd = (seen.exposure_s, seen.exposure_rel_sd) if seen is not None else (step.exposure_s, None)
        return Frame(
            name, step.kind, exposure_s, sha256=sha256_of(file), exposure_rel_sd=rel_sd, card=card_of_file(file)
        )

    def _set_otherwise(self, frame: Frame) -> str:
        """How the file's own words differ from the camera's settings, or from the frames before; else nothing."""
        iso = self._devices.camera.settings().get("iso", "")
        if iso.isdecimal() and frame.card.iso and abs(frame.card.iso / int(iso) - 1) > _ISO_ROUNDED:
            return f"it has ISO {frame.card.iso:g}, but the camera is set to {iso}: is its ISO automatic?"
        return next((f"it {unlike.fact}" for unlike in differences([*self._kept, frame])), "")

    def _taken_before(self, frame: Frame, seen: SeenFrame | None) -> str:
        """The frame of another step that this one is a copy of; darks that are clipped to zero may be alike."""
        if seen is None or not seen.is_lit:
            return ""
        alike = (other for other in self._kept if other.sha256 == frame.sha256)
        other = next((one for one in alike if (one.kind, one.exposure_s) != (frame.kind, frame.exposure_s)), None)
        return f"it is the file of {other.file} again" if other else ""

    def _keep(self, step: Step, file: Path, frame: Frame) -> None:
        """Have the frame on disk under its own name, and then in the journal."""
        sync(file)
        target = file.with_name(step.name + file.suffix)
        file.rename(target)
        sync(target.parent)
        frame = replace(frame, utc=self._devices.clock.utc())
        append_frame(self._session, frame)
        self._kept.append(frame)

    def _seen(self, file: Path, step: Step) -> SeenFrame:
        seen, wrong = check(file, step, None, self._white)
        if seen is None:
            raise DeviceError(f"{file}: {wrong}; start a new session")
        return seen

    def _remember(self, step: Step, seen: SeenFrame, event: Event) -> None:
        if not step.lit:
            return
        first = self._first.setdefault(step.subject, seen)
        if step.subject in self._before and seen is not first and _same(seen.exposure_s, first.exposure_s):
            self._drift[step.subject] = drift(first, seen)
            if abs(self._drift[step.subject]) > DRIFT_FLAGGED:
                change = f"{step.subject} changed by {100 * self._drift[step.subject]:+.2f} % from begin to end"
                self._report(event._replace(what="drift", message=change))
        self._before[step.subject] = seen

    def _light_again(self) -> None:
        """A watchdog has put the beam out while a person worked."""
        if self._devices.pings:
            self._devices.beam.on()

    def _lay(self, subject: Subject) -> None:
        if self._laid != subject:
            self._shut()
            self._devices.operator.lay(subject)
            self._light_again()
            self._laid = subject
