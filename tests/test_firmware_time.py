"""The controller's firmware by the clock of its simulated chip: pulses, watchdog, interlock, the light's own time."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from simulated_chip import CYCLES_PER_MS, Chip

BUSY = b"SYST:TIME?\nSHUT:PULS:MEAS?\nNONSENSE\n"
"""What keeps both directions of the serial port going all the time: 35 bytes in, at 0.19 ms each."""
ISSUED_MS = (0.1, 1, 2, 4, 16, 64, 256, 1000, 4000)
STEPS_US = (101, 999, 14_999, 15_000, 15_001, 29_999, 30_000, 30_001, 32_768, 45_001, 60_001, 65_536, 123_457)
"""Odd lengths, and those at which the number of matches on the way changes."""


def busy_pulse_us(chip: Chip, us: int) -> float:
    """Length of one pulse with the serial port busy from before until after it."""
    chip.forget_edges()
    chip.write(BUSY * 2 + f"SHUT:PULS {us}\n".encode() + BUSY * (us // 6000 + 5))
    chip.run_ms(1.2 * us / 1000 + 200)
    (length,) = chip.pulses_us("shutter")
    return length


def test_a_pulse_is_as_long_as_asked_while_the_port_is_busy(chip: Chip) -> None:
    table = {us: busy_pulse_us(chip, us) - us for us in (*(round(1000 * ms) for ms in ISSUED_MS), *STEPS_US)}
    print("".join(f"\n{us / 1000:9g} ms  {error:+5.2f} µs" for us, error in table.items()))
    assert all(abs(error) <= 1 for error in table.values()), table


def test_a_minute_goes_by_under_a_watchdog_of_five_seconds_while_the_host_talks(chip: Chip) -> None:
    assert chip.ask("SYST:WATC?") == "5000"
    chip.send("SHUT:PULS 60000000")
    for _ in range(16):
        chip.send("SHUT:STAT?", 4000)
    assert chip.pulses_us("shutter") == pytest.approx([60e6], abs=10)
    assert chip.errors() == []


def test_a_match_from_before_is_not_taken_for_the_opening(chip: Chip) -> None:
    """The compare unit matches once a turn of its timer, every 32.768 ms, also at rest; here, as an opening begins."""
    turn = 8 * 65_536
    sent = chip.cycle
    chip.send("SHUT:PULS 100", 40)
    lag = chip.edges["shutter"][-2][0] - sent
    for early in range(0, 40 * 16, 16):
        delay = chip.edges["shutter"][-1][0] + 3 * turn - lag + early - chip.cycle
        chip.write(b"SHUT:PULS 100\n", delay)
        chip.run_ms(delay / CYCLES_PER_MS + 40)
    assert len(chip.pulses_us("shutter")) == 41
    assert chip.pulses_us("shutter") == pytest.approx([100] * 41, abs=1)
    assert chip.ask("SHUT:PULS:MEAS?") == "100,commanded"


@pytest.mark.parametrize("ms", [10, 250, 5000, 7777])
def test_the_watchdog_closes_in_mid_pulse_and_darkens_and_says_so(chip: Chip, ms: int) -> None:
    for command in ("BEAM:STAT ON", f"SYST:WATC {ms}"):
        chip.send(command, 5)
    chip.write(b"CAM:PULS 30000000\nSHUT:PULS 30000000\n")
    chip.run_ms(7.2)
    last_byte = chip.cycle
    while not chip.level("shutter"):
        last_byte = chip.cycle
        chip.run_ms(0.05)
    chip.run_ms(ms + 100)
    for pin in ("shutter", "beam", "camera"):
        assert chip.level(pin) == 0
        silent_ms = (chip.edges[pin][-1][0] - last_byte) / CYCLES_PER_MS
        assert ms - 1 < silent_ms < ms + 2
    assert chip.errors() == ['-365,"Time out error; host silent"']
    assert chip.ask("SHUT:STAT?") == "CLOS"


def test_the_watchdog_guards_again_after_it_has_bitten_and_not_at_all_when_it_is_off(chip: Chip) -> None:
    chip.send("SYST:WATC 200")
    for _ in range(2):
        chip.send("SHUT:STAT OPEN", 500)
        assert chip.level("shutter") == 0
        assert chip.codes() == [-365]
    chip.run_ms(1000)
    assert chip.errors() == []
    chip.send("SYST:WATC 0")
    chip.send("SHUT:STAT OPEN", 20_000)
    assert chip.level("shutter") == 1


@pytest.mark.parametrize("phase_us", range(0, 200, 17))
def test_the_interlock_closes_within_a_millisecond_and_the_shutter_stays_closed(chip: Chip, phase_us: int) -> None:
    chip.send("SHUT:PULS 60000000", 20 + phase_us / 1000)
    tripped = chip.cycle
    chip.tell("interlock 1")
    chip.run_ms(5)
    assert chip.level("shutter") == 0
    assert (chip.edges["shutter"][-1][0] - tripped) / CYCLES_PER_MS < 1
    for command in ("SHUT:PULS 1000", "SHUT:STAT OPEN"):
        chip.send(command)
    assert chip.errors() == ['-221,"Settings conflict; interlock"'] * 3
    assert chip.ask("SYST:INT?") == "1"
    chip.tell("interlock 0")
    chip.run_ms(100)
    assert chip.ask("SYST:INT?") == "0"
    assert chip.level("shutter") == 0
    chip.send("SHUT:PULS 1000")
    assert chip.pulses_us("shutter")[-1] == pytest.approx(1000, abs=1)


def test_a_spike_on_the_interlock_is_no_trip_and_a_bouncing_lid_is_open_until_it_rests(chip: Chip) -> None:
    chip.send("SHUT:STAT OPEN")
    for _ in range(20):
        chip.tell("interlock 1")
        chip.run_ms(0.35)
        chip.tell("interlock 0")
        chip.run_ms(1.27)
    assert chip.level("shutter") == 1
    chip.tell("interlock 1")
    chip.run_ms(30)
    for _ in range(10):
        chip.tell("interlock 0")
        chip.run_ms(20)
        assert chip.ask("SYST:INT?") == "1"
        chip.tell("interlock 1")
        chip.run_ms(1)
    chip.tell("interlock 0")
    chip.run_ms(49)
    chip.send("SHUT:PULS 1000", 0.9)
    chip.run_ms(20)
    assert chip.ask("SYST:INT?") == "0"


def test_an_open_interlock_at_the_start_keeps_it_closed(chip: Chip) -> None:
    chip.tell("interlock 1")
    chip.reset()
    chip.send("SHUT:STAT OPEN")
    assert chip.errors() == ['-221,"Settings conflict; interlock"']
    assert chip.level("shutter") == 0


def light_us(chip: Chip) -> float:
    return sum(chip.pulses_us("light"))


@pytest.mark.parametrize(("lag_ms", "bounce_ms"), [(12, 5), (3.3, 0.4), (25, 8)])
def test_with_a_photodiode_the_read_back_is_the_light_of_a_slow_bouncing_blade(
    chip: Chip, lag_ms: float, bounce_ms: float
) -> None:
    chip.send("SHUT:TYPE SOL")
    chip.send("SHUT:SENS ON")
    chip.tell(f"blade {round(lag_ms * CYCLES_PER_MS)} {round(bounce_ms * CYCLES_PER_MS)}")
    for us in (20_000, 33_333, 64_000, 256_000, 1_000_000):
        chip.forget_edges()
        chip.write(f"SHUT:PULS {us}\n".encode() + BUSY * (us // 6500))
        chip.run_ms(us / 1000 + 110)
        assert len(chip.pulses_us("light")) == 5
        chip.errors()
        measured, source = chip.ask("SHUT:PULS:MEAS?").split(",")
        assert source == "light"
        assert float(measured) == pytest.approx(light_us(chip), abs=10)
        assert float(measured) != pytest.approx(us, abs=30)


def test_without_a_photodiode_the_read_back_is_the_output_s_and_says_so(chip: Chip) -> None:
    chip.send("SHUT:PULS 64000", 30)
    assert chip.ask("SHUT:PULS:MEAS?").endswith(",running")
    chip.run_ms(100)
    assert chip.ask("SHUT:PULS:MEAS?") == "64000,commanded"
    chip.send("SHUT:PULS 64000000", 30)
    chip.send("SHUT:STAT CLOS")
    measured, source = chip.ask("SHUT:PULS:MEAS?").split(",")
    assert source == "commanded"
    assert float(measured) == pytest.approx(chip.pulses_us("shutter")[-1], abs=2)


def test_a_blade_that_sticks_is_seen_by_the_photodiode(chip: Chip) -> None:
    chip.send("SHUT:SENS ON")
    chip.send("SHUT:PULS 1000")
    assert chip.ask("SHUT:PULS:MEAS?") == "0,light"
    chip.tell("light 1")
    chip.send("SHUT:STAT OPEN")
    chip.write(b"SHUT:STAT CLOS\n")
    assert chip.ask("SHUT:STAT?", 60) == "OPEN"
    assert chip.level("shutter") == 0
    chip.tell("light 0")
    assert chip.ask("SHUT:STAT?") == "CLOS"
    chip.write(b"SHUT:STAT OPEN\n")
    assert chip.ask("SHUT:STAT?", 60) == "OPEN"
    chip.write(b"SHUT:STAT CLOS\n")
    chip.send("BEAM:STAT ON")
    chip.write(b"SHUT:STAT OPEN\n")
    assert chip.ask("SHUT:STAT?", 60) == "CLOS"


def test_asked_for_its_state_it_waits_for_the_blade(chip: Chip) -> None:
    for command in ("SHUT:TYPE SOL", "SHUT:SENS ON", "BEAM:STAT ON"):
        chip.send(command)
    chip.tell(f"blade {12 * CYCLES_PER_MS} {5 * CYCLES_PER_MS}")
    for command, answer, lag_ms in (("SHUT:STAT OPEN", "OPEN", 12), ("SHUT:STAT CLOS", "CLOS", 9)):
        chip.write(command.encode() + b"\n")
        sent = chip.cycle
        assert chip.ask("SHUT:STAT?", 60) == answer
        assert chip.edges["shutter"][-1][0] - sent < 4 * CYCLES_PER_MS
        assert (chip.heard - chip.edges["shutter"][-1][0]) / CYCLES_PER_MS == pytest.approx(lag_ms + 0.5, abs=1)


@pytest.mark.slow
def test_an_opening_longer_than_the_clock_can_count_is_not_a_number(chip: Chip) -> None:
    """After 17 minutes of the chip's time."""
    chip.send("SYST:WATC 0")
    chip.send("SHUT:STAT OPEN", 1_040_000)
    assert chip.ask("SHUT:PULS:MEAS?").split(",")[0].isdigit()
    chip.run_ms(20_000)
    chip.send("SHUT:STAT CLOS")
    assert chip.ask("SHUT:PULS:MEAS?") == "9.91E37,commanded"
    chip.send("SHUT:PULS 1000")
    assert chip.ask("SHUT:PULS:MEAS?") == "1000,commanded"


