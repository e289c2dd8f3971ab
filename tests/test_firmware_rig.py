"""The firmware in place of the simulated controller: beside it, under the driver, and on the bench."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest
from near_world import NearWorld
from simulated_chip import Chip

from bssrdf.bench.capture import PLAN, small_scene
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import DeviceError, InputError
from bssrdf.rig import pulse_test
from bssrdf.rig.capture import capture_session
from bssrdf.rig.commands import rig_close, rig_status
from bssrdf.rig.devices import devices_of
from bssrdf.rig.find import described
from bssrdf.rig.locks import lock_ports
from bssrdf.rig.rig_toml import read_rig
from bssrdf.rig.scpi import ScpiBeam, ScpiController, ScpiShutter
from bssrdf.rig.serial_line import SerialLine
from bssrdf.rig.sim.launch import SimulatedBench
from bssrdf.rig.sim.scpi_device import Scpi
from bssrdf.session.atomic import sha256_of
from bssrdf.session.frames_csv import read_frames

BOTH = (Path(__file__).parent / "fixtures" / "controller_lines.txt").read_text(encoding="ascii").splitlines()
"""Lines to both, with time for each; WAIT gives half a second more. What each answers, and every error, must agree."""
LINE_S, WAIT_S = 0.1, 0.5


def test_the_simulated_controller_answers_what_the_firmware_does(chip: Chip) -> None:
    """And so it does with the interlock tripped, and when its queue overflows, and after bytes that are none."""
    near = NearWorld()
    device = Scpi(near)  # type: ignore[arg-type]

    def simulated(line: bytes, seconds: float) -> str:
        command, rest = device.take(line + b"\n")
        assert (command, rest) == (line, b"")
        _, reply = device.execute(command)
        for _ in range(round(seconds / 0.005)):
            near.t += 0.005
            device.idle()
        return reply.decode()

    def both(line: bytes, seconds: float = LINE_S) -> tuple[str, str]:
        chip.said = b""
        chip.write(line + b"\n")
        chip.run_ms(seconds * 1000)
        return chip.said.decode(), simulated(line, seconds)

    def agree(line: str | bytes, seconds: float = LINE_S) -> None:
        line = line.encode() if isinstance(line, str) else line
        said, expected = both(line, seconds)
        assert said == expected, line
        if b"ERR" not in line:
            said, expected = both(b"SYST:ERR?")
            assert said == expected, line

    for line in BOTH:
        if line == "WAIT":
            chip.run_ms(1000 * WAIT_S)
            for _ in range(100):
                near.t += WAIT_S / 100
                device.idle()
        else:
            agree(line, 0.01 if "CLOS" in line or "20000" in line else LINE_S)
    for garbage in (b"\xff", b"SHUT:STAT OPEN\x00", b"x" * 48, b"x" * 49, b"SHUT:STAT\x80 OPEN", b"\x1b[A"):
        agree(garbage)
    near.world.arm(near.t, "shutter", "interlock")
    chip.tell("interlock 1")
    for line in ("SYST:INT?", "SHUT:PULS 1000", "SHUT:STAT OPEN", "SHUT:STAT?"):
        agree(line)
    near.world.clear(near.t)
    chip.tell("interlock 0")
    chip.run_ms(100)
    agree("SYST:INT?")
    agree("SHUT:STAT OPEN")
    near.world.arm(near.t, "shutter", "interlock")
    chip.tell("interlock 1")
    agree("SHUT:STAT?")
    for line in ("SHUT:PULS", *["NONSENSE"] * 9):
        both(line.encode())
    for _ in range(9):
        agree("SYST:ERR?")


@pytest.fixture
def live(firmware: Path, tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The port of a board at the speed of the clock, and its simulator."""
    port = tmp_path / "ttyACM0"
    words = [firmware / "chip", firmware / "controller.elf", port, "1"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1) as process:
        assert process.stdout is not None
        assert any(line.startswith("ready") for line in process.stdout)
        tell(process, "send " + b"SHUT:TYPE TTL\n".hex())
        time.sleep(0.2)
        yield str(port), process
        process.kill()


def tell(process: subprocess.Popen[str], line: str) -> None:
    assert process.stdin is not None
    process.stdin.write(line + "\n")


def test_the_driver_speaks_with_the_firmware(live: tuple[str, subprocess.Popen[str]]) -> None:
    port, process = live
    controller = ScpiController(port, watchdog_s=5.0)
    shutter, beam = ScpiShutter(controller), ScpiBeam(controller, level=0.5)
    assert re.fullmatch(r"bssrdf,rig,\d{4},1\.0\.0\+\S+", shutter.connect().version)
    assert shutter.state() == "closed"
    beam.connect()
    beam.on()
    assert controller.query("BEAM:STAT?", str.isalpha) == "ON"
    for longest_s in (4.05, 90.0):
        shutter.open_for(longest_s)
        assert shutter.state() == "open"
        shutter.close()
        shutter.close()
        assert shutter.state() == "closed"
    beam.off()
    assert controller.query("BEAM:STAT?", str.isalpha) == "OFF"
    tell(process, "interlock 1")
    time.sleep(0.1)
    with pytest.raises(DeviceError, match=r"'SHUT:PULS 1000000' was refused with '-221,\"Settings conflict; interlock"):
        shutter.open_for(1.0)
    assert shutter.state() == "closed"
    tell(process, "interlock 0")
    time.sleep(0.2)
    shutter.open_for(30.0)
    shutter.release()
    again = ScpiShutter(ScpiController(port))
    again.connect()
    assert again.state() == "closed"
    again.release()


