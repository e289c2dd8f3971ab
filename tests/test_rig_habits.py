"""What a camera does that its user did not mean it to: right frames, or a line that names the cause."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from bssrdf.bench.capture import small_scene
from bssrdf.errors import DeviceError
from bssrdf.rig.camera_settings import unfit
from bssrdf.rig.capture import capture_session
from bssrdf.rig.sim.launch import SimulatedBench
from bssrdf.session.frame_files import read_frame_file
from bssrdf.session.frames_csv import read_frames

pytest.importorskip("gphoto2", reason="python-gphoto2 is not installed")

PLAN = """\
settle_s = 0.0
drift_check = false
[material]
name = "Skin1"
eta = 1.3
[exposures]
list_s = [TIMES]
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedBench]:
    started = SimulatedBench(tmp_path_factory.mktemp("bench"), replace(small_scene(), noise="fresh"))
    yield started
    started.stop()


@pytest.fixture(autouse=True)
def _clean(bench: SimulatedBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("HOME", str(tmp_path))
    yield
    bench.world.clear()


def captured(bench: SimulatedBench, folder: Path, habit: str, times: str = "0.128, 0.016") -> Path:
    plan, session = folder / "plan.toml", folder / "s"
    plan.write_text(PLAN.replace("TIMES", times), encoding="utf-8")
    bench.world.arm("camera", habit)
    capture_session(plan, bench.rig_file, session)
    return session


@pytest.mark.parametrize("habit", ["raw+jpeg", "jpeg+raw", "stale"])
def test_the_frame_kept_is_the_raw_one_of_its_own_shot(bench: SimulatedBench, tmp_path: Path, habit: str) -> None:
    session = captured(bench, tmp_path, habit)
    frames = read_frames(session)
    assert len(frames) == 8
    assert all(frame.file.endswith(".dng") for frame in frames)
    long, short = (read_frame_file(session / frame.file).data - 512.0 for frame in frames if frame.kind == "sample")
    faint = (short > 40) & (long < 12000)
    assert faint.sum() > 100
    # the older frame, which the camera brings with the first shot, has 0.7 of the light
    assert long[faint].sum() / short[faint].sum() == pytest.approx(0.128 / 0.016, rel=0.03)


def test_the_exposure_is_that_of_the_file_where_the_camera_rounds_its_labels(
    bench: SimulatedBench, tmp_path: Path
) -> None:
    frames = read_frames(captured(bench, tmp_path, "rounded labels", "0.0333, 0.0005, 0.0001"))
    times = sorted({frame.exposure_s for frame in frames})
    assert times == pytest.approx([1 / 8000, 1 / 2000, 1 / 30], rel=1e-6)
    assert len(frames) == 12


@pytest.mark.parametrize(
    ("habit", "message"),
    [
        ("jpeg", r"brought SIM_\d+\.JPG, no RAW; set the camera's format to RAW"),
        ("burst", r"brought OLD_\d+\.DNG, SIM_\d+\.DNG; no telling .* is a bracket or a burst set"),
        ("automatic iso", "it has ISO 400, but the camera is set to 100"),
        ("other iso", "it has ISO 200, but the camera is set to 100"),
        ("no focus", "did not release .* autofocus .* set lens and camera to manual focus"),
        ("automatic focus", r"focus mode is Automatic .*; set lens and camera to manual focus"),
        ("automatic exposure", r"exposure mode is P .*; turn its dial to M"),
    ],
)
def test_a_camera_that_is_set_wrongly_is_named_with_what_is_wrong(
    bench: SimulatedBench, tmp_path: Path, habit: str, message: str
) -> None:
    with pytest.raises(DeviceError, match=f"gphoto2 camera on ptpip.*{message}") as error:
        captured(bench, tmp_path, habit)
    assert "\n" not in str(error.value)
    assert not bench.world.status()["lit"]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"iso": "100", "imageformat": "RAW + Large Fine JPEG", "focusmode": "Manual", "autoexposuremode": "Manual"},
            "",
        ),
        ({"imagequality": "NEF+Fine", "focusmode": "MF (fixed)", "expprogram": "M", "isoauto": "Off"}, ""),
        ({"autoexposuremodedial": "Custom 1", "autoexposuremode": "Manual", "imageformat": "cRAW"}, ""),
        ({"expprogram": "Unknown value 8010"}, ""),
        ({"imageformat": "Large Fine JPEG"}, "image format is Large Fine JPEG"),
        ({"imagequality": "Extra Fine"}, "image format is Extra Fine"),
        ({"focusmode": "One Shot"}, "focus mode is One Shot"),
        ({"focusmode": "AF-S"}, "focus mode is AF-S"),
        ({"expprogram": "A"}, "exposure mode is A"),
        ({"autoexposuremode": "TV"}, "exposure mode is TV"),
        ({"isoauto": "On"}, "automatic ISO is On"),
        ({"longexpnr": "Auto"}, "long-exposure noise reduction is Auto"),
        ({"iso": "Auto"}, "ISO is Auto; set iso in"),
    ],
)
def test_settings_of_every_maker_are_judged(settings: dict[str, str], words: str) -> None:
    said = unfit(settings, iso_given=False)
    assert said.startswith(words)
    assert bool(said) == bool(words)
