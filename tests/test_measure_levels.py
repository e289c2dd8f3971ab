"""R to 0.2 % by frames of any bits in any container, whose colours clip apart or not at all.

So much light, so wide a beam and so many repeats that noise forbids nothing: around a spot of a few pixels light lies
below a step of 8 bits, and no reading of the frames can find it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from bssrdf.bench.frame_faults import scene
from bssrdf.measure.session import measure_session
from bssrdf.rig.sim.sensor import SimSensor, expose
from bssrdf.session.frames_csv import write_frames
from bssrdf.session.records import Beam, Camera, Frame, Geometry, Material, Reference, Session, Slice

BENCH = replace(scene(), spot_radius_mm=3.0)
R, TILE = (BENCH.radiance_factors(sample)[0] for sample in (BENCH.sample, BENCH.tile))
REPEATS, REPEATS_OF_FAINT_LIGHT = 8, 40
"""The latter by 8 bits where no exposure clips: the light around the spot then lies below a step."""
FULL_WELL_E = 1.6e6
NOISE_STEPS = 0.6
"""Read noise: enough to tell what lies between two steps."""
COMBINATIONS = [*product((8, 10, 12, 14, 16), ("low", "high", "float"), (0.005, 0.25), (True, False))]


def sensor_of(bits: int) -> SimSensor:
    gain = FULL_WELL_E / 2**bits
    height, width = BENCH.sensor.shape
    return SimSensor(height, width, "mono", bits, max(4, 2**bits // 32), gain, NOISE_STEPS * gain)


def container(bits: int, align: str) -> Callable[[NDArray[np.int64]], NDArray[Any]]:
    return {
        "low": lambda dn: dn.astype(np.uint8 if bits == 8 else np.uint16),
        "high": lambda dn: (dn << (16 - bits)).astype(np.uint16),
        "float": lambda dn: (dn / (2**bits - 1)).astype(np.float32),
    }[align]


def write(path: Path, bits: int, align: str, apart: float, is_clipped: bool) -> Session:
    """Frames of three colours of one light, the last of which clip `apart` of the range below the first."""
    rng, sensor, currents = np.random.default_rng(bits), sensor_of(bits), BENCH.photo_currents()
    stored, span = container(bits, align), sensor.white_dn - sensor.black_dn
    limits = sensor.black_dn + (span * (1 - apart * np.array([0, 0.5, 1]))).astype(int)
    full_s = span * sensor.gain_e_per_dn / max(light.max() for light in currents.values())
    steps = 4.0 ** np.arange(7) / 2 if is_clipped else 0.93 * (1 - apart) / 4.0 ** np.arange(3)
    repeats = REPEATS_OF_FAINT_LIGHT if bits == 8 and not is_clipped else REPEATS
    frames = []
    (path / "frames").mkdir(parents=True)
    for kind, step, repeat in product(("sample", "reference", "dark"), steps, range(repeats)):
        exposure_s, light = float(full_s * step), currents.get(kind, np.zeros(sensor.shape))
        shown = [np.minimum(expose(sensor, light, exposure_s, rng), limit) for limit in limits]
        file = f"frames/{kind}_{exposure_s}_{repeat}.tif"
        tifffile.imwrite(path / file, stored(np.stack(shown, -1).astype(np.int64)), photometric="rgb")
        frames.append(Frame(file, kind, exposure_s))
    write_frames(path, frames)
    return Session(
        path,
        Camera("rgb"),
        Material("marble", 1.5, 0.0),
        Geometry(BENCH.mm_per_px, mm_per_px_rel_sd=0.001, view_angle_deg=BENCH.view_angle_deg, view_angle_sd_deg=0.1),
        Beam(spot_radius_mm=BENCH.spot_radius_mm),
        Reference("tile", (TILE,) * 3, (1e-6,) * 3, coplanar=True),
    )


def measured_within(path: Path, combination: tuple[int, str, float, bool]) -> Slice:
    found = measure_session(write(path, *combination)).slice
    assert found is not None
    for channel, total in found.total_r.items():
        assert total == pytest.approx(R, rel=0.002)
        assert abs(total - R) < 3 * found.total_r_sd[channel] < 0.03 * R
    return found


@pytest.mark.parametrize("combination", [(8, "high", 0.25, True), (10, "float", 0.005, False)], ids=str)
def test_r_is_right_by_any_levels(tmp_path: Path, combination: tuple[int, str, float, bool]) -> None:
    found = measured_within(tmp_path / "s", combination)
    assert ("white_unseen" in found.flags) != combination[-1]


@pytest.mark.slow
@pytest.mark.parametrize("combination", COMBINATIONS, ids=str)
def test_r_is_right_by_all_levels(tmp_path: Path, combination: tuple[int, str, float, bool]) -> None:
    """Where nothing clips, the flat top of this spot passes for a pile-up at 10 bits, three times in thirty."""
    measured_within(tmp_path / "s", combination)
