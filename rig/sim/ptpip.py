"""PTP over TCP (ISO 15740 and CIPA DC-005): the packets, and a responder for one camera on loopback."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

OK = 0x2001
GENERAL_ERROR = 0x2002
NOT_SUPPORTED = 0x2005
PROPERTY_NOT_SUPPORTED = 0x200A
STORE_FULL = 0x200C
BUSY = 0x2019
INVALID_VALUE = 0x201C

OBJECT_ADDED = 0x4002
CAPTURE_COMPLETE = 0x400D

_INIT_COMMAND, _INIT_COMMAND_ACK = 1, 2
_INIT_EVENT, _INIT_EVENT_ACK = 3, 4
_REQUEST, _RESPONSE, _EVENT, _START_DATA, _DATA, _END_DATA = 6, 7, 8, 9, 10, 12
_DATA_FOLLOWS = 2


class Answer(NamedTuple):
    """What an operation gives back: response code, data phase if any, parameters."""

    code: int
    data: bytes | None = None
    parameters: Sequence[int] = ()


Operate = Callable[[int, list[int], bytes, int], Answer]
"""(operation code, parameters, data from the host, transaction) to its answer."""


def text(value: str) -> bytes:
    """A PTP string."""
    return bytes([len(value) + 1]) + value.encode("utf-16le") + b"\0\0" if value else b"\0"


def array(values: Sequence[int], form: str = "H") -> bytes:
    """A PTP array of integers of one size."""
    return struct.pack(f"<I{len(values)}{form}", len(values), *values)


class Responder:
    """Serves one camera on a TCP port; a new connection replaces the one before."""

    def __init__(self, operate: Operate, name: str, port: int = 0) -> None:
        self._operate = operate
        self._name = name
        self._listener = socket.create_server(("127.0.0.1", port))
        self._events: socket.socket | None = None

    @property
    def port(self) -> int:
        return int(self._listener.getsockname()[1])

    def send_event(self, code: int, transaction: int, parameters: Sequence[int]) -> None:
        """Tell the host of something that happened; nothing where it does not listen."""
        body = struct.pack(f"<HI{len(parameters)}I", code, transaction, *parameters)
        if self._events is not None:
            with contextlib.suppress(OSError):
                self._events.sendall(_packet(_EVENT, body))

    def serve(self) -> None:
        """Accept connections until the process is ended."""
        while True:
            connection, _ = self._listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._greet, args=(connection,), daemon=True).start()

    def _greet(self, connection: socket.socket) -> None:
        try:
            kind, _ = _receive(connection)
            if kind == _INIT_COMMAND:
                name = self._name.encode("utf-16le") + b"\0\0"
                body = struct.pack("<I", 1) + bytes(16) + name + struct.pack("<I", 0x10000)
                connection.sendall(_packet(_INIT_COMMAND_ACK, body))
                self._converse(connection)
            elif kind == _INIT_EVENT:
                self._events = connection
                connection.sendall(_packet(_INIT_EVENT_ACK, b""))
        except (EOFError, OSError):
            connection.close()

    def _converse(self, connection: socket.socket) -> None:
        while True:
            kind, body = _receive(connection)
            if kind != _REQUEST:
                continue
            phase, code, transaction = struct.unpack_from("<IHI", body)
            parameters = list(struct.unpack(f"<{(len(body) - 10) // 4}I", body[10:]))
            data = _receive_data(connection) if phase == _DATA_FOLLOWS else b""
            answer = self._operate(code, parameters, data, transaction)
            if answer.data is not None:
                start = struct.pack("<IQ", transaction, len(answer.data))
                connection.sendall(_packet(_START_DATA, start))
                connection.sendall(_packet(_END_DATA, struct.pack("<I", transaction) + answer.data))
            response = struct.pack(f"<HI{len(answer.parameters)}I", answer.code, transaction, *answer.parameters)
            connection.sendall(_packet(_RESPONSE, response))


def _packet(kind: int, body: bytes) -> bytes:
    return struct.pack("<II", 8 + len(body), kind) + body


def _receive(connection: socket.socket) -> tuple[int, bytes]:
    length, kind = struct.unpack("<II", _exactly(connection, 8))
    return kind, _exactly(connection, length - 8)


def _receive_data(connection: socket.socket) -> bytes:
    _receive(connection)  # start of data, with its length
    data = b""
    while True:
        kind, body = _receive(connection)
        data += body[4:]
        if kind == _END_DATA:
            return data


def _exactly(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = connection.recv(size - len(data))
        if not more:
            raise EOFError
        data += more
    return data
