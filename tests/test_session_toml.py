"""session.toml and calibration.toml: what is written is read back, and what a person writes wins."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bssrdf.errors import InputError, UsageError
from bssrdf.session.frames_csv import COLUMNS
from bssrdf.session.keys import keys_of
from bssrdf.session.records import Beam, Camera, Distortion, Geometry, Material, Reference, Session
from bssrdf.session.session_toml import TABLES, read_session, write_calibration, write_session, write_template
from bssrdf.session.text_file import toml_table

FULL = Session(
    path=Path(),
    camera=Camera("GBRG", 512.5, 65535.0, 0.37, 3.1),
    material=Material('a "hard" name\\\n\x7fσ', 1.5, -0.3, 40.0, 0.5, 100.0, "air", 0.9, 0.02, "glass", "rough"),
    geometry=Geometry(
        homography=((0.05, 1e-7, 3.0), (0.0, 0.07, -2.0), (1e-5, 0.0, 1.0)), mm_per_px_rel_sd=0.002, view_axis="x"
    ),
    beam=Beam("laser", True, 12.5, 0.15, ("633nm",)),
    reference=Reference("Spectralon", (0.99, 0.98), (0.005, 0.004)),
    distortion=Distortion(((1000.0, 0.0, 320.0), (0.0, 1000.0, 240.0), (0.0, 0.0, 1.0)), (-0.1, 0.01, 0.0, 0.0, 1e-9)),
)
IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize("session", [FULL, Session(Path(), Camera())], ids=["every key", "camera only"])
def test_written_session_is_read_back(tmp_path: Path, session: Session) -> None:
    write_session(tmp_path, session)
    back = read_session(tmp_path)
    assert {f.name: getattr(back, f.name) for f in fields(back) if f.name != "path"} == {
        f.name: getattr(session, f.name) for f in fields(session) if f.name != "path"
    }
    assert [file.name for file in tmp_path.iterdir()] == ["session.toml"]


def test_checks_cover_every_field() -> None:
    for record in TABLES.values():
        assert list(keys_of(record)) == [field.name for field in fields(record)]


def test_own_keys_win_over_the_calibration(tmp_path: Path) -> None:
    write_calibration(
        tmp_path / "calibration.toml",
        {
            "camera": {"black": 10.0, "gain_e_per_dn": 2.0},
            "geometry": {"homography": IDENTITY, "mm_per_px_rel_sd": 0.001},
            "distortion": {"camera_matrix": IDENTITY, "coefficients": [0.1]},
        },
    )
    (tmp_path / "session.toml").write_text(
        'calibration = "calibration.toml"\n[camera]\nblack = 20\n[geometry]\nmm_per_px = 0.05\n'
    )
    session = read_session(tmp_path)
    assert session.camera == Camera(black=20.0, gain_e_per_dn=2.0)
    assert session.geometry == Geometry(mm_per_px=0.05, mm_per_px_rel_sd=0.001)
    assert session.distortion is not None
    assert session.calibration == "calibration.toml"


def test_calibration_that_could_not_be_read_back_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"calibration.toml: \[camera\] gain_e_per_dn = nan"):
        write_calibration(tmp_path / "calibration.toml", {"camera": {"gain_e_per_dn": float("nan")}})
    assert list(tmp_path.iterdir()) == []


def test_template_is_a_session_and_every_commented_key_too(tmp_path: Path) -> None:
    write_template(tmp_path / "new")
    session = read_session(tmp_path / "new")
    assert session.material is not None
    assert session.reference is not None
    assert (tmp_path / "new" / "frames").is_dir()
    assert (tmp_path / "new" / "frames.csv").read_text().strip().split(",") == list(COLUMNS[:3])

    document = re.sub(r"(?m)^# (?=\w+ = )", "", (tmp_path / "new" / "session.toml").read_text())
    for name, record in TABLES.items():
        if name not in ("distortion", "colour"):  # written by `bssrdf calibrate` alone
            for key, value in (table := tomllib.loads(document)[name]).items():
                keys_of(record)[key].check(value)
            assert list(table) == list(keys_of(record))


def test_every_missing_key_is_named_at_once_with_a_line_that_gives_it(tmp_path: Path) -> None:
    (tmp_path / "session.toml").write_text('[camera]\n[material]\nname = "wax"\n')
    with pytest.raises(InputError) as caught:
        read_session(tmp_path, complete=True)
    assert str(caught.value).endswith(
        "session.toml: lacks [material] eta, [geometry] with mm_per_px, [reference] with name and reflectance; "
        "add lines such as `[material] eta = 1.3`, `[geometry] mm_per_px = 0.05`, "
        '`[reference] name = "Spectralon" reflectance = [0.99, 0.99, 0.99]`'
    )
    (tmp_path / "session.toml").write_text("[camera]\n[geometry]\nhomography = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n")
    with pytest.raises(InputError, match=r"lacks \[material\] with name and eta, \[reference\]"):
        read_session(tmp_path, complete=True)
    assert read_session(tmp_path).material is None


def test_template_keeps_a_session_that_is_there(tmp_path: Path) -> None:
    write_template(tmp_path)
    (tmp_path / "session.toml").write_text("[camera]\n")
    with pytest.raises(UsageError, match="--force"):
        write_template(tmp_path)
    assert (tmp_path / "session.toml").read_text() == "[camera]\n"
    write_template(tmp_path, force=True)
    assert read_session(tmp_path).material is not None


TEXTS = st.text(st.characters(exclude_categories=["Cs"]))
VALUES = st.recursive(
    st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=50, deadline=None)
@given(st.dictionaries(TEXTS, VALUES, max_size=4))
def test_toml_text_is_read_back(values: dict[str, object]) -> None:
    assert tomllib.loads(toml_table(values)) == values


def test_force_keeps_the_frames_that_are_there(tmp_path: Path) -> None:
    write_template(tmp_path)
    (tmp_path / "frames.csv").write_text("file,kind,exposure_s\nframes/a.tif,sample,1\n")
    write_template(tmp_path, force=True)
    assert "frames/a.tif" in (tmp_path / "frames.csv").read_text()
