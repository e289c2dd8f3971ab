"""Declared keys: each changes a result or says why it does not, and one line is enough for another."""

from __future__ import annotations

import json
from dataclasses import make_dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError
from bssrdf.fit import FitOptions, fit_joint, fit_slice
from bssrdf.session.keys import ANGLE, Key, checked_keys, keys_of
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.session.slice_csv import read_slice, write_slice

LIGHT = Path(__file__).parent / "fixtures" / "marble_green_45deg.csv"
OPTIONS, DIPOLE = FitOptions(model="mc", tables="shipped"), FitOptions(model="dipole")


def camera_slice(**keys: Any) -> Slice:
    """Marble as a camera at 45° sees it, by a walk that scores towards the camera."""
    rings = np.loadtxt(LIGHT, delimiter=",", skiprows=4)
    r_lo, r_hi, light, se = rings[(rings[:, 0] > 0.3) & (rings[:, 1] < 15)].T
    area = np.pi * (r_hi**2 - r_lo**2)
    part = ChannelSlice(np.sqrt((r_lo**2 + r_hi**2) / 2), light / area, np.hypot(se, 0.005 * light) / area, r_lo, r_hi)
    known = {"total_r": {"G": 0.79}, "total_r_sd": {"G": 0.02}, "g": 0.0, "view_angle_sd_deg": 0.5, "azimuth": "mean"}
    return Slice({"G": part}, 1.5, "incident", "fresnel", **{**known, **keys})


OTHER: dict[str, dict[str, Any]] = {
    "eta": {"eta": 1.45},
    "flux": {"flux": "entering"},
    "exit": {"exit": "lambertian"},
    "view_angle_deg": {"view_angle_deg": 30.0},
    "view_angle_sd_deg": {"view_angle_sd_deg": 2.0},
    "azimuth": {"azimuth": "perpendicular"},
    "band_mm": {"azimuth": "perpendicular", "band_mm": 2.0},
    "incidence_deg": {"incidence_deg": 10.0},
    "total_r": {"total_r": {"G": 0.78}},
    "total_r_sd": {"total_r_sd": {"G": 0.002}},
    "lost_fraction": {"lost_fraction": {"G": 0.3}},
    "g": {"g": 0.5},
    "eta_sd": {"eta_sd": 0.02},
    "g_sd": {"g_sd": 0.1},
    "spot_radius_mm": {"spot_radius_mm": 0.5},
    "spot_radius_sd_mm": {"spot_radius_mm": 0.5, "spot_radius_sd_mm": 0.2},
    "scale_rel_sd": {"scale_rel_sd": 0.02},
    "mm_rel_sd": {"mm_rel_sd": 0.02},
    "shared_errors": {"shared_errors": "one tile"},
    "thickness_mm": {"thickness_mm": 30.0, "backing": 0.5},
    "thickness_sd_mm": {"thickness_mm": 30.0, "backing": 0.5, "thickness_sd_mm": 1.0},
    "width_mm": {"width_mm": 20.0},
    "wall": {"width_mm": 40.0, "wall": "air"},
    "backing": {"thickness_mm": 30.0, "backing": "air"},
    "backing_sd": {"thickness_mm": 30.0, "backing": 0.5, "backing_sd": 0.2},
    "cover": {"cover": "glass"},
}
"""For each key that counts, a value that it does not have in `camera_slice`, with what it needs beside it."""


def test_every_key_of_a_slice_changes_the_fit_or_says_why_not() -> None:
    informational = {name: key.key.informational for name, key in keys_of(Slice).items() if key.key.informational}
    print("informational:", *(f"{name}: {reason}" for name, reason in informational.items()), sep="\n  ")
    assert informational.keys() | OTHER.keys() == keys_of(Slice).keys()
    assert not informational.keys() & OTHER.keys()


@pytest.mark.parametrize("name", OTHER)
def test_a_key_that_counts_changes_the_fit(name: str) -> None:
    changed = OTHER[name]
    before = camera_slice(**{key: value for key, value in changed.items() if key != name})
    after = replace(before, **changed)
    if name == "shared_errors":
        pair = [[replace(piece, scale_rel_sd=0.02)] * 2 for piece in (before, after)]
        one, two = (fit_joint(pieces, OPTIONS)["G"] for pieces in pair)
    else:
        options = DIPOLE if name == "incidence_deg" else OPTIONS  # no table of oblique beams ships
        one, two = (fit_slice(piece, options)["G"] for piece in (before, after))
    assert "converged" in (one.status, two.status)
    assert repr(one) != repr(two)


def test_what_is_informational_changes_no_number() -> None:
    other: dict[str, Any] = {"material": "wax", "provenance": {"by": "hand"}}
    assert repr(fit_slice(camera_slice(), OPTIONS)) == repr(fit_slice(camera_slice(**other), OPTIONS))


def test_a_field_is_all_that_there_is_of_a_key() -> None:
    record = make_dataclass(
        "Record", [("tilt_deg", Annotated[float | None, Key("tilt of the table", ANGLE)], None), ("plain", int, 0)]
    )
    (tilt,) = keys_of(record).values()
    assert (tilt.kind, tilt.unit, tilt.limits, tilt.needed) == (float, "°", "≥ 0, < 90", False)
    assert checked_keys(Path("a.toml"), "", {"tilt_deg": 3}, record) == {"tilt_deg": 3.0}
    with pytest.raises(InputError, match=r"a\.toml: tilt_deg = 95 must be a finite number >= 0 and < 90"):
        checked_keys(Path("a.toml"), "", {"tilt_deg": 95}, record)
    with pytest.raises(InputError, match=r"a\.toml: tiltdeg is not known; did you mean tilt_deg\?"):
        checked_keys(Path("a.toml"), "", {"tiltdeg": 3}, record)


def test_a_key_of_one_line_is_read_written_listed_and_carried_into_the_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`wavelength_nm` stands in records.py alone."""
    file = tmp_path / "slice.csv"
    write_slice(file, camera_slice())
    assert run(cli, ["fit", str(file), "--wavelength-nm", "G=532", "--model", "dipole", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["about"] == {"wavelength_nm": {"G": 532.0}}

    write_slice(file, read_slice(file, wavelength_nm=532))
    assert "# wavelength_nm = { G = 532.0 }\n" in file.read_text()
    assert read_slice(file).wavelength_nm == {"G": 532.0}
    assert run(cli, ["fit", str(file), "--model", "dipole"]) == 0
    assert "wavelength_nm G 532" in capsys.readouterr().out

    with pytest.raises(InputError, match=r"slice\.csv: wavelength_nm = -1 must be a finite number > 0"):
        read_slice(file, wavelength_nm=-1)
    assert run(cli, ["fit", "--help"]) == 0
    assert "--wavelength-nm [CHANNEL=]NUMBER" in capsys.readouterr().out
    assert "| `wavelength_nm` |" in (Path(__file__).parents[1] / "docs" / "formats.md").read_text(encoding="utf-8")
