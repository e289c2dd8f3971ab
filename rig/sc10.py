"""Thorlabs SC10 shutter controller: 9600 baud, CR, echoes each command, prompt "> " (SC10 manual, chapter 5).

`ens` toggles, so it is only ever sent after `ens?` has told the state. Controllers of some firmwares send no echo, put
the prompt first, or end lines by CR LF; what they do is learnt from their answer to `id?`.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable

from bssrdf.errors import DeviceError
from bssrdf.rig.ports import Identity, ShutterState
from bssrdf.rig.serial_line import BadReply, SerialLine, Wire, open_wire

BAUD = 9600
_PROMPT = b">"
_SINGLE = 3
"""Mode in which `ens` opens for `open=` milliseconds."""
_LONGEST_MS = 999_999
_TRIES = 3


class _CommandRefused(DeviceError):
    """The controller does not know the command."""


class Sc10Shutter:
    """The shutter of an SC10; the controller closes it by itself after the time given to `open_for`."""

    after_kill = "the controller closes the shutter when the frame's own time is over"

    def __init__(
        self,
        port: str,
        *,
        timeout_s: float = 1.0,
        blade_s: float = 0.5,
        open_port: Callable[[str, int, float], Wire] = open_wire,
    ) -> None:
        self.name = f"sc10 on {port}"
        self._port, self._timeout_s, self._blade_s, self._open_port = port, timeout_s, blade_s, open_port
        self._line: SerialLine | None = None
        self._echoes = self._prompts_first = False

    def connect(self) -> Identity:
        self._line = SerialLine(self.name, self._open_port(self._port, BAUD, self._timeout_s))
        self._echoes = self._prompts_first = False
        version = self._introduced()
        self.close()
        self._retried(f"mode={_SINGLE}")
        return Identity("sc10", self._port, version)

    def open_for(self, longest_s: float) -> None:
        self._retried(f"open={min(round(longest_s * 1000), _LONGEST_MS)}")
        self._toggle_to("1")
        if not self._blade_reaches("open"):
            self._toggle_to("0")
            raise DeviceError(f"{self.name}: enabled, but the blade stays closed; is the shutter head plugged in?")

    def close(self) -> None:
        self._toggle_to("0")
        if not self._blade_reaches("closed"):
            raise DeviceError(f"{self.name}: disabled, but the blade is not closed; block the beam by hand")

    def state(self) -> ShutterState:
        return "closed" if self._flag("closed?") == "1" else "open"

    def release(self) -> None:
        if self._line is not None:
            self._line.release()
            self._line = None

    def _toggle_to(self, enabled: str) -> None:
        """Send `ens` while `ens?` shows the need: a lost reply is settled by asking, never by repeating."""
        for _ in range(_TRIES):
            if self._flag("ens?") == enabled:
                return
            try:
                self._exchange("ens")
            except BadReply:
                self._wire().drain(self._timeout_s)
        if self._flag("ens?") != enabled:
            verb, interlock = ("open", self._flag("interlock?")) if enabled == "1" else ("close", "0")
            why = "the interlock is tripped" if interlock == "1" else f"{_TRIES} times asked"
            raise DeviceError(f"{self.name}: does not {verb} ({why}); check interlock and key switch")

    def _blade_reaches(self, wanted: ShutterState) -> bool:
        deadline = time.monotonic() + self._blade_s
        while self.state() != wanted:
            if time.monotonic() > deadline:
                return False
        return True

    def _flag(self, command: str) -> str:
        reply = self._retried(command)
        if reply not in ("0", "1"):
            raise DeviceError(f"{self.name}: {command!r} answered {reply!r}, not 0 or 1; check baud rate and cable")
        return reply

    def _retried(self, command: str) -> str:
        """The reply to a question or a setting, which may be sent again; never for `ens`."""
        for _ in range(_TRIES - 1):
            try:
                return self._exchange(command)
            except BadReply:
                self._wire().drain(self._timeout_s)
        return self._exchange(command)

    def _introduced(self) -> str:
        """The controller's name; it may refuse the first command, with what stood in its buffer before it."""
        try:
            return self._retried("id?")
        except _CommandRefused:
            return self._retried("id?")

    def _exchange(self, command: str) -> str:
        """Send one command and return its reply, without echo and prompt."""
        sent = command.encode() + b"\r"
        line = self._wire()
        line.forget()
        line.send(sent)
        reply = self._reply(line, sent)
        lines = [text for raw in re.split(rb"[\r\n]+", reply) if (text := raw.strip())]
        if lines[:1] == [command.encode()]:
            self._echoes, lines = True, lines[1:]
        elif self._echoes or len(lines) != command.endswith("?"):
            raise BadReply(f"{self.name}: {sent!r} came back as {reply!r}; is it another device, or another baud rate?")
        text = b" ".join(lines).decode("ascii", "replace")
        if "CMD_" in text:
            raise _CommandRefused(f"{self.name}: {sent!r} was refused with {text!r}; is its firmware older than 1.0?")
        return text

    def _reply(self, line: SerialLine, sent: bytes) -> bytes:
        """What comes before the prompt, or after it where the prompt comes first."""
        if not self._prompts_first:
            reply = line.receive(_PROMPT, after=sent)
            if reply.strip() or self._echoes or not sent.endswith(b"?\r"):
                return reply
            self._prompts_first = True
        lines = [line.receive(b"\r", after=sent) for _ in range(2 if sent.endswith(b"?\r") else 1)]
        return b"\r".join(text.strip(_PROMPT + b" \n") for text in lines)

    def _wire(self) -> SerialLine:
        if self._line is None:
            raise DeviceError(f"{self.name}: is not connected")
        return self._line