def test_the_driver_outlives_noise_on_the_line(live: tuple[str, subprocess.Popen[str]]) -> None:
    port, process = live
    shutter = ScpiShutter(ScpiController(port, timeout_s=0.3))
    shutter.connect()
    for garbage in (b"\xff", b"SHUT:", b"\x00" * 20, b"x" * 60, b"*IDN?\n"):
        tell(process, f"send {garbage.hex()}")
        time.sleep(0.05)
        shutter.open_for(20.0)
        tell(process, f"send {garbage.hex()}")
        assert shutter.state() == "open"
        shutter.close()
    shutter.release()


def rig_file(folder: Path, driver: str, port: str) -> Path:
    file = folder / "rig.toml"
    file.write_text(
        f"""\
[shutter]
driver = "{driver}"
port = "{port}"
[beam]
driver = "{"scpi" if driver == "scpi" else "manual"}"
{f'port = "{port}"' if driver == "scpi" else ""}
[camera]
driver = "folder"
port = "{folder}"
[geometry]
mm_per_px = 0.1
[reference]
name = "tile"
reflectance = [0.99, 0.99, 0.99]
reflectance_sd = [0.01, 0.01, 0.01]
""",
        encoding="utf-8",
    )
    return file


def test_rig_test_reads_the_light_s_own_time_back_and_keeps_the_clock_s_error(
    live: tuple[str, subprocess.Popen[str]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pulse_test, "PULSES_US", (4000, 20_000, 64_000))
    monkeypatch.setattr(pulse_test, "_CLOCK_S", 2.5)
    port, process = live
    rig = rig_file(tmp_path, "scpi", port)
    assert run(cli, ["rig", "test", "--rig", str(rig)]) == 0
    text = capsys.readouterr().out
    assert re.search(r"^ +4 +4\.000 +\+0 +0  commanded$", text, re.MULTILINE)
    assert "no photodiode is fitted" in text
    for line in ("send " + b"SHUT:TYPE SOL\nSHUT:SENS ON\n".hex(), "blade 192000 80000"):
        tell(process, line)
    time.sleep(0.3)
    assert run(cli, ["rig", "test", "--set-clock", "--rig", str(rig)]) == 0
    text = capsys.readouterr().out
    rows = re.findall(r"^ +(\S+) +(\S+) +(\S+) +(\S+)  light$", text, re.MULTILINE)
    assert [float(row[0]) for row in rows] == [20, 64]
    for _, _, error_us, spread_us in rows:
        assert float(error_us) == pytest.approx(BLADE_US, abs=10)
        assert float(spread_us) <= 10
    ppm = re.search(r"kept in the controller: SYST:CLOC (-?\d+)", text)
    assert ppm
    controller = ScpiController(port)
    controller.connect()
    assert controller.query("SYST:CLOC?", lambda reply: True) == ppm[1]
    assert controller.query("BEAM:STAT?", str.isalpha) == "OFF"
    controller.release()


BLADE_US = (0.75 - 1.0) * 12_000 + (0.5 - 0.55) * 5000
"""What the simulated blade adds to a pulse of the lag 12 ms and the bounce 5 ms: it closes after three quarters of the
lag, lets light through for half of the bounce as it closes, and keeps it off for 0.55 of the bounce as it opens."""


def test_rig_test_says_when_there_is_no_light_or_nothing_to_read_back(
    live: tuple[str, subprocess.Popen[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port, process = live
    tell(process, "send " + b"SHUT:SENS ON\n".hex())
    time.sleep(0.2)
    assert run(cli, ["rig", "test", "--rig", str(rig_file(tmp_path, "scpi", port))]) == 4
    assert "does not open" in (error := capsys.readouterr().err) or "saw no light" in error
    assert run(cli, ["rig", "test", "--rig", str(rig_file(tmp_path, "sc10", port))]) == 2
    assert "driver sc10 reads no pulse back" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("was", "becomes", "error"),
    [
        (
            "[geometry]",
            'release = "/dev/ttyUSB7"\n[geometry]',
            r"rig.toml: \[camera\] release = '/dev/ttyUSB7' is not the port",
        ),
        ("[camera]", "level = 1.5\n[camera]", r"rig.toml: \[beam\] level.*must be a finite number"),
    ],
)
def test_a_wrong_key_is_named_before_anything_moves(tmp_path: Path, was: str, becomes: str, error: str) -> None:
    rig = rig_file(tmp_path, "scpi", "/dev/ttyACM0")
    rig.write_text(rig.read_text().replace(was, becomes))
    with pytest.raises(InputError, match=error):
        devices_of(read_rig(rig))


def test_a_camera_without_usb_is_started_by_the_controller(
    live: tuple[str, subprocess.Popen[str]], tmp_path: Path
) -> None:
    port, process = live
    rig = rig_file(tmp_path, "scpi", port)
    rig.write_text(rig.read_text().replace("[geometry]", f'release = "{port}"\n[geometry]'))
    devices = devices_of(read_rig(rig))
    devices.connect()
    delivered = Thread(target=lambda: (time.sleep(0.2), np.save(tmp_path / "one.npy", np.full((4, 6), 9, np.uint16))))
    delivered.start()
    frame = devices.camera.take(0.25, tmp_path / "taken", lambda: None)
    assert frame.suffix == ".npy"
    devices.release()
    delivered.join()
    process.kill()
    assert process.stdout is not None
    edges = [line.split() for line in process.stdout if line.startswith("camera")]
    assert [level for _, level, _ in edges[-2:]] == ["1", "0"]
    assert (int(edges[-1][2]) - int(edges[-2][2])) / 16e6 == pytest.approx(0.25, abs=3e-4)


def test_rig_list_names_the_board_and_sends_nothing(
    live: tuple[str, subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SerialLine, "send", lambda *_: pytest.fail("a byte was sent"))
    port, _ = live
    board, other = (SimpleNamespace(device=port, description="USB Serial", vid=vid) for vid in (0x1A86, 0x0001))
    (named,) = described([board])
    assert re.fullmatch(
        rf"{port}: bssrdf controller \(driver scpi\), serial number 0000, firmware 1\.0\.0\S+ \(USB Serial\)", named
    )
    assert described([other]) == [f"{port}: USB Serial"]
    with lock_ports({str(Path(port).resolve())}):
        assert re.fullmatch(rf"{port}: USB Serial \(in use by process \d+; .*\)", described([board])[0])


SPEED = 4.0
"""Seconds of the bench in one of ours: slow enough for the simulated chip on a busy machine."""


@pytest.fixture(scope="module")
def chip_bench(firmware: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedBench]:
    words = [sys.executable, Path(__file__).with_name("chip_on_bench.py"), firmware]
    folder = tmp_path_factory.mktemp("chip")
    bench = SimulatedBench(folder, small_scene(), shutter="scpi", speed=SPEED, controller=words)
    yield bench
    bench.stop()


def test_a_session_with_the_firmware_is_that_of_the_simulated_controller_frame_by_frame(
    chip_bench: SimulatedBench, tmp_path: Path
) -> None:
    pytest.importorskip("gphoto2", reason="python-gphoto2 is not installed")
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN, encoding="utf-8")
    capture_session(plan, chip_bench.rig_file, tmp_path / "with_chip")
    assert comes_to(chip_bench, False)
    (tmp_path / "python").mkdir()
    other = SimulatedBench(tmp_path / "python", small_scene(), shutter="scpi", speed=SPEED)
    try:
        capture_session(plan, other.rig_file, tmp_path / "without")
    finally:
        other.stop()
    sessions = [tmp_path / "with_chip", tmp_path / "without"]
    frames = [
        [(frame.file, frame.kind, frame.exposure_s, sha256_of(session / frame.file)) for frame in read_frames(session)]
        for session in sessions
    ]
    assert len(frames[0]) == 10
    assert frames[0] == frames[1]


def comes_to(bench: SimulatedBench, opened: bool) -> bool:
    """Whether the world's shutter is soon open or closed: what a pin does gets there a little later."""
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline:
        if bench.world.status()["open"] == opened:
            return True
        time.sleep(0.002)
    return False


def test_on_the_bench_the_firmware_closes_at_the_panic_button_and_when_the_host_is_killed(
    chip_bench: SimulatedBench,
) -> None:
    shutter = devices_of(read_rig(chip_bench.rig_file)).shutter
    shutter.connect()
    shutter.open_for(60.0)
    assert comes_to(chip_bench, True)
    assert any("closed" in line for line in rig_close(chip_bench.rig_file))
    assert comes_to(chip_bench, False)
    shutter.release()
    assert "shutter is closed" in rig_status(chip_bench.rig_file)
    code = "import sys, time; from pathlib import Path; from bssrdf.rig.devices import devices_of; "
    code += "from bssrdf.rig.rig_toml import read_rig; s = devices_of(read_rig(Path(sys.argv[1]))).shutter; "
    code += "s.connect(); s.open_for(60.0); print('open', flush=True); time.sleep(60)"
    words = [sys.executable, "-c", code, str(chip_bench.rig_file)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as host:
        assert host.stdout is not None
        assert host.stdout.readline() == "open\n"
        assert comes_to(chip_bench, True)
        host.kill()
    assert comes_to(chip_bench, False)
