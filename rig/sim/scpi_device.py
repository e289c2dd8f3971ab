"""The project's SCPI controller as its firmware behaves: idempotent verbs, an error queue, a host watchdog.

docs/controller.md has the commands; tests hold this beside the firmware itself, line by line.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from bssrdf.rig.sim.world_server import WorldClient

LINE = 48
_DEPTH = 8
_LONGEST_US = 60_000_000
_WATCHDOG_MS = 5000
_FULL = 256
"""Counts of the beam's PWM."""

_INVALID_CHARACTER = '-101,"Invalid character"'
_DATA_TYPE = '-104,"Data type error"'
_NOT_ALLOWED = '-108,"Parameter not allowed"'
_MISSING = '-109,"Missing parameter"'
_UNDEFINED = '-113,"Undefined header"'
_TRIPPED = '-221,"Settings conflict; interlock"'
_CLOSING = '-221,"Settings conflict; closing"'
_STILL_OPEN = '-221,"Settings conflict; open"'
_OUT_OF_RANGE = '-222,"Data out of range"'
_ILLEGAL = '-224,"Illegal parameter value"'
_OVERFLOW = '-350,"Queue overflow"'
_OVERRUN = '-363,"Input buffer overrun"'
_SILENT = '-365,"Time out error; host silent"'

_SHORTEST_US = {"TTL": 100, "SOL": 20_000, "SERV": 200_000}
_SETTLING_S = {"TTL": 0.02, "SOL": 0.05, "SERV": 0.25}


class _Refused(Exception):
    """A command that is not carried out; the text goes into the queue."""


