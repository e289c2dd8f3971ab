"""The controller's firmware: every command, every error, and whatever else a line can carry."""

from __future__ import annotations

import random
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from simulated_chip import FIRMWARE, Chip

NO_ERROR = '0,"No error"'
POWER, BROWN_OUT = 1, 4


@pytest.fixture
def new_chip(firmware: Path) -> Iterator[Chip]:
    """A board fresh from the factory."""
    one = Chip(firmware, set_up=[])
    yield one
    one.release()


def test_it_says_who_it_is_when_it_starts_and_when_asked(new_chip: Chip) -> None:
    assert re.fullmatch(r"bssrdf,rig,0000,1\.0\.0\+\S+", new_chip.ask("*IDN?"))
    new_chip.said = b""
    new_chip.send("SYST:SER 42")
    new_chip.reset(POWER)
    assert re.fullmatch(rb"bssrdf rig 0042 1\.0\.0\+\S+\n", new_chip.said)
    assert new_chip.ask("*IDN?").startswith("bssrdf,rig,0042,1.0.0+")


@pytest.mark.parametrize(
    ("command", "question", "answer"),
    [
        ("SHUT:STAT OPEN", "SHUT:STAT?", "OPEN"),
        ("SHUT:STAT CLOS", "SHUT:STAT?", "CLOS"),
        ("SHUT:PULS 1000000", "SHUT:STAT?", "OPEN"),
        ("SHUT:TYPE SOL", "SHUT:TYPE?", "SOL"),
        ("SHUT:TYPE SERV", "SHUT:PULS:MIN?", "200000"),
        ("SHUT:SENS ON", "SHUT:SENS?", "ON"),
        ("SHUT:SENS OFF", "SHUT:SENS?", "OFF"),
        ("SHUT:SERV 900,2100", "SHUT:SERV?", "900,2100"),
        ("BEAM:STAT ON", "BEAM:STAT?", "ON"),
        ("BEAM:STAT OFF", "BEAM:STAT?", "OFF"),
        ("BEAM:LEV 0.5", "BEAM:LEV?", "0.500"),
        ("BEAM:LEV 1e-05", "BEAM:LEV?", "0.000"),
        ("BEAM:LEV 1", "BEAM:LEV?", "1.000"),
        ("CAM:PULS 1000000", "CAM:STAT?", "1"),
        ("CAM:PULS 0", "CAM:STAT?", "0"),
        ("SYST:WATC 1500", "SYST:WATC?", "1500"),
        ("SYST:CLOC -4321", "SYST:CLOC?", "-4321"),
        ("SYST:CLOC +20000", "SYST:CLOC?", "20000"),
        ("SYST:SER 9999", "SYST:SER?", "9999"),
        ("*RST", "SYST:WATC?", "5000"),
        ("*CLS", "SYST:ERR?", NO_ERROR),
        ("syst:watc 700", "Syst:Watc?", "700"),
        ("  SYST:WATC \t 800  ", "\tSYST:WATC?  ", "800"),
        ("SYST:WATC 900\r", "SYST:WATC?\r", "900"),
    ],
)
def test_what_a_command_sets_may_be_asked_for_and_set_again(
    chip: Chip, command: str, question: str, answer: str
) -> None:
    for _ in range(2):
        chip.send(command)
        assert chip.ask(question) == answer
    assert chip.errors() == []


