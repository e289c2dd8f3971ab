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
from bssrdf.session.slice_units import doubt
from bssrdf.session.text_file import parse_columns

POSITIVE = st.floats(1e-60, 1e60)
NUMBERS = POSITIVE | st.floats(-1e60, -1e-60) | st.just(0.0)


@st.composite
def channel_slices(draw: st.DrawFn, sides: bool, bins: bool) -> ChannelSlice:
    n = draw(st.integers(1, 6))
    edges = np.sort(draw(arrays(float, n + 1, elements=st.floats(1e-9, 1e3), unique=True)))
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
        total_r=draw(st.dictionaries(st.sampled_from(names), st.floats(1e-12, 1.1))),
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


@given(
    st.lists(st.lists(st.sampled_from(["a", "1.5", "", " "]), min_size=1, max_size=4), max_size=6), st.integers(0, 2)
)
def test_cut_at_its_commas_a_table_is_what_a_reader_of_csv_finds(rows: list[list[str]], blank: int) -> None:
    text = "\n" * blank + "\n".join(map(",".join, [["a", "b"], *rows])) + "\n"
    found = []
    for content in (text, text.replace("a,b", '"a",b', 1)):  # a quoted field takes the long way
        try:
            table = parse_columns(Path("x.csv"), content, ["a", "b"], ["a", "b"])
            found.append(repr((table.header, [*map(list, table.columns)], table.lines.tolist())))
        except InputError as error:
            found.append(str(error))
    assert found[0] == found[1]


def test_failed_write_leaves_the_old_file_alone(minimal: Path) -> None:
    curve = read_slice(minimal)
    with pytest.raises(TypeError):
        write_slice(minimal, replace(curve, provenance={"x": object()}))
    assert minimal.read_text() == MINIMAL
    assert [entry.name for entry in minimal.parent.iterdir()] == ["slice.csv"]


BASE = '# eta = 1.4\n# flux = "entering"\n# exit = "hemisphere"\n'


def curve_text(head: str = BASE, columns: str = "channel,r_mm,rd_per_mm2,sd_per_mm2", mm: float = 1.0) -> str:
    """A curve of 0.4 of the light, with lengths in units of `mm` millimetres."""
    r = np.linspace(0.1, 12, 40)
    rd = 0.4 / (2 * np.pi * r) * 0.7 * np.exp(-0.7 * r)
    rows = [f"G,{a / mm!r},{b * mm**2!r},{0.01 * b * mm**2!r}" for a, b in zip(r.tolist(), rd.tolist(), strict=True)]
    return head + "\n".join([columns, *rows]) + "\n"


@pytest.mark.parametrize(("unit", "mm"), [("cm", 10.0), ("m", 1000.0), ("mm", 1.0), ("um", 1e-3)])
@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("by_key", [True, False])
def test_a_unit_turns_lengths_and_densities_into_mm(tmp_path: Path, unit: str, mm: float, named: bool, by_key: bool):
    file = tmp_path / "slice.csv"
    columns = "channel,r_mm,rd_per_mm2,sd_per_mm2"
    file.write_text(curve_text())
    expected = read_slice(file).channels["G"]
    head = BASE + (f'# unit = "{unit}"\n' if by_key else "")
    file.write_text(curve_text(head, columns.replace("mm", unit) if named else columns, mm))
    part = read_slice(file, unit=None if by_key else unit).channels["G"]
    for name in ("r_mm", "rd_per_mm2", "sd_per_mm2"):
        assert getattr(part, name) == pytest.approx(getattr(expected, name), rel=1e-12)


