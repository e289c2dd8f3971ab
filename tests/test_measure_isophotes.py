"""Wrong geometry shows in the picture; right geometry is not refused. Light of the simulated bench, walked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bssrdf.bench.sabotage import MARBLE, SABOTAGES, SKIN, SabotagedBench, judge, truth_is_held, write_session
from bssrdf.errors import InputError
from bssrdf.measure.isophotes import _ring
from bssrdf.measure.session import measure_session
from bssrdf.session.records import Slice
from bssrdf.session.session_toml import read_session
from bssrdf.transport.exit_azimuth import second_harmonic
from bssrdf.transport.white.store import shipped

GEOMETRY = {"aspect_off", "view_angle_off", "anisotropic", "geometry_unchecked"}


def measured(path: Path, bench: SabotagedBench) -> Slice:
    write_session(path, replace(bench, shape=(200, 280)))
    curve = measure_session(read_session(path)).slice
    assert curve is not None
    return curve


@pytest.fixture(scope="module")
def marble(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("isophotes") / "marble"
    measured(path, MARBLE)
    return path


@pytest.fixture(scope="module")
def skin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("isophotes") / "skin"
    measured(path, replace(SKIN, view_axis="x", mm_per_px=0.1, spot_mm=0.25))
    return path


def again(path: Path, **said: dict[str, Any]) -> Slice:
    """The session with other keys in session.toml than the truth."""
    session = read_session(path)
    tables = {table: replace(getattr(session, table), **keys) for table, keys in said.items()}
    curve = measure_session(replace(session, **tables), from_hdr=True).slice
    assert curve is not None
    return curve


@pytest.mark.parametrize("name", ["marble", "skin"])
def test_right_geometry_raises_no_flag_and_its_angle_is_seen(name: str, request: pytest.FixtureRequest) -> None:
    curve = again(request.getfixturevalue(name))
    assert not GEOMETRY & set(curve.flags)
    for seen in curve.provenance["isophotes"].values():
        assert abs(np.log(seen["aspect"])) < 2.5 * seen["aspect_rel_sd"] < 0.05
    assert curve.provenance["isophotes"]["sample"]["view_angle_deg"] == pytest.approx(45, abs=1.0)


def test_a_swapped_axis_is_refused_by_its_key(marble: Path, skin: Path) -> None:
    for path, axis in ((marble, "x"), (skin, "y")):
        with pytest.raises(InputError, match=rf'\[geometry\] view_axis = "{axis}" does not go with the picture'):
            again(path, geometry={"view_axis": axis})


@pytest.mark.parametrize("off_deg", [-15, -5, 5, 15])
def test_a_wrong_angle_is_flagged_with_the_right_one(marble: Path, skin: Path, off_deg: float) -> None:
    for path in (marble, skin):
        curve = again(path, geometry={"view_angle_deg": 45.0 + off_deg})
        assert GEOMETRY & set(curve.flags) in ({"view_angle_off"}, {"aspect_off"})
        for seen in curve.provenance["isophotes"].values():
            assert seen["view_angle_deg"] == pytest.approx(45, abs=2.0)


def test_an_angle_stated_as_uncertain_is_let_pass(marble: Path) -> None:
    assert not GEOMETRY & set(again(marble, geometry={"view_angle_deg": 48.0, "view_angle_sd_deg": 2.0}).flags)


@pytest.mark.parametrize(
    "said",
    [{"geometry": {"view_angle_deg": 14.0}}, {"beam": {"incidence_deg": 6.0}}, {"material": {"width_mm": 3.0}}],
    ids=["steep view", "oblique beam", "narrow dish"],
)
def test_where_nothing_can_be_seen_that_is_said(marble: Path, said: dict[str, Any]) -> None:
    assert GEOMETRY & set(again(marble, **said).flags) == {"geometry_unchecked"}


def test_a_sample_alone_elliptical_is_anisotropic(tmp_path: Path) -> None:
    assert GEOMETRY & set(measured(tmp_path / "fibrous", replace(MARBLE, fibre=0.2)).flags) == {"anisotropic"}


@pytest.mark.slow
def test_an_elliptical_beam_is_no_wrong_geometry(tmp_path: Path) -> None:
    assert not GEOMETRY & set(measured(tmp_path / "beam", replace(MARBLE, spot_aspect=1.4)).flags)


def test_a_spot_that_is_not_as_wide_as_stated_is_flagged(tmp_path: Path) -> None:
    bench, _ = SABOTAGES["out of focus"]
    assert "spot_differs" in measured(tmp_path / "s", bench).flags


def test_the_harmonic_vanishes_towards_the_normal_and_far_from_the_beam() -> None:
    tables, r = shipped(), np.array([2.0, 5.0, 20.0])
    at_45 = second_harmonic(tables, 1.3, 0.8, 0.3, r, 45.0)
    assert np.all(np.diff(at_45) < 0)
    assert np.all(at_45 > 0)
    np.testing.assert_allclose(second_harmonic(tables, 1.3, 0.8, 0.3, r, 0.0), 0, atol=1e-9)


@pytest.mark.slow
def test_sabotaged_sessions_are_caught(tmp_path: Path) -> None:
    outcomes = [judge(name, tmp_path / str(at), holds_truth=truth_is_held) for at, name in enumerate(SABOTAGES)]
    assert len(outcomes) == 24
    assert sum(each.caught for each in outcomes) >= 23, [each for each in outcomes if not each.caught]


@pytest.mark.parametrize("seed", [110, 820])
def test_a_ring_of_noise_about_nothing_tells_no_aspect(seed: int) -> None:
    """Its slope seemed to rise without end, and overflowed."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.uniform(0, 2 * np.pi, 200), rng.uniform(10, 11.5, 200)
    ring = radius * np.sin(angle), radius * np.cos(angle), rng.normal(0, 1, 200), np.ones(200)
    assert _ring(*ring, middle=10.7) is None