def test_a_pulse_while_the_blade_still_closes_is_refused(chip: Chip) -> None:
    chip.send("SHUT:TYPE SOL")
    chip.send("SHUT:PULS 20000", 40)
    for command in ("SHUT:PULS 20000", "SHUT:STAT OPEN"):
        chip.send(command, 5)
    assert chip.errors() == ['-221,"Settings conflict; closing"'] * 2
    chip.send("SHUT:PULS 20000")
    assert chip.errors() == []
    assert chip.pulses_us("shutter") == pytest.approx([20_000, 20_000], abs=1)


def test_a_pulse_said_again_while_it_runs_ends_so_long_after_the_last(chip: Chip) -> None:
    rng = random.Random(3)
    for _ in range(12):
        chip.forget_edges()
        length_us, pause_ms = rng.randrange(2_000, 90_000), rng.uniform(0.5, 60)
        chip.write(f"SHUT:PULS {length_us}\n".encode())
        chip.run_ms(4.5)
        while chip.level("shutter") and pause_ms > 0:
            chip.run_ms(0.5)
            pause_ms -= 0.5
        sent = chip.cycle
        chip.write(b"SHUT:PULS 50000\n")
        chip.run_ms(150)
        lengths = chip.pulses_us("shutter")
        if chip.errors():
            assert lengths == pytest.approx([length_us], abs=1)
            continue
        end = chip.edges["shutter"][-1][0]
        assert 50 < (end - sent) / CYCLES_PER_MS < 54