def test_the_command_line_wins_over_the_unit_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "slice.csv"
    file.write_text(curve_text(BASE + '# unit = "m"\n'))
    assert read_slice(file, unit="cm").channels["G"].r_mm[0] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (curve_text(columns="channel,r_cm,rd_per_cm2,sd_per_cm2"), r"r_cm is in cm, not in mm; give --unit cm"),
        (curve_text(columns="channel,r_m,rd_per_m2,sd_per_m2"), r"r_m is in m, not in mm; give --unit m,"),
        (
            curve_text(columns="channel,r_mm,rd_per_cm2,sd_per_cm2"),
            r"has columns in mm and in cm; write all lengths in one unit",
        ),
        (curve_text(BASE + '# unit = "cm"\n', "channel,r_m,rd_per_m2,sd_per_m2"), r"r_m is in m, not in cm; rename"),
        (curve_text(BASE + '# unit = "inch"\n'), r"unit = 'inch' must be one of mm, cm, m, um"),
        (curve_text().replace(",", ";"), r"separates its fields by semicolons"),
        (BASE + curve_text("").replace(",", "\t").replace(".", ","), r"separates its fields by tabs"),
        (curve_text().replace(",", "|"), r"separates its fields by bars"),
        (curve_text().replace(",", "  "), r"separates its fields by spaces"),
        (BASE + "0.5,0.1\n1,0.05\n", r"begins with numbers; put the line channel,"),
        (MINIMAL + "G,1.5,-3e-3,1e-4\n", r"line 10 is line 9 again \(r_mm = 1.5 in channel 'G'\)"),
        (MINIMAL + "G,2,1e300,1\n", r"line 10: rd_per_mm2 = '1e300' is out of reach"),
        (MINIMAL + "G,2,1,1e-300\n", r"line 10: sd_per_mm2 = '1e-300' is out of reach"),
        ("# total_r = 45.3\n" + MINIMAL, r"total_r = 45.3 must be a share, not per cent: give 0.453"),
        ("# spot_radius_mm = 1e300\n" + MINIMAL, r"spot_radius_mm = 1e\+300 must be a finite number"),
        ("# scale_rel_sd = 1e300\n" + MINIMAL, r"scale_rel_sd = 1e\+300 must be a finite number"),
        (MINIMAL + "G,2,nan,1\n", r"line 10: rd_per_mm2 = 'nan' must be a finite number"),
        (MINIMAL + "G,2,1,0\n", r"line 10: sd_per_mm2 = 0.0 must be above 0"),
    ],
)
def test_what_people_bring_is_refused_with_its_cause_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "slice.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=message) as raised:
        read_slice(file)
    assert str(raised.value).startswith(f"{file}: ")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"PK\x03\x04\x14\x00\x06\x00", r"a zip archive such as a workbook \(\.xlsx, \.ods\)"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1", r"an old workbook \(\.xls\)"),
        (MINIMAL.encode("utf-16"), "text in UTF-16"),
    ],
)
def test_a_workbook_named_csv_is_called_one(tmp_path: Path, content: bytes, kind: str) -> None:
    file = tmp_path / "slice.csv"
    file.write_bytes(content)
    with pytest.raises(InputError, match=f"is {kind}, whatever its name; save it as plain text"):
        read_slice(file)


def test_repeats_of_a_radius_with_their_own_values_are_kept(minimal: Path) -> None:
    minimal.write_text(MINIMAL + "G,1.5,-2e-3,1e-4\n")
    assert read_slice(minimal).channels["G"].r_mm.tolist() == [0.5, 1.5, 1.5]


def test_a_missing_error_leaves_the_others(minimal: Path) -> None:
    minimal.write_text(MINIMAL + "G,2,1e-3,\nG,3,1e-3,2e-4\n")
    np.testing.assert_array_equal(read_slice(minimal).channels["G"].sd_per_mm2, [np.nan, 1e-4, np.nan, 2e-4])


@pytest.mark.parametrize(
    ("head", "mm_r", "mm_rd", "said"),
    [
        ("", 1, 1, None),
        ("# total_r = 0.4\n", 1, 1, None),
        ("# total_r = 0.4\n", 10, 1, "far below total_r = 0.4"),
        ("# total_r = 0.4\n", 1, 10, "more than total_r = 0.4"),
        ("", 1, 10, "more than all that entered"),
        ("", 1000, 1000, "if the radii are in m, give --unit m"),
    ],
)
def test_units_that_look_wrong_are_doubted(tmp_path: Path, head: str, mm_r: float, mm_rd: float, said: str | None):
    file = tmp_path / "slice.csv"
    file.write_text(curve_text(BASE + head))
    curve = read_slice(file)
    part = curve.channels["G"]
    other = replace(part, r_mm=part.r_mm / mm_r, rd_per_mm2=part.rd_per_mm2 * mm_rd**2)
    found = doubt(replace(curve, channels={"G": other}))
    assert (found is None) if said is None else (found is not None and said in found)


def test_a_curve_far_from_the_beam_is_not_doubted(tmp_path: Path) -> None:
    file = tmp_path / "slice.csv"
    file.write_text(curve_text(BASE + "# total_r = 0.4\n"))
    curve = read_slice(file)
    part = curve.channels["G"]
    far = ChannelSlice(part.r_mm[25:], part.rd_per_mm2[25:], part.sd_per_mm2[25:])
    assert doubt(replace(curve, channels={"G": far})) is None