def test_a_reset_by_command_darkens_and_closes_and_clears_the_queue(chip: Chip) -> None:
    for command in ("SHUT:STAT OPEN", "BEAM:LEV 0.25", "BEAM:STAT ON", "CAM:PULS 9000000", "SYST:WATC 99", "NONSENSE"):
        chip.send(command, 20)
    assert (chip.level("shutter"), chip.level("beam"), chip.level("camera")) == (1, 64, 1)
    chip.send("*RST")
    assert (chip.level("shutter"), chip.level("beam"), chip.level("camera")) == (0, 0, 0)
    assert chip.errors() == []
    assert chip.ask("BEAM:LEV?") == "1.000"


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("NONSENSE", '-113,"Undefined header"'),
        ("SHUT:STA?", '-113,"Undefined header"'),
        ("SHUT:PULS:MEAS", '-113,"Undefined header"'),
        ("SHUT:STAT OPEN;SHUT:STAT CLOS", '-224,"Illegal parameter value"'),
        ("SHUT:PULS", '-109,"Missing parameter"'),
        ("SHUT:STAT ", '-109,"Missing parameter"'),
        ("SHUT:SERV 1500", '-109,"Missing parameter"'),
        ("*RST 1", '-108,"Parameter not allowed"'),
        ("SYST:ERR? 1", '-108,"Parameter not allowed"'),
        ("SHUT:PULS 1e3", '-104,"Data type error"'),
        ("SHUT:PULS -1", '-104,"Data type error"'),
        ("SHUT:PULS 1000 1000", '-104,"Data type error"'),
        ("BEAM:LEV bright", '-104,"Data type error"'),
        ("BEAM:LEV 0.5x", '-104,"Data type error"'),
        ("SYST:CLOC -", '-104,"Data type error"'),
        ("SHUT:SERV 1000,", '-104,"Data type error"'),
        ("SHUT:PULS 0", '-222,"Data out of range"'),
        ("SHUT:PULS 99", '-222,"Data out of range"'),
        ("SHUT:PULS 60000001", '-222,"Data out of range"'),
        ("SHUT:PULS 4294968296", '-222,"Data out of range"'),
        ("SHUT:PULS 99999999999999999999999", '-222,"Data out of range"'),
        ("SHUT:SERV 499,1500", '-222,"Data out of range"'),
        ("BEAM:LEV 1.001", '-222,"Data out of range"'),
        ("BEAM:LEV -0.001", '-222,"Data out of range"'),
        ("BEAM:LEV nan", '-222,"Data out of range"'),
        ("SYST:WATC 3600001", '-222,"Data out of range"'),
        ("SYST:CLOC 20001", '-222,"Data out of range"'),
        ("SYST:SER 10000", '-222,"Data out of range"'),
        ("CAM:PULS 600000001", '-222,"Data out of range"'),
        ("SHUT:STAT AJAR", '-224,"Illegal parameter value"'),
        ("SHUT:TYPE LASER", '-224,"Illegal parameter value"'),
        ("SHUT:TYPE NONE", '-224,"Illegal parameter value"'),
        ("BEAM:STAT 1", '-224,"Illegal parameter value"'),
        ("SHUT:SENS", '-109,"Missing parameter"'),
        ("x" * 48, '-113,"Undefined header"'),
        ("SHUT:STAT OPEN" + " " * 35, '-363,"Input buffer overrun"'),
        ("x" * 49, '-363,"Input buffer overrun"'),
        ("x" * 500, '-363,"Input buffer overrun"'),
    ],
)
def test_a_wrong_line_is_an_error_and_changes_nothing(chip: Chip, line: str, error: str) -> None:
    before = chip.eeprom()
    chip.send(line)
    assert chip.errors() == [error]
    assert chip.eeprom() == before
    assert (chip.level("shutter"), chip.level("beam"), chip.level("camera")) == (0, 0, 0)
    assert chip.ask("SYST:WATC?") == "5000"


def test_the_queue_keeps_the_oldest_errors_and_says_that_it_overflowed(chip: Chip) -> None:
    for line in ("SHUT:PULS", "NONSENSE", "SHUT:PULS 1", *["NONSENSE"] * 20):
        chip.send(line, 10)
    assert chip.codes() == [-109, -113, -222, -113, -113, -113, -113, -350]
    chip.send("NONSENSE")
    assert chip.codes() == [-113]


