"""What must stay constant over a session is refused by name where it did not; what can be allowed for is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError
from bssrdf.measure.bracket import bracket_of, layout_of
from bssrdf.rig.sim.raw_files import dng_bytes
from bssrdf.rig.sim.sensor import SimSensor, expose
from bssrdf.session.constancy import check_constant, differences, with_cards
from bssrdf.session.frames_csv import read_frames, write_frames
from bssrdf.session.ingest import ingest_folder
from bssrdf.session.records import Camera, Card, Frame
from bssrdf.session.verify import verify_session

KINDS = ("sample", "reference", "sample_dark", "reference_dark", "dark", "flat", "flat_dark", "target", "chart")
CARD = Card(
    camera="Model 1",
    lens="50mm f/1.8",
    iso=100.0,
    gain=10.0,
    f_number=5.6,
    focal_mm=50.0,
    temperature_c=20.0,
    layout="RGGB",
    bits=14,
    black=(512.0,),
    white=(16383.0,),
    width_px=60,
    height_px=40,
    orientation=1,
)


def session(**changed: Any) -> list[Frame]:
    """A frame of each kind, the second reference with another card."""
    frames = [Frame(f"{kind}.dng", kind, 0.25, card=CARD) for kind in KINDS]
    return [*frames, Frame("odd.dng", "reference", 0.25, card=replace(CARD, **changed))]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"iso": 200.0}, "ISO 200, not 100 as sample.dng"),
        ({"gain": 16.0}, "gain 16, not 10 as sample.dng"),
        ({"f_number": 8.0}, "f-number 8, not 5.6 as sample.dng"),
        ({"lens": "85mm"}, "lens 85mm, not 50mm f/1.8 as sample.dng"),
        ({"camera": "Model 2"}, "camera Model 2, not Model 1 as sample.dng"),
        ({"focal_mm": 51.0}, "focal length 51, not 50 as sample.dng"),
        ({"width_px": 62}, "size 62 x 40, not 60 x 40 as sample.dng"),
        ({"bits": 8, "white": None}, "bits 8, not 14 as sample.dng"),
    ],
)
def test_a_change_of_light_is_refused_with_both_frames_and_values(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=f"odd.dng: has {words}"):
        check_constant(session(**changed), Path("s"))


@pytest.mark.parametrize(
    "changed",
    [
        *({name: None} for name in vars(CARD)),
        {"temperature_c": 25.0},
        {"orientation": 6},
        {"focal_mm": 50.4},
        {"black": (600.0,)},
        {"bits": 12, "white": (4095.0,)},
        {"width_px": None, "height_px": None},
    ],
)
def test_what_is_missing_or_can_be_allowed_for_is_not_refused(changed: dict[str, Any]) -> None:
    assert list(differences(session(**changed))) == []
    assert list(differences([replace(frame, card=Card()) for frame in session()])) == []


@pytest.mark.parametrize(
    ("kind", "refused", "allowed"),
    [
        ("flat", {"f_number": 8.0, "lens": "85mm", "layout": "BGGR"}, {"iso": 200.0, "focal_mm": 60.0}),
        ("target", {"lens": "85mm", "focal_mm": 60.0, "height_px": 50}, {"iso": 200.0, "f_number": 8.0, "bits": 8}),
        ("chart", {}, {"iso": 200.0, "lens": "85mm", "width_px": 50}),
        ("dark", {"iso": 200.0, "height_px": 50}, {"temperature_c": 30.0}),
    ],
)
def test_flats_and_targets_are_held_to_less(kind: Any, refused: dict[str, Any], allowed: dict[str, Any]) -> None:
    frames = [Frame("s.dng", "sample", 1.0, card=CARD)]
    for name, value in refused.items():
        (found,) = differences([*frames, Frame("x.dng", kind, 1.0, card=replace(CARD, **{name: value}))])
        assert "x.dng: has" in str(found)
    for name, value in allowed.items():
        assert not list(differences([*frames, Frame("x.dng", kind, 1.0, card=replace(CARD, **{name: value}))]))


def test_layouts_of_sample_and_reference_matter_only_to_a_flat() -> None:
    two = [
        Frame("s.dng", "sample", 1.0, card=CARD),
        Frame("r.dng", "reference", 1.0, card=replace(CARD, layout="BGGR")),
    ]
    assert not list(differences(two))
    assert [each.what for each in differences([*two, Frame("f.dng", "flat", 1.0, card=CARD)])] == ["layout"]


SENSOR = SimSensor(height_px=40, width_px=60, hot_share=0)
TABLES = '[camera]\n[material]\nname = "wax"\neta = 1.4\n[geometry]\nmm_per_px = 0.1\n'
TABLES += '[reference]\nname = "tile"\nreflectance = [0.9, 0.9, 0.9]\n'


def film(folder: Path, iso: dict[str, int]) -> None:
    rng = np.random.default_rng(0)
    for kind in ("sample", "reference", "dark"):
        (folder / kind).mkdir(parents=True)
        for exposure_s in (0.01, 0.1):
            dn = expose(SENSOR, 0.0 if kind == "dark" else 3000.0, exposure_s, rng)
            (folder / kind / f"{exposure_s}.dng").write_bytes(dng_bytes(dn, SENSOR, exposure_s, iso.get(kind, 100)))


@pytest.mark.parametrize("kind", ["sample", "reference", "dark"])
def test_iso_is_held_in_ingest_verify_measure_and_calibrate(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    film(tmp_path / "in", {kind: 200})
    with pytest.raises(InputError, match="has ISO"):
        ingest_folder(tmp_path / "in", tmp_path / "s")
    assert not (tmp_path / "s").exists()
    rows = [f"{file.relative_to(tmp_path)},{file.parent.name},{file.stem}" for file in sorted(tmp_path.rglob("*.dng"))]
    (tmp_path / "frames.csv").write_text("\n".join(["file,kind,exposure_s", *rows]) + "\n")
    (tmp_path / "session.toml").write_text(TABLES)
    faults = [fault for fault in verify_session(tmp_path).faults if "has ISO" in fault]
    assert len(faults) == (2 if kind != "dark" else 4)
    out = str(tmp_path / "calibration.toml")
    for command in (["measure", str(tmp_path)], ["calibrate", "camera", str(tmp_path), "--out", out]):
        assert run(cli, [*command, "--quiet"]) == 3
        assert "has ISO" in capsys.readouterr().err


def test_a_line_of_frames_csv_wins_over_the_file(tmp_path: Path) -> None:
    film(tmp_path / "in", {"reference": 200})
    frames = [
        Frame(file.relative_to(tmp_path).as_posix(), file.parent.name, float(file.stem), card=Card(iso=100.0))  # type: ignore[arg-type]
        for file in sorted(tmp_path.rglob("*.dng"))
    ]
    write_frames(tmp_path, frames)
    cards = [frame.card for frame in with_cards(tmp_path, read_frames(tmp_path))]
    assert {card.iso for card in cards} == {100.0}
    assert {card.width_px for card in cards} == {60}


def raw_session(folder: Path, frames: dict[str, tuple[NDArray[np.uint16], SimSensor]], **tags: Any) -> list[Frame]:
    """Frames of 0.25 s by name, `sample` and `dark`, on disk and listed with their cards."""
    for name, (dn, sensor) in frames.items():
        (folder / f"{name}.dng").write_bytes(dng_bytes(dn, sensor, 0.25))
    return with_cards(folder, [Frame(f"{name}.dng", name.split("-")[0], 0.25) for name in frames])  # type: ignore[arg-type]


LIGHT = np.random.default_rng(1).integers(0, 3000, SENSOR.shape)


def signal_of(folder: Path, frames: list[Frame]) -> NDArray[Any]:
    """What is left of the sample above its dark [DN]."""
    (shot,) = bracket_of("sample", folder, frames).shots([0.25])
    sample = shot.load()
    return np.asarray(sample.raw, float) - sample.dark


def test_black_level_that_moved_between_dark_and_frame_is_allowed_for(tmp_path: Path) -> None:
    moved = replace(SENSOR, black_dn=600)
    frames = {
        "sample": ((LIGHT + 600).astype(np.uint16), moved),
        "dark": (np.full(SENSOR.shape, 512, np.uint16), SENSOR),
    }
    np.testing.assert_array_equal(signal_of(tmp_path, raw_session(tmp_path, frames)), LIGHT)


def test_fewer_bits_are_brought_to_the_most(tmp_path: Path) -> None:
    coarse = replace(SENSOR, bits=12, black_dn=128)
    frames = {
        "sample": ((LIGHT // 4 + 128).astype(np.uint16), coarse),
        "dark": (np.full(SENSOR.shape, 128, np.uint16), coarse),
        "reference": ((LIGHT + 512).astype(np.uint16), SENSOR),
        "reference_dark": (np.full(SENSOR.shape, 512, np.uint16), SENSOR),
    }
    listed = raw_session(tmp_path, frames)
    assert [frame.card.bits for frame in listed] == [12, 12, 14, 14]
    check_constant(listed, tmp_path)
    np.testing.assert_array_equal(signal_of(tmp_path, listed), LIGHT // 4 * 4)


def test_each_bracket_is_read_by_its_own_layout_and_one_bracket_has_one(tmp_path: Path) -> None:
    flipped = replace(SENSOR, layout="BGGR")
    dn = (LIGHT + 512).astype(np.uint16)
    frames = {"sample": (dn, SENSOR), "dark": (dn, SENSOR), "reference": (dn, flipped)}
    listed = raw_session(tmp_path, frames)
    assert [layout_of(bracket_of(kind, tmp_path, listed), Camera()) for kind in ("sample", "reference")] == [
        "RGGB",
        "BGGR",
    ]
    assert layout_of(bracket_of("reference", tmp_path, listed), Camera(layout="GRBG")) == "GRBG"
    listed = [*listed, *raw_session(tmp_path, {"sample-2": (dn, flipped)})]
    with pytest.raises(InputError, match=r"sample\.dng: has the layout RGGB, not BGGR as sample-2\.dng"):
        layout_of(bracket_of("sample", tmp_path, listed), Camera())


def test_masked_pixels_tell_the_black_of_each_frame(tmp_path: Path) -> None:
    """Black drifts by 7 DN between the frame and its dark, and only the pixels under the mask show it."""
    whole = np.zeros((48, 64), np.uint16)
    for name, black in (("sample", 519), ("dark", 512)):
        whole[:] = black
        if name == "sample":
            whole[:, 16:] += LIGHT[0, :48].astype(np.uint16)
        area = [(50829, "I", 4, (0, 16, 48, 64), True), (50830, "I", 4, (0, 0, 48, 16), True)]
        tags = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes((0, 1, 1, 2)), True)]
        tags += [(50706, "B", 4, bytes([1, 4, 0, 0]), True), (50714, "H", 1, 512, True)]
        tifffile.imwrite(tmp_path / f"{name}.dng", whole, photometric=32803, extratags=[*tags, *area], metadata=None)
    listed = with_cards(tmp_path, [Frame("sample.dng", "sample", 0.25), Frame("dark.dng", "dark", 0.25)])
    assert listed[0].card.width_px == 48
    np.testing.assert_array_equal(signal_of(tmp_path, listed), np.tile(LIGHT[0, :48], (48, 1)))
