"""`bssrdf rig test`: pulses of the project's controller as its read-back measures them, and its clock against ours."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from statistics import mean

from bssrdf.errors import DeviceError, UsageError
from bssrdf.rig.capture import safe
from bssrdf.rig.devices import devices_of, ports_of
from bssrdf.rig.interrupts import Interrupts, interrupts
from bssrdf.rig.locks import lock_ports
from bssrdf.rig.rig_toml import read_rig
from bssrdf.rig.scpi import ScpiShutter

PULSES_US = (100, 1000, 2000, 4000, 16_000, 64_000, 256_000, 1_000_000, 4_000_000)
REPEATS = 3
_CLOCK_S = 60.0
"""Long enough that a millisecond on the way to the board is 20 ppm."""
_MOST_PPM = 20_000
"""What the controller takes: four times a ceramic resonator's tolerance."""


def pulse_test(rig_file: Path, *, set_clock: bool = False) -> Iterator[str]:
    """The table, line by line as it is measured; with `set_clock` the clock's error is kept in the controller.

    DeviceError where the controller refuses or the blade does not move. The shutter is closed in every way out.
    """
    rig = read_rig(rig_file)
    devices = devices_of(rig)
    shutter = devices.shutter
    if not isinstance(shutter, ScpiShutter):
        raise UsageError(f"{rig_file}: [shutter] driver {rig.shutter.driver} reads no pulse back; only scpi does")
    with lock_ports(ports_of(rig)), interrupts() as signals, safe(devices, signals):
        version = shutter.connect().version
        devices.beam.connect()
        devices.beam.on()
        yield f"{shutter.name}: {version}"
        clock = _Clock(shutter, rig.speed)
        yield from _table(shutter, signals)
        if set_clock:
            clock.wait()
        ppm, unsure_ppm = clock.rate()
        yield f"clock: {ppm:+d} ppm against this computer's, within {unsure_ppm} ppm"
        if abs(ppm) - unsure_ppm > _MOST_PPM:
            raise DeviceError(f"{shutter.name}: its clock is off by {ppm} ppm; the board is defective")
        if set_clock:
            shutter.keep_clock(ppm)
            yield f"kept in the controller: SYST:CLOC {ppm}"


def _table(shutter: ScpiShutter, signals: Interrupts) -> Iterator[str]:
    """A row for each length; the photodiode's word for it, or a remark that there is none."""
    yield f"{'asked [ms]':>12} {'measured [ms]':>14} {'error [µs]':>11} {'spread [µs]':>12}  of"
    source = ""
    for us in (us for us in PULSES_US if us >= shutter.shortest_us()):
        pulses = []
        for _ in range(REPEATS):
            if signals.finish_frame:
                raise KeyboardInterrupt
            measured, source = shutter.measured_pulse(us)
            pulses.append(measured)
        spread = max(pulses) - min(pulses)
        yield f"{us / 1e3:12g} {mean(pulses) / 1e3:14.3f} {mean(pulses) - us:+11.0f} {spread:12.0f}  {source}"
        if source == "light" and not any(pulses):
            raise DeviceError(f"{shutter.name}: the photodiode saw no light; check blade, beam and threshold")
    if source == "commanded":
        yield "no photodiode is fitted: these are times of the output, not of the light (docs/controller.md)"


class _Clock:
    """The controller's clock beside ours, from its making on."""

    def __init__(self, shutter: ScpiShutter, speed: float) -> None:
        self._shutter, self._speed = shutter, speed
        self._first = self._sample()

    def _sample(self) -> tuple[float, float, float]:
        """Our time, half the time that asking took, and theirs [s]; the quickest of ten."""
        tries = []
        for _ in range(10):
            start = time.monotonic()
            theirs_s = self._shutter.clock_us() / 1e6
            end = time.monotonic()
            tries.append(((end - start) / 2 * self._speed, (start + end) / 2 * self._speed, theirs_s))
        return min(tries)

    def wait(self) -> None:
        while self._sample()[1] - self._first[1] < _CLOCK_S:
            time.sleep(0.25)

    def rate(self) -> tuple[int, int]:
        """How much faster than ours it runs, and what that may be off by [ppm]."""
        unsure_s, ours_s, theirs_s = self._sample()
        passed_s = ours_s - self._first[1]
        theirs_passed_s = (theirs_s - self._first[2]) % (2**31 / 1e6)
        return round((theirs_passed_s / passed_s - 1) * 1e6), round((unsure_s + self._first[0]) / passed_s * 1e6)