def test_commands_may_come_in_one_write_or_byte_by_byte(chip: Chip) -> None:
    chip.said = b""
    chip.write(b"SYST:WATC 1234\nBEAM:STAT ON\r\n\n\r\nSYST:WATC?\nBEAM:STAT?\n")
    chip.run_ms(50)
    assert chip.said == b"1234\nON\n"
    chip.said = b""
    for byte in b"SYST:WATC 4321\nSYST:WATC?\n":
        chip.write(bytes([byte]))
        chip.run_ms(7)
    assert chip.said == b"4321\n"
    assert chip.errors() == []


@pytest.mark.parametrize("seed", range(6))
def test_binary_garbage_opens_nothing_and_the_next_line_is_understood(chip: Chip, seed: int) -> None:
    rng = random.Random(seed)
    garbage = bytes(rng.randrange(256) for _ in range(2000))
    chip.write(garbage.replace(b"*RST", b"*rST") + b"\n")
    chip.run_ms(400)
    assert chip.edges["shutter"][1:] == []
    assert chip.edges["beam"][1:] == []
    assert set(chip.codes()) <= {-101, -113, -350, -363}
    assert chip.ask("SYST:WATC?") == "5000"


@pytest.mark.parametrize("position", range(len("SHUT:PULS 200000")))
def test_a_line_with_a_byte_that_is_none_is_not_carried_out(chip: Chip, position: int) -> None:
    line = bytearray(b"SHUT:PULS 200000")
    for byte in (0x00, 0x07, 0x80, 0xFF):
        line[position] = byte
        chip.write(bytes(line) + b"\n")
        chip.run_ms(8)
        assert chip.codes() == [-101]
    assert chip.edges["shutter"][1:] == []


def test_what_overflows_the_input_is_an_error_and_no_part_of_it_is_carried_out(chip: Chip) -> None:
    """An answer takes five times as long as its question, so that the ring fills up."""
    full = b"*IDN?\n" * 25
    for shift in range(0, 18, 3):
        chip.write(full + b"X" * shift + b"\n" + b"SYST:WATC 60000\nBEAM:LEV 0.50000000000\nSHUT:PULS 50000000\n" * 9)
        chip.run_ms(500)
        assert -363 in chip.codes()
        assert chip.ask("SYST:WATC?") in ("5000", "60000")
        assert chip.ask("BEAM:LEV?") in ("1.000", "0.500")
        chip.send("SHUT:STAT CLOS")
    assert all(us > 400e3 or us == 0 for us in chip.pulses_us("shutter"))
    assert chip.ask("*IDN?").startswith("bssrdf,rig,")


@pytest.mark.parametrize("content", ["blank", "zero", "flipped", "cut", "type", "other layout"])
def test_a_memory_that_is_blank_or_corrupt_leaves_no_output_type_and_the_shutter_closed(
    chip: Chip, content: str
) -> None:
    chip.send("SHUT:SENS ON")
    good = chip.eeprom()
    changed = {
        "blank": b"\xff" * 32,
        "zero": bytes(32),
        "flipped": bytes([good[0] ^ 1]) + good[1:],
        "cut": good[:5] + b"\xff" * 27,
        "type": good[:2] + b"\x09" + good[3:],
        "other layout": good[:10] + bytes([good[10] ^ 0x51, good[11] ^ 0xB5]) + good[12:],
    }[content]
    chip.tell(f"eeprom 0 {changed.hex()}")
    chip.reset(POWER)
    chip.forget_edges()
    for command in ("SHUT:PULS 1000", "SHUT:STAT OPEN"):
        chip.send(command)
    assert chip.errors() == ['-314,"Save/recall memory lost"', *['-221,"Settings conflict; no output type"'] * 2]
    assert (chip.ask("SHUT:TYPE?"), chip.ask("SHUT:SENS?"), chip.ask("SYST:CLOC?")) == ("NONE", "OFF", "0")
    assert chip.edges["shutter"][1:] == []
    chip.send("SHUT:TYPE TTL")
    chip.reset(POWER)
    chip.send("SHUT:PULS 1000")
    assert chip.errors() == []
    assert chip.pulses_us("shutter") == pytest.approx([1000], abs=1)


