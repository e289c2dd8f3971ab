"""slice.csv: exact round trips, the optional parts of the format, and a large file."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bssrdf.errors import InputError
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.session.slice_csv import read_slice, write_slice

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(0, exclude_min=True, allow_infinity=False)


@st.composite
def channel_slices(draw: st.DrawFn, sides: bool, bins: bool) -> ChannelSlice:
    n = draw(st.integers(1, 6))
    edges = np.sort(draw(arrays(float, n + 1, elements=st.floats(0, 1e3), unique=True)))
    return ChannelSlice(
        r_mm=edges[1:],
        rd_per_mm2=draw(arrays(float, n, elements=NUMBERS)),
        sd_per_mm2=draw(arrays(float, n, elements=st.just(np.nan) | POSITIVE)),
        r_lo_mm=edges[:-1] if bins else None,
        r_hi_mm=edges[1:] if bins else None,
        side=draw(arrays(np.int8, n, elements=st.sampled_from([-1, 1]))) if sides else None,
    )


@st.composite
def slices(draw: st.DrawFn) -> Slice:
    names = draw(st.lists(st.sampled_from(["R", "G", "633nm", 'σ "x",']), min_size=1, unique=True))
    sides, bins = draw(st.booleans()), draw(st.booleans())
    return Slice(
        channels={name: draw(channel_slices(sides, bins)) for name in names},
        eta=draw(st.floats(1, 3)),
        flux=draw(st.sampled_from(["incident", "entering"])),
        exit=draw(st.sampled_from(["hemisphere", "lambertian", "fresnel"])),
        view_angle_deg=draw(st.floats(0, 89)),
        total_r=draw(st.dictionaries(st.sampled_from(names), st.floats(1e-300, 1.1))),
        total_r_sd=draw(st.dictionaries(st.sampled_from(names), st.floats(0, 1))),
        material=draw(st.none() | st.just("marble\u2028\x85 #1")),
        g=draw(st.none() | st.floats(-0.99, 0.99)),
        lost_fraction=draw(st.none() | st.dictionaries(st.sampled_from(names), st.floats(0, 0.99), min_size=1)),
        scale_rel_sd=draw(st.floats(0, 1)),
        flags=draw(st.just(()) | st.just(("speckle", "drift"))),
        provenance=draw(st.just({}) | st.just({"version": "1", "inputs": [{"file": "a\nb", "exposure_s": 0.1}]})),
    )


def assert_same(ours: Slice, theirs: Slice) -> None:
    for field in fields(Slice):
        if field.name != "channels":
            assert getattr(ours, field.name) == getattr(theirs, field.name), field.name
    assert list(ours.channels) == list(theirs.channels)
    for name, part in ours.channels.items():
        for field in fields(ChannelSlice):
            np.testing.assert_array_equal(getattr(part, field.name), getattr(theirs.channels[name], field.name))


@settings(max_examples=50, deadline=None)
@given(curve=slices())
def test_written_slice_is_read_back_to_the_last_bit(tmp_path_factory: pytest.TempPathFactory, curve: Slice) -> None:
    file = tmp_path_factory.mktemp("slice") / "slice.csv"
    write_slice(file, curve)
    assert_same(read_slice(file), curve)
    assert [entry.name for entry in file.parent.iterdir()] == ["slice.csv"]


MINIMAL = """\
## Prose, with a = sign that is not TOML [
# eta = 1.5
# flux = "incident"
# exit = "fresnel"