class Scpi:
    """A board whose output is TTL, with a sensor at the blade, where the firmware has its photodiode."""

    banner = b"bssrdf rig 0001 simulated\n"

    def __init__(self, world: WorldClient) -> None:
        self._world = world
        self._queue: deque[str] = deque()
        self._kept = {
            "SHUT:TYPE": "TTL",
            "SHUT:SENS": "ON",
            "SHUT:SERV": "1000,2000",
            "SYST:CLOC": "0",
            "SYST:SER": "0001",
        }
        self._heard = world.now()
        self._bitten = False
        self._opened, self._ends = -math.inf, -math.inf
        self._pressed_until = -math.inf
        self._reset()

    def take(self, incoming: bytes) -> tuple[bytes | None, bytes]:
        command, end, rest = incoming.partition(b"\n")
        if incoming:
            self._heard, self._bitten = self._world.now(), False
        return (command, rest) if end else (None, incoming)

    def idle(self) -> None:
        self._look_at_interlock()
        silent_s = self._world.now() - self._heard
        if not self._watchdog_ms or self._bitten or silent_s <= self._watchdog_ms / 1000:
            return
        self._bitten = True
        if self._driven or self._world.status()["beam"] or self._pressed:
            self._push(_SILENT)
        self._make_safe()

    def execute(self, command: bytes) -> tuple[bytes, bytes]:
        self._look_at_interlock()
        try:
            answer = self._carried_out(command)
        except _Refused as error:
            self._push(str(error))
            answer = ""
        return b"", answer.encode()

    def _carried_out(self, command: bytes) -> str:
        line = command.removesuffix(b"\r").replace(b"\t", b" ")
        if len(line) > LINE:
            raise _Refused(_OVERRUN)
        if any(not 32 <= byte <= 126 for byte in line):
            raise _Refused(_INVALID_CHARACTER)
        header, _, value = line.decode("ascii").upper().strip(" ").partition(" ")
        value = value.strip(" ")
        if "?" in header:
            return self._question(header, value) + "\n"
        if header:
            self._verb(header, value)
        return ""

    def _question(self, header: str, value: str) -> str:
        answers: dict[str, Callable[[], object]] = {
            "*IDN?": lambda: f"bssrdf,rig,{self._kept['SYST:SER']},simulated",
            "SYST:ERR?": lambda: self._queue.popleft() if self._queue else '0,"No error"',
            "SHUT:STAT?": lambda: "OPEN" if self._is_open() else "CLOS",
            "SHUT:PULS:MEAS?": self._measured,
            "SHUT:PULS:MIN?": lambda: _SHORTEST_US[self._type],
            "BEAM:STAT?": lambda: "ON" if self._world.status()["beam"] else "OFF",
            "BEAM:LEV?": lambda: f"{(self._level * 1000 + _FULL // 2) // _FULL / 1000:.3f}",
            "CAM:STAT?": lambda: int(self._pressed),
            "SYST:INT?": lambda: int(self._world.status()["interlock"]),
            "SYST:WATC?": lambda: self._watchdog_ms,
            "SYST:TIME?": lambda: round(self._world.now() * 1e6) % 2**31,
        }
        if header not in answers and header[:-1] not in self._kept:
            raise _Refused(_UNDEFINED)
        if value:
            raise _Refused(_NOT_ALLOWED)
        return str(answers[header]()) if header in answers else self._kept[header[:-1]]

    def _verb(self, header: str, value: str) -> None:
        alone: dict[str, Callable[[], None]] = {"*RST": self._reset, "*CLS": self._queue.clear}
        verbs: dict[str, Callable[[str], None]] = {
            "SHUT:STAT": self._set_shutter,
            "SHUT:PULS": lambda value: self._open(_number(value, 1, _LONGEST_US)),
            "SHUT:TYPE": lambda value: self._keep_at_rest("SHUT:TYPE", _word(value, *_SHORTEST_US)),
            "SHUT:SENS": lambda value: self._keep_at_rest("SHUT:SENS", _word(value, "ON", "OFF")),
            "SHUT:SERV": self._set_servo,
            "BEAM:STAT": lambda value: self._world.beam(_word(value, "ON", "OFF") == "ON"),
            "BEAM:LEV": self._set_level,
            "CAM:PULS": self._press,
            "SYST:WATC": self._set_watchdog,
            "SYST:CLOC": self._set_clock,
            "SYST:SER": self._set_serial,
        }
        if header not in alone and header not in verbs:
            raise _Refused(_UNDEFINED)
        if (header in alone) == bool(value):
            raise _Refused(_NOT_ALLOWED if value else _MISSING)
        if value:
            verbs[header](value)
        else:
            alone[header]()

    def _push(self, error: str) -> None:
        if len(self._queue) < _DEPTH:
            self._queue.append(error)
        else:
            self._queue[-1] = _OVERFLOW

    @property
    def _type(self) -> str:
        return self._kept["SHUT:TYPE"]

    @property
    def _driven(self) -> bool:
        return self._world.now() < self._ends

    @property
    def _moving(self) -> bool:
        return self._world.now() < self._ends + _SETTLING_S[self._type]

    @property
    def _pressed(self) -> bool:
        return self._world.now() < self._pressed_until

    def _is_open(self) -> bool:
        return bool(self._world.status()["open"]) if self._kept["SHUT:SENS"] == "ON" else self._driven

    def _look_at_interlock(self) -> None:
        if self._driven and self._world.status()["interlock"]:
            self._ends = self._world.now()
            self._push(_TRIPPED)

    def _open(self, us: int | None) -> None:
        if us is not None and us < _SHORTEST_US[self._type]:
            raise _Refused(_OUT_OF_RANGE)
        if self._world.status()["interlock"]:
            raise _Refused(_TRIPPED)
        if not self._driven:
            if self._moving:
                raise _Refused(_CLOSING)
            self._opened = self._world.now()
        self._ends = math.inf if us is None else self._world.now() + us / 1e6
        self._world.open(None if us is None else us / 1e6)

    def _close(self) -> None:
        if self._driven:
            self._ends = self._world.now()
        self._world.close()

    def _measured(self) -> str:
        """How long the light of the last opening was on, or the output where no sensor is fitted [µs]."""
        now = self._world.now()
        long_s = max(min(now, self._ends) - self._opened, 0.0) if self._opened > -math.inf else 0.0
        sensor = self._kept["SHUT:SENS"] == "ON"
        if sensor and long_s:
            long_s = self._world.lit_share(self._opened, now) * (now - self._opened)
        return f"{round(long_s * 1e6)},{'running' if self._moving else 'light' if sensor else 'commanded'}"

    def _set_shutter(self, value: str) -> None:
        if _word(value, "OPEN", "CLOS") == "OPEN":
            self._open(None)
        else:
            self._close()

    def _set_level(self, value: str) -> None:
        try:
            share = float(value.replace("_", "?"))
        except ValueError:
            raise _Refused(_DATA_TYPE) from None
        if not 0 <= share <= 1:
            raise _Refused(_OUT_OF_RANGE)
        self._level = int(share * _FULL + 0.5)

    def _set_watchdog(self, value: str) -> None:
        self._watchdog_ms = _number(value, 0, 3_600_000)

    def _press(self, value: str) -> None:
        self._pressed_until = self._world.now() + _number(value, 0, 600_000_000) / 1e6

    def _keep_at_rest(self, key: str, value: str) -> None:
        if value != self._kept[key] and self._moving:
            raise _Refused(_STILL_OPEN)
        self._kept[key] = value

    def _set_servo(self, value: str) -> None:
        closed, comma, opened = value.partition(",")
        if not comma:
            raise _Refused(_MISSING)
        self._kept["SHUT:SERV"] = f"{_number(closed, 500, 2500)},{_number(opened, 500, 2500)}"

    def _set_clock(self, value: str) -> None:
        ppm = _number(value[1:] if value[0] in "+-" else value, 0, 20_000)
        self._kept["SYST:CLOC"] = str(-ppm if value[0] == "-" else ppm)

    def _set_serial(self, value: str) -> None:
        self._kept["SYST:SER"] = f"{_number(value, 0, 9999):04d}"

    def _reset(self) -> None:
        self._make_safe()
        self._level = _FULL
        self._watchdog_ms = _WATCHDOG_MS
        self._queue.clear()

    def _make_safe(self) -> None:
        self._close()
        self._world.beam(False)
        self._pressed_until = -math.inf


def _number(value: str, least: int, most: int) -> int:
    if not (value.isascii() and value.isdigit()):
        raise _Refused(_DATA_TYPE)
    if not least <= int(value) <= most:
        raise _Refused(_OUT_OF_RANGE)
    return int(value)


def _word(value: str, *known: str) -> str:
    if value not in known:
        raise _Refused(_ILLEGAL)
    return value