def test_a_servo_s_ends_stay_while_it_is_open(chip: Chip) -> None:
    chip.send("SHUT:TYPE TTL")
    chip.send("SHUT:STAT OPEN")
    chip.send("SHUT:SERV 900,2100")
    assert chip.errors() == ['-221,"Settings conflict; open"']
    chip.send("SHUT:STAT CLOS", 1000)
    chip.send("SHUT:SERV 900,2100")
    assert (chip.errors(), chip.ask("SHUT:SERV?")) == ([], "900,2100")


@pytest.mark.parametrize(("cause", "errors"), [(POWER, []), (BROWN_OUT, ['-240,"Hardware error; brown-out"'])])
def test_it_starts_dark_and_closed_whatever_it_did_before(chip: Chip, cause: int, errors: list[str]) -> None:
    for command in ("SHUT:PULS 60000000", "BEAM:STAT ON", "CAM:PULS 60000000"):
        chip.send(command)
    assert (chip.level("shutter"), chip.level("beam"), chip.level("camera")) == (1, 256, 1)
    chip.reset(cause)
    assert (chip.level("shutter"), chip.level("beam"), chip.level("camera")) == (0, 0, 0)
    assert chip.errors() == errors
    chip.run_ms(2000)
    assert (chip.level("shutter"), chip.level("beam")) == (0, 0)


def test_a_hung_program_is_ended_dark_and_closed(chip: Chip) -> None:
    for command in ("SHUT:PULS 60000000", "BEAM:STAT ON"):
        chip.send(command)
    chip.tell("hang")
    hung = chip.cycle
    chip.run_ms(400)
    assert (chip.level("shutter"), chip.level("beam")) == (0, 0)
    assert (chip.edges["shutter"][-1][0] - hung) / 16e3 < 300
    assert chip.errors() == ['-240,"Hardware error; program hung"']
    chip.send("SHUT:PULS 1000")
    assert chip.pulses_us("shutter")[-1] == pytest.approx(1000, abs=1)


def test_settings_are_kept_without_power(chip: Chip) -> None:
    kept = {"SHUT:TYPE": "SERV", "SHUT:SENS": "ON", "SHUT:SERV": "1100,1900", "SYST:CLOC": "-77", "SYST:SER": "1234"}
    for header, value in kept.items():
        chip.send(f"{header} {value}")
    chip.reset(POWER)
    assert {header: chip.ask(f"{header}?") for header in kept} == kept
    assert chip.errors() == []


def test_the_chip_has_room_and_no_heap(firmware: Path, chip: Chip) -> None:
    """Flash of 16 KiB, RAM of 1.2 KiB with the deepest stack that all commands took."""
    lines = (Path(__file__).parent / "fixtures" / "controller_lines.txt").read_text(encoding="ascii")
    for line in lines.splitlines():
        chip.send(line, 10)
    done = subprocess.run(["avr-size", firmware / "controller.elf"], capture_output=True, text=True, check=True)
    text, data, bss = map(int, done.stdout.splitlines()[1].split()[:3])
    assert text + data <= 16 * 1024
    assert 30 < chip.deepest_stack() < 512
    assert data + bss + chip.deepest_stack() <= 1.2 * 1024
    names = subprocess.run(["avr-nm", firmware / "controller.elf"], capture_output=True, text=True, check=True).stdout
    assert "malloc" not in names


def test_the_sources_are_clean() -> None:
    if not (shutil.which("make") and shutil.which("cppcheck")):
        pytest.skip("cppcheck is not installed (.ci/apt installs it on Debian and Ubuntu)")
    done = subprocess.run(["make", "-C", FIRMWARE, "check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
