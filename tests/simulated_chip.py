"""The controller's firmware in simavr, a process of its own: time stands still until a test lets it run."""

from __future__ import annotations

import subprocess
from itertools import pairwise
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[1] / "firmware"
CYCLES_PER_MS = 16_000
TTL_KEPT = ["SHUT:TYPE TTL"]
"""What a board is told once, when it is new."""


PROBES = {
    "make": (["make", "--version"], ""),
    "avr-gcc and avr-libc": (["avr-gcc", "-mmcu=atmega328p", "-E", "-"], "#include <avr/io.h>"),
    "a C compiler, libsimavr-dev and libelf-dev": (
        ["cc", "-x", "c", "-I/usr/include/simavr", "-", "-o", "/dev/null", "-lsimavr", "-lelf"],
        "#include <sim_avr.h>\nint main(void) { return !avr_make_mcu_by_name; }",
    ),
}
"""What must run to build firmware and simulator, and on what input."""


def built(folder: Path) -> Path:
    """The folder with firmware and simulated chip, built; the test is skipped where the tools for it are missing."""
    missing = [tool for tool, probe in PROBES.items() if not _runs(*probe)]
    if missing:
        pytest.skip(f"needs {', '.join(missing)} (.ci/apt installs them on Debian and Ubuntu)")
    words = ["make", "-C", str(FIRMWARE), f"OUT={folder}", "simulator"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr, done.stderr
    return folder


def _runs(words: list[str], text: str) -> bool:
    try:
        return subprocess.run(words, input=text, capture_output=True, text=True).returncode == 0
    except FileNotFoundError:
        return False


class Chip:
    """One chip; `edges` has what its pins did, as (cycle, level); `heard` is when its last answer ended."""

    def __init__(self, folder: Path, *, set_up: list[str] | None = None) -> None:
        words = [folder / "chip", folder / "controller.elf"]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.edges: dict[str, list[tuple[int, int]]] = {}
        self.said = b""
        self.cycle = self.heard = 0
        self.run_ms(100)
        for command in set_up if set_up is not None else TTL_KEPT:
            self.send(command)
        self.errors()

    def tell(self, line: str) -> None:
        """A line to the simulator."""
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def run_ms(self, ms: float) -> None:
        self.tell(f"run {round(ms * CYCLES_PER_MS)}")
        self._until("at")

    def write(self, data: bytes, delay: int = 0) -> None:
        """Bytes to the serial port, one behind another, so many cycles from now on."""
        if data:
            self.tell(f"send {data.hex()} {delay}")

    def send(self, command: str, ms: float = 100.0) -> None:
        """A command, and time for it: one that is kept in EEPROM takes tens of milliseconds."""
        self.write(command.encode() + b"\n")
        self.run_ms(ms)

    def ask(self, question: str, ms: float = 20.0) -> str:
        self.said = b""
        self.send(question, ms)
        return self.said.decode("ascii").removesuffix("\n")

    def errors(self) -> list[str]:
        """The queue, emptied."""
        found = []
        while not (error := self.ask("SYST:ERR?")).startswith("0,"):
            found.append(error)
        return found

    def codes(self) -> list[int]:
        return [int(error.split(",")[0]) for error in self.errors()]

    def level(self, pin: str) -> int:
        return self.edges[pin][-1][1]

    def forget_edges(self) -> None:
        self.edges = {pin: edges[-1:] for pin, edges in self.edges.items()}

    def pulses_us(self, pin: str) -> list[float]:
        """Lengths of what the pin was high for since `forget_edges`."""
        edges = self.edges[pin]
        return [(end - start) / 16 for (start, high), (end, _) in pairwise(edges) if high]

    def eeprom(self) -> bytes:
        self.tell("eeprom 0")
        return bytes.fromhex(self._until("eeprom")[0])

    def deepest_stack(self) -> int:
        """Bytes that the stack ever took."""
        self.tell("stack")
        return int(self._until("stack")[0])

    def reset(self, cause: int = 1) -> None:
        """Reset with what MCUSR says of its cause: power 1, reset pin 2, brown-out 4."""
        self.tell(f"reset {cause}")
        self.run_ms(100)

    def release(self) -> None:
        self._process.kill()
        self._process.communicate()

    def _until(self, last: str) -> list[str]:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            word, *rest = line.split()
            if word == "out":
                self.said += bytes.fromhex(rest[0])
                self.heard = int(rest[1])
            elif word not in ("at", "eeprom", "stack"):
                self.edges.setdefault(word, []).append((int(rest[1]), int(rest[0])))
            if word == "at":
                self.cycle = int(rest[0])
            if word == last:
                return rest
        raise AssertionError("the simulated chip ended")
