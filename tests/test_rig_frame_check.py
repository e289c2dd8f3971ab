"""A frame counts only when it shows what it should."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from bssrdf.errors import InputError
from bssrdf.rig.frame_check import SeenFrame, check, drift
from bssrdf.rig.metering import metered
from bssrdf.rig.sim.raw_files import dng_bytes
from bssrdf.rig.sim.sensor import SimSensor, expose
from bssrdf.rig.steps import Step

SENSOR = SimSensor(height_px=80, width_px=120, hot_share=2e-3)
Y, X = np.mgrid[:80, :120]
SPOT = 3e5 * np.exp(-np.hypot(X - 60, Y - 40) / 4)
"""Photo-current [e⁻/s]."""


def frame(tmp_path: Path, exposure_s: float, light: float = 1.0, label_s: float | None = None, seed: int = 1) -> Path:
    dn = expose(SENSOR, light * SPOT, exposure_s, np.random.default_rng(seed))
    file = tmp_path / f"{exposure_s:g}_{light:g}_{seed}.dng"
    file.write_bytes(dng_bytes(dn, SENSOR, label_s or exposure_s))
    return file


def judged(file: Path, kind: str, exposure_s: float, before: SeenFrame | None = None) -> str:
    return check(file, Step("x", kind, exposure_s), before, None)[1]  # type: ignore[arg-type]


def seen(file: Path, exposure_s: float) -> SeenFrame:
    shown, _ = check(file, Step("x", "sample", exposure_s), None, None)
    assert shown is not None
    return shown


def test_good_frames_pass(tmp_path: Path) -> None:
    first = seen(frame(tmp_path, 1.0), 1.0)
    assert judged(frame(tmp_path, 1.0), "sample", 1.0) == ""
    assert judged(frame(tmp_path, 4.0, light=0.0), "sample_dark", 4.0) == ""
    for exposure_s in (0.5, 0.1, 0.01, 0.001):
        assert judged(frame(tmp_path, exposure_s), "sample", exposure_s, first) == ""


@pytest.mark.parametrize("leak", [1.0, 0.01])
def test_a_dark_with_light_in_it_is_refused(tmp_path: Path, leak: float) -> None:
    assert "not dark" in judged(frame(tmp_path, 1.0, light=leak), "sample_dark", 1.0)


def test_a_frame_without_light_is_refused(tmp_path: Path) -> None:
    assert "all dark" in judged(frame(tmp_path, 1.0, light=0.0), "sample", 1.0)
    first = seen(frame(tmp_path, 1.0), 1.0)
    assert "0.00 of what" in judged(frame(tmp_path, 0.1, light=0.0), "sample", 0.1, first)


def test_a_saturated_frame_is_refused(tmp_path: Path) -> None:
    assert judged(frame(tmp_path, 1.0, light=1e9), "sample", 1.0) == "it is all saturated"


@pytest.mark.parametrize("share", [0.7, 1.3])
def test_light_out_of_step_with_the_frame_before_is_refused(tmp_path: Path, share: float) -> None:
    first = seen(frame(tmp_path, 1.0), 1.0)
    assert "of what the frame of 1 s lets expect" in judged(frame(tmp_path, 0.1, light=share), "sample", 0.1, first)


def test_another_exposure_than_asked_for_is_refused_but_a_rounded_label_is_not(tmp_path: Path) -> None:
    assert judged(frame(tmp_path, 1.0, label_s=0.5), "sample", 1.0) == "its file says 0.5 s, not 1 s"
    assert judged(frame(tmp_path, 1.0, label_s=1.06), "sample", 1.0) == ""


@pytest.mark.parametrize("keep", [0, 100, 15000])
def test_a_truncated_file_is_refused(tmp_path: Path, keep: int) -> None:
    file = frame(tmp_path, 1.0)
    file.write_bytes(file.read_bytes()[:keep])
    assert judged(file, "sample", 1.0).startswith("it cannot be read")


def test_drift_is_the_change_of_the_light(tmp_path: Path) -> None:
    first, again = seen(frame(tmp_path, 1.0), 1.0), seen(frame(tmp_path, 1.0, light=1.01, seed=2), 1.0)
    assert drift(first, again) == pytest.approx(0.01, abs=0.002)


def test_metering_finds_the_longest_unsaturated_time_in_few_shots(tmp_path: Path) -> None:
    shots: list[float] = []

    def shot(exposure_s: float) -> SeenFrame:
        shots.append(exposure_s)
        return seen(frame(tmp_path, exposure_s), exposure_s)

    offered = tuple(0.001 * 2.0**k for k in range(13))
    times = metered(shot, offered)
    assert not shot(times[-1]).clipped.any()
    assert not shot(times[-2]).clipped.any()
    assert shot(times[-3]).clipped.any()
    assert len(shots) < 13
    with pytest.raises(InputError, match="give list_s"):
        metered(shot, ())


CONTAINERS = {
    "12 bits": lambda dn: dn.astype(np.uint16) // 4,
    "12 bits, high aligned": lambda dn: dn.astype(np.uint16) // 4 * 16,
    "8 bits": lambda dn: (dn // 64).astype(np.uint8),
    "float 0 to 1": lambda dn: (dn / 16383).astype(np.float32),
    "float in any unit": lambda dn: (3.7 * dn).astype(np.float32),
    "rgb": lambda dn: np.repeat(dn[:, :, None].astype(np.uint16) // 4, 3, axis=2),
}


@pytest.mark.parametrize("container", CONTAINERS)
def test_saturation_is_seen_whatever_the_container(tmp_path: Path, container: str) -> None:
    """A bracket whose long frames clip passes, and light out of step is still refused."""

    def made(exposure_s: float, light: float = 1.0) -> Path:
        dn = expose(SENSOR, light * SPOT, exposure_s, np.random.default_rng(3))
        file = tmp_path / f"{exposure_s:g}_{light:g}.tif"
        tifffile.imwrite(file, CONTAINERS[container](dn), photometric="rgb" if container == "rgb" else "minisblack")
        return file

    before, wrong = check(made(1.0), Step("x", "sample", 1.0), None, None)
    assert before is not None
    assert wrong == ""
    assert before.clipped.any()
    for exposure_s in (0.5, 0.25, 0.1):
        assert judged(made(exposure_s), "sample", exposure_s, before) == ""
    assert not seen(made(0.1), 0.1).clipped.any()
    assert "of what the frame of 1 s" in judged(made(0.25, light=0.6), "sample", 0.25, before)
    assert "not dark" in judged(made(1.0), "sample_dark", 1.0)
    assert judged(made(1.0, light=0.0), "sample_dark", 1.0) == ""
    assert "all dark" in judged(made(1.0, light=0.0), "sample", 1.0)


def test_a_frame_that_is_saturated_over_most_of_it_is_not_taken_for_a_dark_one(tmp_path: Path) -> None:
    dn = expose(SENSOR, 1e4 * SPOT, 1.0, np.random.default_rng(3)) // 4
    assert np.median(dn) == 4095
    tifffile.imwrite(tmp_path / "bright.tif", dn.astype(np.uint16), photometric="minisblack")
    shown = seen(tmp_path / "bright.tif", 1.0)
    assert shown.clipped.mean() > 0.5
