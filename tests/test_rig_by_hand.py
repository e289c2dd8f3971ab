"""One person, a card and a script as the camera: the capture asks, waits, and never believes a frame blindly."""

from __future__ import annotations

import copy
import io
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile

from bssrdf.bench.capture import (
    COMMAND_CAMERA_FAULTS,
    COMMAND_SHUTTER_FAULTS,
    Campaign,
    every_fault,
    small_scene,
)
from bssrdf.errors import DeviceError
from bssrdf.rig.capture import capture_session
from bssrdf.rig.commands import dry_run, rig_close
from bssrdf.rig.interrupts import Interrupts
from bssrdf.rig.locks import lock_ports
from bssrdf.rig.manual import ManualShutter
from bssrdf.rig.operators import ConsoleOperator
from bssrdf.rig.sim.launch import SimulatedBench
from bssrdf.session.frames_csv import read_frames

PLAN = """\
kinds = ["sample"]
settle_s = 0.0
order = "blocks"
drift_check = false
[material]
name = "Skin1"
eta = 1.3
[exposures]
list_s = [0.016, 0.001]
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedBench]:
    """Shutter, beam and camera by commands; this is the setting of most tests below, with a card for a shutter."""
    started = SimulatedBench(tmp_path_factory.mktemp("bench"), small_scene(), shutter="command", camera="command")
    yield started
    started.stop()


@pytest.fixture
def mended(bench: SimulatedBench) -> Iterator[SimulatedBench]:
    bench.world.clear()
    bench.world.close()
    bench.world.beam(True)
    yield bench
    bench.world.clear()


def by_hand(bench: SimulatedBench, folder: Path, *, simulated: bool) -> SimulatedBench:
    """The same bench with a card as its shutter, moved by the simulated person or by the one at the keyboard."""
    text = bench.rig_file.read_text(encoding="utf-8")
    text = re.sub(r"\[shutter\].*?(?=\[camera\])", '[shutter]\ndriver = "manual"\n', text, flags=re.DOTALL)
    if not simulated:
        text = text.split("[simulated]")[0]
    other = copy.copy(bench)
    other.rig_file = folder / "rig.toml"
    other.rig_file.write_text(text, encoding="utf-8")
    return other


def test_a_script_that_goes_wrong_costs_no_frame(mended: SimulatedBench, tmp_path: Path) -> None:
    campaign = Campaign(by_hand(mended, tmp_path, simulated=True), tmp_path)
    for frame, fault in enumerate(("killed", "no_file", "truncated_file", "late"), 3):
        run = campaign.disturb("camera", fault, frame)
        assert not run.problems, run
        assert ("command camera" in run.message) == (fault != "truncated_file")


def test_commands_of_a_shutter_that_go_wrong_leave_no_light(mended: SimulatedBench, tmp_path: Path) -> None:
    campaign = Campaign(mended, tmp_path)
    for fault, after in (("fails after", 0), ("stuck_open", 2)):
        run = campaign.disturb("shutter", fault, 1, after)
        assert not run.problems, run
        assert "command shutter" in run.message
        assert ("state is unknown" in run.message) == (fault == "stuck_open")


@pytest.mark.slow
@pytest.mark.parametrize("hand", [True, False])
def test_every_fault_of_a_program_at_every_frame(mended: SimulatedBench, tmp_path: Path, hand: bool) -> None:
    campaign = Campaign(by_hand(mended, tmp_path, simulated=True) if hand else mended, tmp_path)
    faults = every_fault(3, () if hand else COMMAND_SHUTTER_FAULTS, COMMAND_CAMERA_FAULTS)
    assert not [run for arguments in faults if (run := campaign.disturb(*arguments)).problems]


def test_a_script_that_brings_an_old_frame_again_is_found_out(mended: SimulatedBench, tmp_path: Path) -> None:
    """Its files say no exposure, and the light of a lamp half as bright would fit it."""
    hand, plan = by_hand(mended, tmp_path, simulated=True), tmp_path / "plan.toml"
    plan.write_text(PLAN.replace("0.001]", "0.0155]"), encoding="utf-8")
    data = np.random.default_rng(0).normal(500, 3, (80, 120))
    data[30:50, 50:70] += 3000
    tifffile.imwrite(tmp_path / "old.tif", data.astype(np.uint16), photometric="minisblack")
    text = hand.rig_file.read_text(encoding="utf-8")
    text = re.sub(r"expose = .*", f"expose = \"sh -c 'cp {tmp_path}/old.tif $1.tif' {{exposure_s}} {{out}}\"", text)
    hand.rig_file.write_text(text, encoding="utf-8")
    with pytest.raises(DeviceError, match=r"it is the file of frames/001_sample_16ms\.tif again"):
        capture_session(plan, hand.rig_file, tmp_path / "s")


def test_a_dry_run_counts_moves_by_hand_and_writes_nothing(
    mended: SimulatedBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    hand, plan = by_hand(mended, tmp_path, simulated=False), tmp_path / "plan.toml"
    plan.write_text(PLAN, encoding="utf-8")
    before = {file: file.is_file() and file.read_bytes() for file in tmp_path.rglob("*")}
    assert "the card is moved 2 times by hand\n" in dry_run(plan, tmp_path / "s", rig=hand.rig_file)
    assert {file: file.is_file() and file.read_bytes() for file in tmp_path.rglob("*")} == before
    plan.write_text(PLAN.replace('order = "blocks"\n', ""), encoding="utf-8")
    assert "moved 4 times by hand; fewer with" in dry_run(plan, tmp_path / "s", rig=hand.rig_file)
    with (
        lock_ports({str(hand.rig_file.resolve())}),
        pytest.raises(DeviceError, match=f"rig.toml: in use by process {os.getpid()}"),
    ):
        dry_run(plan, tmp_path / "s", rig=hand.rig_file)


class AtTheKeyboard:
    """A capture in a terminal, and the person before it."""

    def __init__(self, bench: SimulatedBench, folder: Path) -> None:
        (folder / "plan.toml").write_text(PLAN, encoding="utf-8")
        words = [sys.executable, "-m", "bssrdf", "--quiet", "capture", "plan.toml", "--out", "s", "--rig", "rig.toml"]
        self._master, slave = pty.openpty()
        self.process = subprocess.Popen(words, stdin=slave, stdout=slave, stderr=slave, cwd=folder)
        os.close(slave)
        self.said = ""

    def asked(self) -> str | None:
        """The next thing that the person is asked to do; None where the program has ended."""
        start, deadline = len(self.said), time.monotonic() + 60
        while time.monotonic() < deadline:
            if found := re.search(r"(Lay|Put|Take)[^\n]*?, then press", self.said[start:]):
                self.said = self.said[: start + found.end()]
                return found[1]
            if select.select([self._master], [], [], 0.1)[0]:
                try:
                    self.said += os.read(self._master, 4096).decode()
                except OSError:  # the other end is closed
                    return None
        raise TimeoutError(self.said)

    def press_enter(self) -> None:
        os.write(self._master, b"\n")

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._master)


@pytest.fixture
def keyboard(mended: SimulatedBench, tmp_path: Path) -> Iterator[AtTheKeyboard]:
    mended.world.lay("sample")
    at = AtTheKeyboard(by_hand(mended, tmp_path, simulated=False), tmp_path)
    yield at
    at.close()


def test_a_person_captures_a_session_and_may_forget_the_card_once(
    keyboard: AtTheKeyboard, mended: SimulatedBench, tmp_path: Path
) -> None:
    acts: dict[str, Callable[[], None]] = {"Put": mended.world.close, "Take": mended.world.open, "Lay": lambda: None}
    asked: list[str] = []
    while (task := keyboard.asked()) is not None:
        if asked.count("Take") or task != "Take":  # the first time the person only presses Enter
            acts[task]()
        asked.append(task)
        keyboard.press_enter()
    assert keyboard.process.wait(timeout=20) == 0, keyboard.said
    assert asked == ["Put", "Lay", "Take", "Take", "Put"]
    assert "it is all dark" in keyboard.said
    kinds = [frame.kind for frame in read_frames(tmp_path / "s")]
    assert kinds == ["sample", "sample", "sample_dark", "sample_dark"]
    assert not mended.world.is_open()


def test_ctrl_c_at_a_question_stops_at_once_and_asks_for_the_card(keyboard: AtTheKeyboard) -> None:
    assert keyboard.asked() == "Put"
    keyboard.press_enter()
    assert keyboard.asked() == "Lay"
    keyboard.process.send_signal(signal.SIGINT)
    assert keyboard.asked() is None  # the card is in the beam already
    assert keyboard.process.wait(timeout=20) == 130
    assert "interrupted" in keyboard.said


def test_without_a_terminal_the_capture_says_why_it_cannot_ask(mended: SimulatedBench, tmp_path: Path) -> None:
    by_hand(mended, tmp_path, simulated=False)
    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    words = [sys.executable, "-m", "bssrdf", "capture", "plan.toml", "--out", "s", "--rig", "rig.toml"]
    done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 4
    last = done.stderr.splitlines()[-1]
    assert "nobody can be asked to put the card into the beam: standard input has ended" in last
    assert "state is unknown: block the beam by hand" in last


def test_answers_may_come_from_a_pipe_one_line_for_each_question(monkeypatch: pytest.MonkeyPatch) -> None:
    out, into = os.pipe()
    os.write(into, b"\n\n")
    os.close(into)
    with os.fdopen(out) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        operator = ConsoleOperator(Interrupts())
        operator.lay("sample")
        operator.move_card(into_beam=True)
        with pytest.raises(DeviceError, match="take the card out of the beam: standard input has ended"):
            operator.move_card(into_beam=False)
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(DeviceError, match="lay the sample under the beam: standard input has ended"):
        operator.lay("sample")


class Counting:
    """An operator who only counts."""

    def __init__(self) -> None:
        self.moves: list[bool] = []

    def lay(self, subject: str) -> None:
        raise AssertionError

    def move_card(self, *, into_beam: bool) -> None:
        self.moves.append(into_beam)


def test_a_card_is_moved_only_where_it_must_be() -> None:
    operator = Counting()
    shutter = ManualShutter(operator)
    shutter.connect()
    for act in (shutter.close, lambda: shutter.open_for(1), lambda: shutter.open_for(1), shutter.close, shutter.close):
        act()
    assert operator.moves == [True, False, True]
    shutter.release()
    assert shutter.state() is None
    shutter.close()
    assert operator.moves == [True, False, True, True]


def test_the_panic_button_runs_the_commands(mended: SimulatedBench) -> None:
    mended.world.open()
    assert rig_close(mended.rig_file) == ["command shutter: closed", "command beam: off"]
    status = mended.world.status()
    assert not status["open"]
    assert not status["beam"]