def test_the_clock_s_error_is_taken_out_of_pulses_watchdog_and_read_back(chip: Chip) -> None:
    for ppm in (-20_000, 5000):
        chip.send(f"SYST:CLOC {ppm}")
        chip.forget_edges()
        chip.send("SHUT:PULS 256000", 400)
        assert chip.pulses_us("shutter") == pytest.approx([256_000 * (1 + ppm / 1e6)], abs=1)
        assert chip.ask("SHUT:PULS:MEAS?") == "256000,commanded"
        chip.send("SYST:WATC 1000")
        start = chip.cycle
        chip.send("SHUT:STAT OPEN", 1100)
        assert (chip.edges["shutter"][-1][0] - start) / 16e6 == pytest.approx(1 + ppm / 1e6, abs=4e-3)
        chip.errors()
        chip.send("*RST")


def test_the_clock_counts_nominal_microseconds(chip: Chip) -> None:
    chip.send("SYST:CLOC 3000")
    first, start = int(chip.ask("SYST:TIME?")), chip.cycle
    chip.run_ms(10_000)
    second = int(chip.ask("SYST:TIME?"))
    assert second - first == pytest.approx((chip.cycle - start) / 16, abs=400)


def test_a_servo_follows_at_each_edge_and_holds_between(chip: Chip) -> None:
    chip.send("SHUT:SERV 900,2100")
    chip.send("SHUT:TYPE SERV", 100)
    for pause_ms in (1000, 1007.3, 1013.9):
        chip.run_ms(pause_ms)
        chip.forget_edges()
        chip.send("SHUT:PULS 317000", 800)
        (opened, _), (closed, _) = chip.edges["shutter"][1:]
        assert (closed - opened) / 16 == pytest.approx(317_000, abs=1)
        starts = [cycle for cycle, high in chip.edges["servo"][1:] if high]
        assert all(4.9 <= (b - a) / CYCLES_PER_MS <= 25.1 for a, b in pairwise(starts))
        widths = dict(zip(starts, chip.pulses_us("servo")[-len(starts) :], strict=False))
        for start, width in widths.items():
            assert width == pytest.approx(2100 if opened <= start < closed else 900, abs=2)
        for edge in (opened, closed):
            assert any(0 <= start - edge < 0.05 * CYCLES_PER_MS for start in starts)
    chip.send("SHUT:TYPE TTL")
    chip.forget_edges()
    chip.run_ms(200)
    assert chip.edges["servo"] == [chip.edges["servo"][0]]


@pytest.mark.parametrize("us", [1000, 12_345, 250_000, 3_000_000])
def test_the_camera_s_release_is_pressed_so_long(chip: Chip, us: int) -> None:
    chip.send(f"CAM:PULS {us}", us / 1000 + 50)
    assert chip.pulses_us("camera") == pytest.approx([us], abs=201)


@pytest.mark.parametrize(("level", "duty"), [(0, 0), (0.001, 0), (0.25, 64), (0.5, 128), (0.998, 255), (1, 256)])
def test_the_beam_s_level_is_the_share_of_time_it_is_on(chip: Chip, level: float, duty: int) -> None:
    """The duty is out of 256, of a PWM at the chip's clock over 256: 62.5 kHz."""
    chip.send(f"BEAM:LEV {level}")
    assert chip.level("beam") == 0
    chip.send("BEAM:STAT ON")
    assert chip.level("beam") == duty
    chip.send("BEAM:STAT OFF")
    assert chip.level("beam") == 0
