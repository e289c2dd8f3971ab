"""Shutter, beam and camera behind programs of the user's own, here scripts of a shell."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import tifffile

from bssrdf.errors import DeviceError
from bssrdf.rig.child import ended_well
from bssrdf.rig.interrupts import deferred
from bssrdf.rig.ports import BenchClock
from bssrdf.rig.programs import CommandBeam, CommandCamera, CommandShutter, decimal
from bssrdf.rig.sim.raw_files import dng_bytes
from bssrdf.rig.sim.sensor import SimSensor, expose
from bssrdf.session.file_kind import kind_of

SENSOR = SimSensor(height_px=16, width_px=16)
FRAME = dng_bytes(expose(SENSOR, 1e3, 0.1, np.random.default_rng(0)), SENSOR, 0.1)


def script(folder: Path, text: str) -> str:
    """A program as it stands in rig.toml; `$0`'s folder is the test's."""
    file = folder / "script.sh"
    file.write_text(f'cd "{folder}"\n{text}\n', encoding="utf-8")
    return f"/bin/sh '{file}'"


def shutter(folder: Path, text: str, timeout_s: float = 5.0) -> CommandShutter:
    """A shutter whose programs are one script, with the verb as its argument."""
    words = script(folder, text)
    return CommandShutter(f"{words} open", f"{words} close", to_tell=f"{words} state", timeout_s=timeout_s)


WORKS = 'if [ $1 = state ]; then cat state; else echo $1 | sed "s/close/closed/" > state; fi'


def test_a_shutter_opens_closes_and_tells(tmp_path: Path) -> None:
    device = shutter(tmp_path, WORKS)
    device.connect()
    assert device.state() == "closed"
    device.open_for(1.0)
    assert device.state() == "open"
    device.close()
    assert (tmp_path / "state").read_text() == "closed\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("echo 'no relay' >&2; exit 3", r"open failed with exit code 3 \(no relay\)"),
        ("echo first; echo last; exit 1", r"failed with exit code 1 \(last\)"),
        ("kill -9 $$", "open was killed by signal SIGKILL"),
        ("sleep 20", r"open was not done within 0\.3 s and was ended"),
        ("[ $1 = state ] && echo closed", "told to open, but says closed"),
        ("[ $1 = open ] || echo ajar", "state printed 'ajar'; it must print open or closed"),
    ],
)
def test_a_program_that_fails_is_named_with_its_reason(tmp_path: Path, text: str, message: str) -> None:
    start = time.monotonic()
    with pytest.raises(DeviceError, match=message) as error:
        shutter(tmp_path, text + "; true" if "state" in text else text, timeout_s=0.3).open_for(1.0)
    assert "command shutter" in str(error.value)
    assert "\n" not in str(error.value)
    assert time.monotonic() - start < 5


def test_a_shutter_that_stays_open_is_said_to_be_open(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="told to close, but says open; block the beam by hand"):
        shutter(tmp_path, "echo open").close()


def test_a_shutter_without_a_state_is_believed(tmp_path: Path) -> None:
    device = CommandShutter("true", "true")
    device.connect()
    device.open_for(1.0)
    assert device.state() is None


def test_a_program_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"command beam: /none/lamp on cannot be run \(No such file"):
        CommandBeam("/none/lamp on", "true").on()


def test_what_a_program_leaves_running_is_not_waited_for(tmp_path: Path) -> None:
    start = time.monotonic()
    assert ended_well("x", ["/bin/sh", "-c", "sleep 8 & echo done"], 20.0) == "done"
    assert time.monotonic() - start < 4


def test_a_late_program_is_ended_with_all_that_it_has_started(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="was ended"):
        ended_well("x", ["/bin/sh", "-c", f"sh -c 'sleep 1; touch {tmp_path}/later' & wait"], 0.2)
    time.sleep(1.3)
    assert not (tmp_path / "later").exists()


def camera(folder: Path, text: str, timeout_s: float = 5.0) -> CommandCamera:
    return CommandCamera(BenchClock(), f"{script(folder, text)} {{exposure_s}} {{out}}", timeout_s=timeout_s)


def taken(folder: Path, text: str, timeout_s: float = 5.0) -> Path:
    (folder / "frame.dng").write_bytes(FRAME)
    (folder / "frames").mkdir()
    return camera(folder, text, timeout_s).take(0.000125, folder / "frames" / "001.part", lambda: None)


@pytest.mark.parametrize(
    "text",
    [
        'cp frame.dng "$2"',
        'cp frame.dng "$2.dng"',
        'cp frame.dng "$2.DNG"; echo preview > "$2.jpg"',
        'cp frame.dng "$(dirname "$2")/IMG_0001.dng"; touch "$(dirname "$2")/._IMG_0001.dng"',
        '[ "$1" = 0.000125 ] && cp frame.dng "$2"',
    ],
)
def test_a_camera_leaves_its_frame_under_any_name(tmp_path: Path, text: str) -> None:
    file = taken(tmp_path, text)
    assert (file.name, file.read_bytes()) == ("001.part.dng", FRAME)
    assert [left.name for left in file.parent.iterdir()] == [file.name]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("true", r"left no file at \{out\}; have it write RAW"),
        ('echo text > "$2.txt"', r"left frame\.txt, no kind of frame"),
        ('cp frame.dng "$2.dng"; cp frame.dng "$2.cr2"', "left frame.cr2, frame.dng; one frame is wanted"),
        ("echo 'no card' >&2; exit 7", r"failed with exit code 7 \(no card\)"),
        ("kill -TERM $$", "was killed by signal SIGTERM"),
        ("sleep 20", r"was not done within 0\.3 s"),
    ],
)
def test_a_camera_that_leaves_no_frame_is_named_with_its_reason(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DeviceError, match=f"command camera: .*{message}"):
        taken(tmp_path, text, timeout_s=0.3)
    assert not list((tmp_path / "frames").iterdir())


def test_the_camera_of_the_documents_takes_a_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).resolve().parents[1] / "docs" / "rig.md").read_text(encoding="utf-8")
    example = re.search(r'```python\n("""expose\.py.*?)```', page, re.DOTALL)
    assert example
    (tmp_path / "expose.py").write_text(example[1], encoding="utf-8")
    (tmp_path / "frame.dng").write_bytes(FRAME)
    stand_in = tmp_path / "rpicam-still"
    stand_in.write_text(f"""#!/bin/sh
while [ "$1" != --shutter ]; do shift; done
[ "$2" = 500000 ] && cp {tmp_path}/frame.dng "${{4%.jpg}}.dng" && echo jpeg > "$4"
""")
    stand_in.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    device = CommandCamera(BenchClock(), f"{sys.executable} '{tmp_path}/expose.py' {{exposure_s}} {{out}}")
    assert device.take(0.5, tmp_path / "001.part", lambda: None).read_bytes() == FRAME


def test_a_watchdog_is_kept_quiet_while_a_camera_works(tmp_path: Path) -> None:
    (tmp_path / "frame.dng").write_bytes(FRAME)
    calls: list[float] = []
    camera(tmp_path, 'sleep 0.5; cp frame.dng "$2"').take(
        0.1, tmp_path / "001.part", lambda: calls.append(time.monotonic())
    )
    assert len(calls) >= 3


def test_seconds_are_written_without_an_exponent() -> None:
    assert [decimal(seconds) for seconds in (30.0, 0.5, 1 / 8000, 1e-6)] == ["30", "0.5", "0.000125", "0.000001"]


def test_the_kind_of_a_file_is_told_by_its_content(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "plain", np.zeros((4, 4), np.uint16))
    tifffile.imwrite(tmp_path / "nikon", np.zeros((4, 4), np.uint16), extratags=[(271, "s", 0, "NIKON CORP", True)])
    (tmp_path / "dng").write_bytes(FRAME)
    heads = {"cr3": b"\0\0\0\x18ftypcrx isom", "rw2": b"IIU\0\x08", "png": b"\x89PNG\r\n", "txt": b"hello", "none": b""}
    for name, content in heads.items():
        (tmp_path / name).write_bytes(content)
    kinds = {file.name: kind_of(file) for file in tmp_path.iterdir()}
    assert kinds == {
        **{"plain": ".tif", "nikon": ".nef", "dng": ".dng", "cr3": ".cr3", "rw2": ".rw2", "png": ".png"},
        **{"txt": "", "none": ""},
    }


def test_an_interrupted_capture_ends_its_program(tmp_path: Path) -> None:
    code = (  # a job in the background ignores SIGINT
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from bssrdf.rig.child import ended_well; ended_well('x', ['/bin/sh', '-c', 'echo $$ > pid; sleep 60'], 60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 30
    while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    process.wait(timeout=20)
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_a_signal_waits_until_what_was_begun_is_known() -> None:
    done = []

    def interrupted() -> None:
        with deferred():
            os.kill(os.getpid(), signal.SIGINT)
            done.append("begun")
        done.append("gone on")

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert done == ["begun"]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
