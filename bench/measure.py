"""Processor seconds and peak memory of `measure` on large RAW frames: `python -m bssrdf.bench.measure`.

Marble and its tile on the simulated bench, 13 exposures of sample, reference and their darks; the picture is drawn
larger, with the noise of as many pixels. Frames are plain DNG.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from bssrdf.bench.sabotage import MARBLE, currents, toml_of
from bssrdf.rig import BRACKET_S, SimSensor, dng_bytes, expose
from bssrdf.session import write_frames
from bssrdf.session.records import Frame, FrameKind

SMALL = (400, 600)
KINDS: tuple[FrameKind, ...] = ("sample", "reference", "sample_dark", "reference_dark")

_AND_PEAK = """
import re, sys
from pathlib import Path
from bssrdf.cli import main
try:
    main(sys.argv[1:])
finally:
    print(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1])
"""
"""A command, and then its own peak memory [kB] as Linux has it: a child's usage would hold its parent's."""


class Cost(NamedTuple):
    """Of one command."""

    cpu_s: float
    wall_s: float
    peak_gb: float


def write_large(path: Path, times: int) -> int:
    """A session of frames of 400 × 600 pixels drawn `times` larger; returns the number of frames."""
    bench = replace(MARBLE, shape=SMALL)
    light, reflectance = currents(bench)
    sensor = SimSensor(height_px=times * SMALL[0], width_px=times * SMALL[1])
    rng = np.random.default_rng(0)
    (path / "frames").mkdir(parents=True)
    frames = []
    for kind in KINDS:
        current = _enlarged(light[kind], times) if kind in light else 0.0
        for number, exposure_s in enumerate(BRACKET_S):
            file = f"frames/{kind}_{number:02d}.dng"
            (path / file).write_bytes(dng_bytes(expose(sensor, current, exposure_s, rng), sensor, exposure_s))
            frames.append(Frame(file, kind, exposure_s))
    write_frames(path, frames)
    (path / "session.toml").write_text(
        toml_of(replace(bench, mm_per_px=bench.mm_per_px / times), reflectance), encoding="utf-8"
    )
    return len(frames)


def _enlarged(mosaic: np.ndarray, times: int) -> np.ndarray:
    """A mosaic drawn larger, each colour by itself, smooth in its logarithm."""
    out = np.empty((times * mosaic.shape[0], times * mosaic.shape[1]), np.float32)
    for row in (0, 1):
        for column in (0, 1):
            plane = np.log(np.maximum(mosaic[row::2, column::2], 1e-12)).astype(np.float32)
            out[row::2, column::2] = np.exp(cv2.resize(plane, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC))
    return out


def cost_of(*arguments: object, **environment: str) -> Cost:
    """What a command of the project costs, in a process of its own, where these variables are set."""
    import resource  # of POSIX alone

    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", _AND_PEAK, *map(str, arguments)],
        check=True,
        capture_output=True,
        text=True,
        env=os.environ | environment,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Cost(cpu, time.monotonic() - start, float(done.stdout.split()[-1]) / 1e6)


def main() -> None:
    """Make the session, measure it twice, the second time from the merged images, and print what each costs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=10, help="10 for 24 megapixels, 1 for the demo's 0.24")
    times = parser.parse_args().times
    with tempfile.TemporaryDirectory(prefix="bssrdf-measure-") as folder:
        session = Path(folder) / "session"
        frames = write_large(session, times)
        print(f"{frames} frames of {SMALL[0] * SMALL[1] * times**2 / 1e6:g} Mpx")
        for options in ((), ("--from-hdr",)):
            cost = cost_of("measure", session, *options, "--quiet")
            words = " ".join(("measure", *options))
            print(f"{words}: {cost.cpu_s:.1f} CPU s, {cost.wall_s:.1f} s, peak {cost.peak_gb:.2f} GB", flush=True)


if __name__ == "__main__":
    main()
