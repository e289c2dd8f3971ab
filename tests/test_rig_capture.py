"""Captures on the simulated bench: real protocols, real libgphoto2, processes of their own."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from bssrdf.bench.capture import N_FRAMES, Campaign, every_fault, file_safety_ms, small_scene
from bssrdf.errors import DeviceError, UsageError
from bssrdf.rig.capture import Event, capture_session
from bssrdf.rig.commands import dry_run, rig_close, rig_status, run_capture
from bssrdf.rig.devices import devices_of
from bssrdf.rig.locks import lock_ports
from bssrdf.rig.operators import SimulatedOperator
from bssrdf.rig.plan_toml import Subject
from bssrdf.rig.rig_toml import read_rig
from bssrdf.rig.sim.launch import SimulatedBench
from bssrdf.session.constancy import card_of_file
from bssrdf.session.frame_files import read_frame_file
from bssrdf.session.frames_csv import read_frames
from bssrdf.session.records import Card
from bssrdf.session.session_toml import read_session

pytest.importorskip("gphoto2", reason="python-gphoto2 is not installed")

PLAN = """\
settle_s = 0.0
[material]
name = "Skin1"
eta = 1.3
[exposures]
list_s = [0.016, 0.001]
"""


@pytest.fixture(autouse=True)
def _home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path_factory.getbasetemp()))


@pytest.fixture(scope="module", params=["sc10", "scpi", pytest.param("chip", marks=pytest.mark.slow)])
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedBench]:
    """With "chip" the firmware itself is the controller; it plays no faults of the line."""
    folder = tmp_path_factory.mktemp(request.param)
    if request.param == "chip":
        firmware = request.getfixturevalue("firmware")
        words = [sys.executable, Path(__file__).with_name("chip_on_bench.py"), firmware]
        started = SimulatedBench(folder, small_scene(), shutter="scpi", speed=4.0, controller=words)
    else:
        started = SimulatedBench(folder, small_scene(), shutter=request.param)
    yield started
    started.stop()


@pytest.fixture
def mended(bench: SimulatedBench, tmp_path: Path) -> Iterator[SimulatedBench]:
    """The bench without what an earlier test broke."""
    bench.world.clear()
    yield bench
    bench.world.clear()
    for part in ("shutter", "camera"):
        if not bench.alive(part):
            bench.start(part)


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    file = tmp_path / "plan.toml"
    file.write_text(PLAN, encoding="utf-8")
    return file


def listed(session: Path) -> list[tuple[str, str, float]]:
    return [(frame.file, frame.kind, frame.exposure_s) for frame in read_frames(session)]


EXPECTED = [
    ("frames/001_reference_16ms.dng", "reference", 0.016),
    ("frames/002_reference_dark_16ms.dng", "reference_dark", 0.016),
    ("frames/003_reference_1ms.dng", "reference", 0.001),
    ("frames/004_reference_dark_1ms.dng", "reference_dark", 0.001),
    ("frames/005_sample_16ms.dng", "sample", 0.016),
    ("frames/006_sample_dark_16ms.dng", "sample_dark", 0.016),
    ("frames/007_sample_1ms.dng", "sample", 0.001),
    ("frames/008_sample_dark_1ms.dng", "sample_dark", 0.001),
    ("frames/009_reference_16ms.dng", "reference", 0.016),
    ("frames/010_sample_16ms.dng", "sample", 0.016),
]


def test_every_shutter_gives_the_same_list_of_frames(mended: SimulatedBench, plan: Path, tmp_path: Path) -> None:
    done = capture_session(plan, mended.rig_file, tmp_path / "s")
    assert listed(tmp_path / "s") == EXPECTED
    assert all(abs(change) < 0.003 for change in done.drift.values())
    assert set(done.drift) == {"sample", "reference"}
    assert not mended.world.status()["open"]
    session = read_session(tmp_path / "s")
    assert session.material is not None
    assert session.material.name == "Skin1"
    assert session.geometry is not None
    light, dark = (read_frame_file(tmp_path / "s" / frame[0]).data for frame in EXPECTED[:2])
    assert light.max() > 10 * dark.max() / 2
    assert {(frame.card.iso, frame.card.layout, frame.card.bits) for frame in read_frames(tmp_path / "s")} == {
        (100.0, "RGGB", 14)
    }


def test_a_camera_whose_setting_changes_is_stopped_by_name(
    mended: SimulatedBench, plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a lens that was touched: the files say it, and the frames before are kept."""

    def turned(file: Path) -> Card:
        return replace(card_of_file(file), f_number=5.6 if "001_" in file.name else 8.0)

    monkeypatch.setattr("bssrdf.rig.capture.card_of_file", turned)
    with pytest.raises(DeviceError, match=r"it has f-number 8, not 5\.6 as frames/001_reference_16ms\.dng"):
        capture_session(plan, mended.rig_file, tmp_path / "s")
    assert listed(tmp_path / "s") == EXPECTED[:1]
    assert not mended.world.status()["open"]


