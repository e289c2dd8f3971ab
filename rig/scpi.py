"""Shutter and beam of an SCPI controller with a host watchdog: the command tree that the project's firmware speaks.

Every verb may be repeated. A command without an answer is confirmed by `SYST:ERR?`.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from bssrdf.errors import DeviceError
from bssrdf.rig.ports import Identity, ShutterState
from bssrdf.rig.serial_line import BadReply, SerialLine, Wire, open_wire

BAUD = 57600
_TRIES = 3
_NO_ERROR = '0,"No error"'
_CLOSING_S = 1.0
"""Longest time for which a controller refuses to open because the blade still closes; a servo's is 0.25 s."""
_MEASURED_S = 2.0
"""Longest time from a pulse's end to its read-back: the blade's, and the line's."""
_LOOK_S = 0.02
_LONGEST_PULSE_S = 60.0
"""The controller's longest pulse; what may last longer is left to its watchdog."""


class ScpiController:
    """One controller; its shutter and its beam share the port."""

    def __init__(
        self,
        port: str,
        *,
        timeout_s: float = 1.0,
        boot_s: float = 3.0,
        watchdog_s: float = 5.0,
        open_port: Callable[[str, int, float], Wire] = open_wire,
    ) -> None:
        self.name = f"scpi on {port}"
        self.watchdog_s = watchdog_s
        self._port, self._timeout_s, self._boot_s, self._open_port = port, timeout_s, boot_s, open_port
        self._line: SerialLine | None = None
        self._identity: Identity | None = None

    def connect(self) -> Identity:
        """Identify, once for both parts; opening the port resets a board, so it may take `boot_s` to answer."""
        if self._identity is None:
            self._line = SerialLine(self.name, self._open_port(self._port, BAUD, self._timeout_s))
            self._identity = Identity("scpi", self._port, self._first_answer())
            self.command("*CLS")
            self.command(f"SYST:WATC {max(round(self.watchdog_s * 1000), 1)}")
        return self._identity

    def query(self, command: str, known: Callable[[str], bool]) -> str:
        """The answer to a question; asked again where it does not come or is not `known`."""
        for _ in range(_TRIES - 1):
            try:
                return self._ask(command, known)
            except BadReply:
                self._wire().drain(self._timeout_s)
        return self._ask(command, known)

    def command(self, command: str) -> None:
        """A verb; sent again where the controller did not understand it."""
        error = ""
        for _ in range(_TRIES):
            error = self._answer_to(command)
            if error == _NO_ERROR:
                return
        raise DeviceError(f"{self.name}: {command!r} was refused with {error!r}; check firmware and interlock")

    def _answer_to(self, command: str) -> str:
        """What the error queue says to a verb, once the blade no longer closes."""
        deadline = time.monotonic() + _CLOSING_S
        while True:
            self._wire().send(command.encode() + b"\n")
            error = self.query("SYST:ERR?", lambda reply: '"' in reply)
            if "closing" not in error or time.monotonic() > deadline:
                return error
            time.sleep(0.01)

    def press_release(self, seconds: float) -> None:
        """Hold down a camera's release; it is let go in any case when the watchdog closes the shutter."""
        self.command(f"CAM:PULS {round(seconds * 1e6)}")

    def release(self) -> None:
        if self._line is not None:
            self._line.release()
            self._line = self._identity = None

    def _first_answer(self) -> str:
        deadline = time.monotonic() + self._boot_s
        while True:
            try:
                return self._ask("*IDN?", lambda reply: reply.count(",") == 3)
            except BadReply:
                if time.monotonic() > deadline:
                    raise

    def _ask(self, command: str, known: Callable[[str], bool]) -> str:
        sent = command.encode() + b"\n"
        self._wire().forget()
        self._wire().send(sent)
        reply = self._wire().receive(b"\n", after=sent).rstrip(b"\r").decode("ascii", "replace")
        if not known(reply):
            raise BadReply(f"{self.name}: {command!r} answered {reply!r}; is it another device, or another baud rate?")
        return reply

    def _wire(self) -> SerialLine:
        if self._line is None:
            raise DeviceError(f"{self.name}: is not connected")
        return self._line


class ScpiShutter:
    """The shutter of a controller: a timed pulse, and closed by the watchdog when this program is gone."""

    def __init__(self, controller: ScpiController) -> None:
        self._controller = controller

    @property
    def name(self) -> str:
        return self._controller.name

    @property
    def after_kill(self) -> str:
        return f"the controller's watchdog closes the shutter within {self._controller.watchdog_s:g} s"

    def connect(self) -> Identity:
        identity = self._controller.connect()
        self.close()
        return identity

    def open_for(self, longest_s: float) -> None:
        timed = longest_s <= _LONGEST_PULSE_S
        self._controller.command(f"SHUT:PULS {round(longest_s * 1e6)}" if timed else "SHUT:STAT OPEN")
        if self.state() != "open":
            tripped = self._controller.query("SYST:INT?", lambda reply: reply in ("0", "1")) == "1"
            why = "the interlock is tripped" if tripped else "it stays closed"
            raise DeviceError(f"{self.name}: does not open ({why}); check interlock and shutter head")

    def close(self) -> None:
        self._controller.command("SHUT:STAT CLOS")
        if self.state() != "closed":
            raise DeviceError(f"{self.name}: told to close, but is open; block the beam by hand")

    def state(self) -> ShutterState:
        reply = self._controller.query("SHUT:STAT?", lambda reply: reply in ("OPEN", "CLOS"))
        return "open" if reply == "OPEN" else "closed"

    def measured_pulse(self, us: int) -> tuple[int, str]:
        """Length of one pulse as read back [µs], and of what: "light", or "commanded" without a photodiode."""
        self._controller.command(f"SHUT:PULS {us}")
        deadline = time.monotonic() + us / 1e6 + _MEASURED_S
        while True:
            length, _, source = self._controller.query(
                "SHUT:PULS:MEAS?", lambda reply: reply.count(",") == 1
            ).partition(",")
            if source != "running" and length.isdigit():
                return int(length), source
            if time.monotonic() > deadline:
                raise DeviceError(f"{self.name}: a pulse of {us} µs has not ended; check firmware and shutter head")
            time.sleep(_LOOK_S)

    def shortest_us(self) -> int:
        """Shortest pulse of the output type."""
        return int(self._controller.query("SHUT:PULS:MIN?", str.isdigit))

    def clock_us(self) -> int:
        """The controller's own clock, by its nominal rate; wraps at 2^31."""
        return int(self._controller.query("SYST:TIME?", str.isdigit))

    def keep_clock(self, ppm: int) -> None:
        """How much faster than nominal the clock runs; the controller reckons with it from now on."""
        self._controller.command(f"SYST:CLOC {ppm}")

    def release(self) -> None:
        self._controller.release()


class ScpiBeam:
    """The beam of a controller."""

    def __init__(self, controller: ScpiController, level: float = 1.0) -> None:
        self._controller, self._level = controller, level

    @property
    def name(self) -> str:
        return self._controller.name

    def connect(self) -> Identity:
        return self._controller.connect()

    def on(self) -> None:
        self._controller.command(f"BEAM:LEV {self._level:g}")
        self._controller.command("BEAM:STAT ON")

    def off(self) -> None:
        self._controller.command("BEAM:STAT OFF")

    def ping(self) -> None:
        """Let the controller's watchdog hear of us."""
        self._controller.query("BEAM:STAT?", lambda reply: reply in ("ON", "OFF"))

    def release(self) -> None:
        self._controller.release()
