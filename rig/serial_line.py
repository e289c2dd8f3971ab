"""One serial device: bytes out, a terminated reply back within a deadline, or an error that shows the bytes."""

from __future__ import annotations

import contextlib
from typing import Protocol

import serial

try:
    from termios import error as TerminalError
except ImportError:  # Windows
    TerminalError = OSError  # type: ignore[assignment,misc]

from bssrdf.errors import DeviceError

_LOST = (serial.SerialException, OSError, TerminalError)
"""What a port raises that is gone; termios has an error of its own."""


class BadReply(DeviceError):
    """No reply in time, or not one that the device gives: a question may be asked again."""


class Wire(Protocol):
    """What is used of `serial.Serial`; tests put an exact script in its place."""

    timeout: float | None

    def write(self, data: bytes) -> int | None: ...

    def read_until(self, expected: bytes) -> bytes: ...

    def reset_input_buffer(self) -> None: ...

    def close(self) -> None: ...


def open_wire(port: str, baud: int, timeout_s: float) -> Wire:
    """The port, 8N1; a write that does not go out in time fails too."""
    try:
        return serial.Serial(port, baud, timeout=timeout_s, write_timeout=timeout_s)
    except (*_LOST, ValueError) as error:
        raise DeviceError(
            f"{port}: cannot be opened ({_reason(error)}); is the device plugged in and yours?"
        ) from error


class SerialLine:
    """Commands and replies of the device `name`, for messages."""

    def __init__(self, name: str, wire: Wire) -> None:
        self.name = name
        self._wire = wire

    def send(self, command: bytes) -> None:
        """Write a command that gets no reply."""
        try:
            self._wire.write(command)
        except _LOST as error:
            raise DeviceError(
                f"{self.name}: {command!r} could not be sent ({_reason(error)}); is it unplugged?"
            ) from error

    def receive(self, terminator: bytes, after: bytes) -> bytes:
        """Bytes up to and without `terminator`; `after` is the command they answer."""
        try:
            reply = self._wire.read_until(terminator)
        except _LOST as error:
            raise DeviceError(f"{self.name}: lost after {after!r} ({_reason(error)}); is it unplugged?") from error
        if not reply.endswith(terminator):
            raise BadReply(
                f"{self.name}: {after!r} got {reply!r} within {self._wire.timeout:g} s, without its end "
                f"{terminator!r}; check cable, power and baud rate"
            )
        return reply.removesuffix(terminator)

    def forget(self) -> None:
        """Drop what has come in and was not asked for."""
        try:
            self._wire.reset_input_buffer()
        except _LOST as error:
            raise DeviceError(f"{self.name}: lost ({_reason(error)}); is it unplugged?") from error

    def drain(self, seconds: float) -> bytes:
        """What comes in until nothing does for `seconds`: a banner, or the rest of a garbled reply."""
        usual, self._wire.timeout = self._wire.timeout, seconds
        try:
            return self._wire.read_until(b"\xff\xfe never sent")
        except _LOST as error:
            raise DeviceError(f"{self.name}: lost ({_reason(error)}); is it unplugged?") from error
        finally:
            self._wire.timeout = usual

    def release(self) -> None:
        with contextlib.suppress(*_LOST):
            self._wire.close()


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