def test_a_plan_is_shown_before_it_is_run(mended: SimulatedBench, plan: Path, tmp_path: Path) -> None:
    plan.write_text(PLAN.replace("0.001]", "0.0011]"), encoding="utf-8")
    text = dry_run(plan, tmp_path / "s", rig=mended.rig_file)
    assert "007_sample_1ms: sample 0.001 s" in text
    assert "10 frames" in text
    assert "disk free" in text
    assert "if this program is killed: the controller" in text
    assert not (tmp_path / "s").exists()


def test_metering_chooses_exposures_from_unsaturated_to_the_faint_border(
    mended: SimulatedBench, plan: Path, tmp_path: Path
) -> None:
    plan.write_text(PLAN.replace("list_s = [0.016, 0.001]", "auto = true"), encoding="utf-8")
    capture_session(plan, mended.rig_file, tmp_path / "s")
    frames = read_frames(tmp_path / "s")
    shortest = min((frame for frame in frames if frame.kind == "sample"), key=lambda frame: frame.exposure_s)
    image = read_frame_file(tmp_path / "s" / shortest.file)
    assert image.white is not None
    assert image.data.max() < image.white
    assert len({frame.exposure_s for frame in frames if frame.kind == "sample"}) >= 3


def test_a_session_is_not_written_over_and_not_resumed_with_another_plan(
    mended: SimulatedBench, plan: Path, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="holds no capture to go on with"):
        capture_session(plan, mended.rig_file, tmp_path / "s", resume=True)
    capture_session(plan, mended.rig_file, tmp_path / "s")
    with pytest.raises(UsageError, match="exists already"):
        capture_session(plan, mended.rig_file, tmp_path / "s")
    assert capture_session(plan, mended.rig_file, tmp_path / "s", resume=True).taken_now == 0
    plan.write_text(PLAN.replace("0.001]", "0.002]"), encoding="utf-8")
    with pytest.raises(UsageError, match="another plan"):
        capture_session(plan, mended.rig_file, tmp_path / "s", resume=True)


def test_a_changed_frame_is_found_when_resuming(mended: SimulatedBench, plan: Path, tmp_path: Path) -> None:
    capture_session(plan, mended.rig_file, tmp_path / "s")
    file = tmp_path / "s" / EXPECTED[2][0]
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    file.write_bytes(content)
    with pytest.raises(Exception, match="changed since its capture"):
        capture_session(plan, mended.rig_file, tmp_path / "s", resume=True)


def test_a_port_in_use_is_refused_by_name(mended: SimulatedBench, plan: Path, tmp_path: Path) -> None:
    port = str(mended.folder / "shutter")
    with lock_ports({port}), pytest.raises(DeviceError, match=f"in use by process {os.getpid()}"):
        capture_session(plan, mended.rig_file, tmp_path / "s")
    capture_session(plan, mended.rig_file, tmp_path / "s")


def test_all_devices_that_fail_are_named_at_once(mended: SimulatedBench, plan: Path, tmp_path: Path) -> None:
    text = mended.rig_file.read_text(encoding="utf-8")
    broken = tmp_path / "rig.toml"
    text = text.replace(str(mended.folder / "shutter"), str(tmp_path / "nothing")).replace('iso = "100"', 'iso = "77"')
    broken.write_text(text, encoding="utf-8")
    with pytest.raises(DeviceError, match=r"nothing: cannot be opened.*iso cannot be 77; the camera offers 100, 200"):
        capture_session(plan, broken, tmp_path / "s")


def test_a_camera_that_hangs_is_reported_within_its_deadline(
    mended: SimulatedBench, plan: Path, tmp_path: Path
) -> None:
    mended.world.arm("camera", "no_event")
    start = time.monotonic()
    with pytest.raises(DeviceError, match=r"gphoto2 camera on ptpip.*no file in time"):
        capture_session(plan, mended.rig_file, tmp_path / "s")
    assert time.monotonic() - start < 8
    assert not mended.world.status()["lit"]


def test_the_panic_button_closes_an_open_shutter(mended: SimulatedBench) -> None:
    shutter = devices_of(read_rig(mended.rig_file)).shutter
    shutter.connect()
    shutter.open_for(60.0)
    assert mended.world.status()["open"]
    assert any("closed" in line for line in rig_close(mended.rig_file))
    shutter.release()
    assert not mended.world.status()["open"]
    assert "shutter is closed" in rig_status(mended.rig_file)


