"""A watched folder: whatever a camera's program does while it writes, the frame taken is the whole one."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from bssrdf.errors import DeviceError
from bssrdf.rig.folder_camera import FolderCamera
from bssrdf.rig.ports import BadShot, BenchClock
from bssrdf.rig.sim.raw_files import dng_bytes
from bssrdf.rig.sim.sensor import SimSensor, expose

SENSOR = SimSensor(height_px=80, width_px=120)
FRAME = dng_bytes(expose(SENSOR, 1e3, 0.1, np.random.default_rng(0)), SENSOR, 0.1)

Writer = Callable[[Path], None]


def at_once(folder: Path) -> None:
    (folder / "a.DNG").write_bytes(FRAME)


def with_pauses(folder: Path) -> None:
    with (folder / "a.dng").open("wb") as file:
        for start in range(0, len(FRAME), len(FRAME) // 3):
            file.write(FRAME[start : start + len(FRAME) // 3])
            file.flush()
            time.sleep(0.3)


def with_a_pause_longer_than_it_is_quiet(folder: Path) -> None:
    with (folder / "a.dng").open("wb") as file:
        file.write(FRAME[: len(FRAME) // 2])
        file.flush()
        time.sleep(1.0)
        file.write(FRAME[len(FRAME) // 2 :])


def into_reserved_space(folder: Path) -> None:
    with (folder / "a.dng").open("wb") as file:
        file.truncate(len(FRAME))
        file.write(FRAME[: len(FRAME) // 2])
        file.flush()
        time.sleep(1.0)
        file.write(FRAME[len(FRAME) // 2 :])


def beside_a_sidecar(folder: Path) -> None:
    (folder / "._a.dng").write_bytes(b"\0\5\26\7" + bytes(4092))
    time.sleep(0.7)
    (folder / "a.dng").write_bytes(FRAME)


def under_another_name_first(folder: Path) -> None:
    (folder / "part.dng").write_bytes(FRAME[:1000])
    time.sleep(0.3)
    (folder / "part.dng").write_bytes(FRAME)
    (folder / "part.dng").rename(folder / "a.dng")


def beside_a_developed_image(folder: Path) -> None:
    tifffile.imwrite(folder / "a.tif", np.ones((80, 120), np.uint16))
    (folder / "a.dng").write_bytes(FRAME)


WRITERS = [at_once, with_pauses, with_a_pause_longer_than_it_is_quiet, into_reserved_space]
WRITERS += [beside_a_sidecar, under_another_name_first, beside_a_developed_image]


def taken(folder: Path, writer: Writer, overhead_s: float = 6.0) -> Path:
    """What the camera takes while another thread writes."""
    camera = FolderCamera(BenchClock(), str(folder), overhead_s=overhead_s)
    camera.connect()
    out = folder.with_name(f"{folder.name}_out")
    out.mkdir()
    thread = threading.Timer(0.1, writer, [folder])
    thread.start()
    try:
        return camera.take(0.01, out / "1.part", lambda: None)
    finally:
        thread.join()


@pytest.mark.parametrize("writer", WRITERS)
def test_the_frame_taken_is_the_whole_one(tmp_path: Path, writer: Writer) -> None:
    (tmp_path / "old.dng").write_bytes(b"old")
    file = taken(tmp_path, writer)
    assert file.name == "1.part.dng"
    assert file.read_bytes() == FRAME


def test_a_dark_frame_that_is_clipped_to_zero_is_taken(tmp_path: Path) -> None:
    data = np.zeros((80, 120), np.uint16)
    file = taken(tmp_path, lambda folder: tifffile.imwrite(folder / "dark.tif", data))
    assert np.array_equal(tifffile.imread(file), data)


def test_a_file_that_never_gets_whole_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"no whole frame, but a\.dng \(.*a\.dng.* within 1\.01 s"):
        taken(tmp_path, lambda folder: (folder / "a.dng").write_bytes(FRAME[:9000]) and None, overhead_s=1.0)


@pytest.mark.parametrize("end", [12_000, len(FRAME)])
def test_reserved_space_that_is_never_filled_is_named(tmp_path: Path, end: int) -> None:
    content = FRAME[:9000].ljust(end, b"\0") + FRAME[end:]
    with pytest.raises(DeviceError, match=r"no whole frame, but a\.dng \(.*a\.dng: .*empty"):
        taken(tmp_path, lambda folder: (folder / "a.dng").write_bytes(content) and None, overhead_s=1.0)


def test_two_frames_of_one_shot_are_not_chosen_from(tmp_path: Path) -> None:
    def twice(folder: Path) -> None:
        for name in ("a.dng", "b.dng"):
            (folder / name).write_bytes(FRAME)

    with pytest.raises(BadShot, match=r"[ab]\.dng, [ab]\.dng came at once"):
        taken(tmp_path, twice)


def test_a_folder_that_stays_empty_is_reported_in_time(tmp_path: Path) -> None:
    camera = FolderCamera(BenchClock(), str(tmp_path), overhead_s=0.2)
    with pytest.raises(DeviceError, match=r"no new frame .* within 0\.21 s"):
        camera.take(0.01, tmp_path / "1.part", lambda: None)
    with pytest.raises(DeviceError, match="no such folder"):
        FolderCamera(BenchClock(), str(tmp_path / "none")).connect()
