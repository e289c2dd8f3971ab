"""Drivers of serial devices, by exact byte scripts: each script must be used up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import serial

from bssrdf.errors import DeviceError
from bssrdf.rig.sc10 import Sc10Shutter
from bssrdf.rig.scpi import ScpiBeam, ScpiController, ScpiShutter
from bssrdf.rig.uniblitz import UniblitzShutter

Script = list[tuple[bytes, bytes | Exception]]


class ScriptedWire:
    """Expects each write in turn, and then has its reply come in."""

    def __init__(self, script: Script) -> None:
        self.script = list(script)
        self.timeout: float | None = 0.1
        self.incoming = b""

    def write(self, data: bytes) -> int:
        assert self.script, f"nothing more was expected, but {data!r} was written"
        expected, reply = self.script.pop(0)
        assert data == expected
        if isinstance(reply, Exception):
            raise reply
        self.incoming += reply
        return len(data)

    def read_until(self, expected: bytes) -> bytes:
        head, end, rest = self.incoming.partition(expected)
        self.incoming = rest
        return head + end

    def reset_input_buffer(self) -> None:
        self.incoming = b""

    def close(self) -> None:
        pass


def scripted(script: Script) -> tuple[ScriptedWire, Callable[..., Any]]:
    wire = ScriptedWire(script)
    return wire, lambda port, baud, timeout_s: wire


def echo(command: bytes, answer: bytes = b"") -> tuple[bytes, bytes]:
    """One exchange with an SC10: echo, answer, prompt."""
    return command + b"\r", command + b"\r" + (answer + b"\r" if answer else b"") + b"> "


SC10_CONNECT: Script = [
    echo(b"id?", b"THORLABS SC10 VERSION 1.07"),
    echo(b"ens?", b"0"),
    echo(b"closed?", b"1"),
    echo(b"mode=3"),
]


def sc10(script: Script) -> tuple[ScriptedWire, Sc10Shutter]:
    wire, open_port = scripted(SC10_CONNECT + script)
    shutter = Sc10Shutter("/dev/ttyUSB0", open_port=open_port, blade_s=0.0)
    assert shutter.connect().version == "THORLABS SC10 VERSION 1.07"
    return wire, shutter


def test_sc10_opens_for_a_time_and_closes() -> None:
    wire, shutter = sc10(
        [
            echo(b"open=2500"),
            echo(b"ens?", b"0"),
            echo(b"ens"),
            echo(b"ens?", b"1"),
            echo(b"closed?", b"0"),
            echo(b"ens?", b"1"),
            echo(b"ens"),
            echo(b"ens?", b"0"),
            echo(b"closed?", b"1"),
            echo(b"closed?", b"1"),
        ]
    )
    shutter.open_for(2.5)
    shutter.close()
    assert shutter.state() == "closed"
    assert not wire.script


def test_sc10_asks_before_it_toggles_again_when_a_reply_is_lost() -> None:
    wire, shutter = sc10(
        [
            echo(b"open=1000"),
            echo(b"ens?", b"0"),
            (b"ens\r", b""),
            echo(b"ens?", b"1"),
            echo(b"closed?", b"0"),
        ]
    )
    shutter.open_for(1.0)
    assert not wire.script


def test_sc10_toggles_again_only_when_the_state_shows_that_the_command_was_lost() -> None:
    wire, shutter = sc10(
        [
            echo(b"open=1000"),
            echo(b"ens?", b"0"),
            (b"ens\r", b""),
            echo(b"ens?", b"0"),
            echo(b"ens"),
            echo(b"ens?", b"1"),
            echo(b"closed?", b"0"),
        ]
    )
    shutter.open_for(1.0)
    assert not wire.script


def test_sc10_names_a_tripped_interlock() -> None:
    asked: Script = [echo(b"ens?", b"0"), echo(b"ens")]
    wire, shutter = sc10([echo(b"open=1000"), *asked * 3, echo(b"ens?", b"0"), echo(b"interlock?", b"1")])
    with pytest.raises(DeviceError, match=r"sc10 on /dev/ttyUSB0: does not open .the interlock is tripped"):
        shutter.open_for(1.0)
    assert not wire.script


def test_sc10_reports_a_blade_that_does_not_move() -> None:
    wire, shutter = sc10(
        [
            echo(b"open=1000"),
            echo(b"ens?", b"0"),
            echo(b"ens"),
            echo(b"ens?", b"1"),
            echo(b"closed?", b"1"),
            echo(b"ens?", b"1"),
            echo(b"ens"),
            echo(b"ens?", b"0"),
        ]
    )
    with pytest.raises(DeviceError, match="blade stays closed"):
        shutter.open_for(1.0)
    assert not wire.script


@pytest.mark.parametrize(
    ("reply", "message"),
    [
        (b"", r"b'closed\?\\r' got b'' within 0.1 s, without its end"),
        (b"closed?\r1", r"got b'closed\?\\r1' within 0.1 s, without its end"),
        (b"clo\xffed?\r1\r> ", r"came back as b'clo\\xffed\?"),
        (b"1\r> ", r"came back as b'1\\r'"),
        (b"closed?\r7\r> ", "answered '7', not 0 or 1"),
        (serial.SerialException("device disconnected"), "could not be sent .device disconnected"),
    ],
)
def test_sc10_shows_the_bytes_of_every_wrong_reply(reply: bytes | Exception, message: str) -> None:
    once = isinstance(reply, Exception) or reply.endswith(b"7\r> ")
    wire, shutter = sc10([(b"closed?\r", reply)] * (1 if once else 3))
    with pytest.raises(DeviceError, match=f"sc10 on /dev/ttyUSB0.*{message}"):
        shutter.state()
    if not isinstance(reply, Exception):
        assert not wire.script


class HabitualSc10(ScriptedWire):
    """An SC10 by its state instead of a script, with one habit that owners of some firmwares report."""

    def __init__(self, habit: str) -> None:
        super().__init__([])
        self.habit, self.enabled, self.heard = habit, 0, 0

    def write(self, data: bytes) -> int:
        for command in data.split(b"\r")[:-1]:
            self.heard += 1
            self.incoming += self.said(command.decode())
        return len(data)

    def said(self, command: str) -> bytes:
        if self.heard == 1 and self.habit in ("loses the first", "refuses the first"):
            return b"" if self.habit == "loses the first" else b"\x00id?\rCommand error CMD_NOT_DEFINED\r> "
        self.enabled ^= command == "ens"
        answers = {"id?": "THORLABS SC10 VERSION 1.07", "ens?": self.enabled, "closed?": 1 - self.enabled}
        answer = str(answers[command]) + "\r" if command in answers else ""
        text = {
            "space before echo": f" {command}\r{answer}> ",
            "no echo": f"{answer}> ",
            "bare prompt": f"{command}\r{answer}>",
            "prompt first": f"> {command}\r{answer}",
            "line feeds": f"{command}\r{answer}> ".replace("\r", "\r\n"),
            "prompt first, line feeds": f"> {command}\r{answer}".replace("\r", "\r\n"),
            "no echo, bare prompt": f"{answer}>",
        }
        return text.get(self.habit, f"{command}\r{answer}> ").encode()


@pytest.mark.parametrize(
    "habit",
    [
        "none",
        "loses the first",
        "refuses the first",
        "space before echo",
        "no echo",
        "bare prompt",
        "prompt first",
        "line feeds",
        "prompt first, line feeds",
        "no echo, bare prompt",
    ],
)
def test_sc10_of_every_firmware_opens_and_closes(habit: str) -> None:
    wire = HabitualSc10(habit)
    shutter = Sc10Shutter("/dev/ttyUSB0", timeout_s=0.01, open_port=lambda port, baud, timeout_s: wire)
    shutter.connect()
    shutter.open_for(1.0)
    assert (shutter.state(), wire.enabled) == ("open", 1)
    shutter.close()
    assert (shutter.state(), wire.enabled) == ("closed", 0)


def test_sc10_that_has_echoed_is_not_believed_without_its_echo() -> None:
    wire, shutter = sc10([(b"closed?\r", b"1\r> ")] * 3)
    with pytest.raises(DeviceError, match=r"came back as b'1\\r'"):
        shutter.state()
    assert not wire.script


@pytest.mark.parametrize("error", [b"CMD_NOT_DEFINED", b"CMD_ARG_INVALID"])
def test_sc10_passes_on_a_refusal_without_repeating(error: bytes) -> None:
    wire, shutter = sc10([echo(b"open=1000", b"Command error " + error)])
    with pytest.raises(DeviceError, match=error.decode()):
        shutter.open_for(1.0)
    assert not wire.script


def test_uniblitz_sends_single_bytes_and_claims_no_state() -> None:
    wire, open_port = scripted([(b"A", b""), (b"@", b""), (b"A", b"")])
    shutter = UniblitzShutter("/dev/ttyS0", open_port=open_port)
    assert shutter.connect().version == "assumed"
    shutter.open_for(1.0)
    shutter.close()
    assert shutter.state() is None
    assert shutter.after_kill == ""
    assert not wire.script


def test_uniblitz_names_itself_when_unplugged() -> None:
    _, open_port = scripted([(b"A", OSError(5, "Input/output error"))])
    with pytest.raises(DeviceError, match=r"uniblitz on /dev/ttyS0: b'A' could not be sent .Input/output error"):
        UniblitzShutter("/dev/ttyS0", open_port=open_port).connect()


def ok(command: bytes) -> Script:
    """A verb to the SCPI controller, and its confirmation."""
    return [(command + b"\n", b""), (b"SYST:ERR?\n", b'0,"No error"\n')]


SCPI_CONNECT: Script = [(b"*IDN?\n", b"bssrdf,rig,0001,0.1.0\n"), *ok(b"*CLS"), *ok(b"SYST:WATC 2000")]
CLOSED: Script = [(b"SHUT:STAT?\n", b"CLOS\n")]
OPENED: Script = [(b"SHUT:STAT?\n", b"OPEN\n")]


def scpi(script: Script) -> tuple[ScriptedWire, ScpiController, ScpiShutter]:
    wire, open_port = scripted(SCPI_CONNECT + ok(b"SHUT:STAT CLOS") + CLOSED + script)
    controller = ScpiController("/dev/ttyACM0", boot_s=0.0, watchdog_s=2.0, open_port=open_port)
    shutter = ScpiShutter(controller)
    assert shutter.connect().version == "bssrdf,rig,0001,0.1.0"
    return wire, controller, shutter


def test_scpi_pulses_the_shutter_and_switches_the_beam() -> None:
    wire, controller, shutter = scpi(
        ok(b"BEAM:LEV 0.5")
        + ok(b"BEAM:STAT ON")
        + ok(b"SHUT:PULS 4050000")
        + OPENED
        + ok(b"SHUT:STAT CLOS")
        + CLOSED
        + ok(b"BEAM:STAT OFF")
    )
    beam = ScpiBeam(controller, level=0.5)
    assert beam.connect().port == "/dev/ttyACM0"
    beam.on()
    shutter.open_for(4.05)
    shutter.close()
    beam.off()
    assert not wire.script


def test_scpi_waits_for_a_board_that_resets_when_its_port_opens() -> None:
    wire, open_port = scripted([(b"*IDN?\n", b""), *SCPI_CONNECT])
    ScpiController("/dev/ttyACM0", boot_s=5.0, watchdog_s=2.0, open_port=open_port).connect()
    assert not wire.script


def test_scpi_repeats_a_question_whose_answer_is_lost_or_garbled() -> None:
    wire, _, shutter = scpi([(b"SHUT:STAT?\n", b""), (b"SHUT:STAT?\n", b"OP\xffN\n"), *OPENED])
    assert shutter.state() == "open"
    assert not wire.script


def test_scpi_repeats_a_verb_that_was_not_understood() -> None:
    refused: Script = [(b"SHUT:STAT CLOS\n", b""), (b"SYST:ERR?\n", b'-113,"Undefined header"\n')]
    wire, _, shutter = scpi(refused + ok(b"SHUT:STAT CLOS") + CLOSED)
    shutter.close()
    assert not wire.script


def test_scpi_passes_on_a_refusal_that_stays() -> None:
    refused: Script = [(b"SHUT:PULS 1000000\n", b""), (b"SYST:ERR?\n", b'-200,"Interlock"\n')]
    wire, _, shutter = scpi(refused * 3)
    with pytest.raises(DeviceError, match=r"scpi on /dev/ttyACM0: 'SHUT:PULS 1000000' was refused with .*Interlock"):
        shutter.open_for(1.0)
    assert not wire.script


def test_scpi_waits_while_the_blade_still_closes() -> None:
    closing: Script = [
        (b"SHUT:PULS 1000000\n", b""),
        (b"SYST:ERR?\n", b'-221,"Settings conflict; closing"\n'),
    ]
    wire, _, shutter = scpi(closing * 4 + ok(b"SHUT:PULS 1000000") + OPENED)
    shutter.open_for(1.0)
    assert not wire.script


def test_scpi_leaves_to_the_watchdog_what_is_longer_than_a_pulse() -> None:
    wire, _, shutter = scpi(ok(b"SHUT:PULS 60000000") + OPENED + ok(b"SHUT:STAT OPEN") + OPENED)
    shutter.open_for(60.0)
    shutter.open_for(60.001)
    assert not wire.script


def test_scpi_reads_a_pulse_back_once_it_is_over() -> None:
    script: Script = [
        (b"SHUT:PULS:MEAS?\n", b"1200,running\n"),
        (b"SHUT:PULS:MEAS?\n", b""),
        (b"SHUT:PULS:MEAS?\n", b"16750,light\n"),
    ]
    wire, _, shutter = scpi(ok(b"SHUT:PULS 20000") + script)
    assert shutter.measured_pulse(20_000) == (16_750, "light")
    assert not wire.script


def test_scpi_names_a_tripped_interlock_when_the_shutter_stays_closed() -> None:
    wire, _, shutter = scpi(ok(b"SHUT:PULS 1000000") + CLOSED + [(b"SYST:INT?\n", b"1\n")])
    with pytest.raises(DeviceError, match=r"does not open .the interlock is tripped"):
        shutter.open_for(1.0)
    assert not wire.script


def test_scpi_says_when_the_shutter_is_stuck_open() -> None:
    wire, _, shutter = scpi(ok(b"SHUT:STAT CLOS") + OPENED)
    with pytest.raises(DeviceError, match="told to close, but is open; block the beam by hand"):
        shutter.close()
    assert not wire.script


@pytest.mark.parametrize("reply", [b"", b"OPE", b"maybe\n", b"OPEN;OPEN\n"])
def test_scpi_shows_the_bytes_of_every_wrong_reply(reply: bytes) -> None:
    wire, _, shutter = scpi([(b"SHUT:STAT?\n", reply)] * 3)
    with pytest.raises(DeviceError, match=r"scpi on /dev/ttyACM0: .*SHUT:STAT\?"):
        shutter.state()
    assert not wire.script