def in_a_process(plan: Path, rig: Path, session: Path) -> subprocess.Popen[bytes]:
    code = "import sys; from pathlib import Path as P; from bssrdf.rig.capture import capture_session; "
    code += "capture_session(*map(P, sys.argv[1:]))"
    return subprocess.Popen([sys.executable, "-c", code, str(plan), str(rig), str(session)], stderr=subprocess.PIPE)


def wait_for_frame(session: Path, number: int) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if (session / "frames.csv").exists() and (session / "frames.csv").read_bytes().count(b"\n") > number:
            return
        time.sleep(0.01)
    raise TimeoutError


@pytest.mark.parametrize(("signals", "error"), [((signal.SIGINT,), 1), ((signal.SIGTERM,), 0)])
def test_a_signal_stops_the_capture_with_the_shutter_closed(
    mended: SimulatedBench, plan: Path, tmp_path: Path, signals: tuple[int, ...], error: int
) -> None:
    process = in_a_process(plan, mended.rig_file, tmp_path / "s")
    wait_for_frame(tmp_path / "s", 3)
    for number in signals:
        process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode
    assert b"KeyboardInterrupt" in said
    assert not mended.world.status()["lit"]
    assert capture_session(plan, mended.rig_file, tmp_path / "s", resume=True).frames == N_FRAMES
    assert listed(tmp_path / "s") == EXPECTED


def test_a_first_ctrl_c_finishes_the_frame(mended: SimulatedBench, plan: Path, tmp_path: Path) -> None:
    finished: list[str] = []

    def interrupt(event: Event) -> None:
        if event.what == "start" and event.number == 3:
            os.kill(os.getpid(), signal.SIGINT)
        if event.what == "done":
            finished.append(event.step.name)

    with pytest.raises(KeyboardInterrupt):
        capture_session(plan, mended.rig_file, tmp_path / "s", report=interrupt)
    assert finished[-1] == "003_reference_1ms"
    assert [frame[0] for frame in listed(tmp_path / "s")] == [frame[0] for frame in EXPECTED[:3]]


def test_faults_cost_no_frame_and_leave_no_light(mended: SimulatedBench, tmp_path: Path) -> None:
    campaign = Campaign(mended, tmp_path)
    for arguments in random.Random(20).sample(every_fault(), 10):
        run = campaign.disturb(*arguments)
        assert not run.problems, run


@pytest.mark.slow
def test_every_fault_at_every_frame(mended: SimulatedBench, tmp_path: Path) -> None:
    campaign = Campaign(mended, tmp_path)
    assert not [run for arguments in every_fault(2) if (run := campaign.disturb(*arguments)).problems]


def within_s(bench: SimulatedBench) -> float:
    """Time in which the controller closes the shutter by itself: the pulse of an SC10, the watchdog of SCPI."""
    return 2.0 if "watchdog_s" in bench.rig_file.read_text(encoding="utf-8") else 8.0


def test_a_kill_loses_at_most_the_frame_in_flight(mended: SimulatedBench, tmp_path: Path) -> None:
    campaign, rng = Campaign(mended, tmp_path), random.Random(7)
    for _ in range(5):
        run = campaign.kill(rng.uniform(0.0, 1.5), within_s(mended))
        assert not run.problems, run


@pytest.mark.slow
def test_fifty_kills_lose_at_most_the_frame_in_flight(mended: SimulatedBench, tmp_path: Path) -> None:
    campaign, rng = Campaign(mended, tmp_path), random.Random(8)
    runs = [campaign.kill(rng.uniform(0.0, 1.5), within_s(mended)) for _ in range(50)]
    assert not [run for run in runs if run.problems]


def test_the_simulated_bench_comes_with_the_command(plan: Path, tmp_path: Path) -> None:
    plan.write_text(PLAN.replace("[0.016, 0.001]", "[0.001]").replace("settle_s", "drift_check = false\nsettle_s"))
    run_capture(plan, tmp_path / "s", simulate=True)
    assert len(listed(tmp_path / "s")) == 4
    assert (tmp_path / "s.truth.json").is_file()


@pytest.mark.slow
def test_file_safety_is_cheap(tmp_path: Path) -> None:
    assert file_safety_ms(tmp_path) < 60


def test_no_wait_of_ours_lets_the_controller_s_watchdog_put_out_the_light(
    mended: SimulatedBench, plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lay = SimulatedOperator.lay

    def slowly(self: SimulatedOperator, subject: Subject) -> None:
        time.sleep(1.7 if subject == "sample" else 0.0)
        lay(self, subject)

    monkeypatch.setattr(SimulatedOperator, "lay", slowly)
    text = PLAN.replace("settle_s = 0.0", f"settle_s = {1.7 * mended.speed}\ndrift_check = false")
    plan.write_text(text.replace("0.016, 0.001", "0.016"), encoding="utf-8")
    capture_session(plan, mended.rig_file, tmp_path / "s")
    assert len(read_frames(tmp_path / "s")) == 4