channel,r_mm,rd_per_mm2,sd_per_mm2
G,0.5,1e-2,
R,0.25,2,0.1
G, 1.5 ,-3e-3,1e-4
"""


@pytest.fixture
def minimal(tmp_path: Path) -> Path:
    file = tmp_path / "slice.csv"
    file.write_text(MINIMAL)
    return file


def test_slice_by_hand(minimal: Path) -> None:
    curve = read_slice(minimal)
    assert list(curve.channels) == ["G", "R"]
    np.testing.assert_array_equal(curve.channels["G"].r_mm, [0.5, 1.5])
    np.testing.assert_array_equal(curve.channels["G"].rd_per_mm2, [0.01, -0.003])
    np.testing.assert_array_equal(curve.channels["G"].sd_per_mm2, [np.nan, 1e-4])
    assert (curve.eta, curve.flux, curve.exit, curve.view_angle_deg) == (1.5, "incident", "fresnel", 45.0)
    assert curve.total_r == {}
    assert curve.lost_fraction is None


@pytest.mark.parametrize("ending", ["\r\n", "\r"])
def test_line_endings_do_not_matter(minimal: Path, ending: str) -> None:
    curve = read_slice(minimal)
    minimal.write_bytes(b"\xef\xbb\xbf" + MINIMAL.replace("\n", ending).encode())
    assert_same(read_slice(minimal), curve)


@pytest.mark.parametrize(
    ("key", "value"),
    [("eta", 1.3), ("flux", "entering"), ("exit", "hemisphere"), ("g", 0.8), ("total_r", {"G": 0.7})],
)
def test_key_from_the_command_line_wins(minimal: Path, key: str, value: Any) -> None:
    assert_same(read_slice(minimal, **{key: value}, material=None), replace(read_slice(minimal), **{key: value}))


def test_key_from_the_command_line_stands_in_for_a_missing_one(minimal: Path) -> None:
    minimal.write_text(MINIMAL.replace("# eta = 1.5\n", ""))
    assert read_slice(minimal, eta=1.4).eta == 1.4


@pytest.mark.parametrize("key", ["total_r", "total_r_sd", "lost_fraction"])
def test_one_number_holds_for_every_channel(minimal: Path, key: str) -> None:
    minimal.write_text(f"# {key} = 0.02\n" + MINIMAL)
    assert getattr(read_slice(minimal), key) == {"G": 0.02, "R": 0.02}


@pytest.mark.parametrize("header", ["total_r = 0.8", "total_r = { G = 0.8, R = 0.8 }"])
def test_number_for_one_channel_from_the_command_line_leaves_the_others(minimal: Path, header: str) -> None:
    minimal.write_text(f"# {header}\n" + MINIMAL)
    assert read_slice(minimal, total_r={"G": 0.7}).total_r == {"G": 0.7, "R": 0.8}
    assert read_slice(minimal, total_r=0.6).total_r == {"G": 0.6, "R": 0.6}


def test_sides_ascend_each_for_itself(minimal: Path) -> None:
    head = MINIMAL.partition("channel")[0] + "channel,r_mm,rd_per_mm2,sd_per_mm2,side\n"
    minimal.write_text(head + "G,1,1,,-1\nG,0,1,,1\nG,2,1,,-1\nG,1,1,,1\n")
    np.testing.assert_array_equal(read_slice(minimal).channels["G"].side, [-1, 1, -1, 1])
    minimal.write_text(head + "G,1,1,,-1\nG,0,1,,1\nG,0.5,1,,-1\n")
    with pytest.raises(InputError, match=r"line 9: r_mm = 0\.5"):
        read_slice(minimal)


def test_large_slice_is_read_exactly(tmp_path: Path) -> None:
    r_mm = np.sort(np.random.default_rng(0).random(20_000))
    part = ChannelSlice(r_mm, 1 / (1 + r_mm), np.full(r_mm.size, np.nan))
    curve = Slice({"R": part, "G": part}, 1.3, "entering", "hemisphere")
    write_slice(tmp_path / "slice.csv", curve)
    assert_same(read_slice(tmp_path / "slice.csv"), curve)


def test_failed_write_leaves_the_old_file_alone(minimal: Path) -> None:
    curve = read_slice(minimal)
    with pytest.raises(TypeError):
        write_slice(minimal, replace(curve, provenance={"x": object()}))
    assert minimal.read_text() == MINIMAL
    assert [entry.name for entry in minimal.parent.iterdir()] == ["slice.csv"]
