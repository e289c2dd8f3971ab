"""Slices and fits in bulk: nothing is lost on the way, and a curve's fit does not depend on those beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from many_curves import R_MM, files_of, filmed, plain, rich

from bssrdf.batch.fits_parquet import read_fits_of
from bssrdf.batch.slices_parquet import Named, read_slices, write_slices
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import InputError
from bssrdf.fit import fit_slice
from bssrdf.session.fit_json import fit_to_dict, write_fit
from bssrdf.session.records import Fit, Slice

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")


def bssrdf(*arguments: object) -> int:
    return run(cli, [str(argument) for argument in arguments])


def bulk(file: Path, slices: dict[str, Slice]) -> Path:
    with write_slices(file) as write:
        write([Named(name, "", piece) for name, piece in slices.items()])
    return file


def numbers(value: Any) -> list[float]:
    """All numbers in it, in order."""
    if isinstance(value, dict):
        return [each for key in sorted(value) for each in numbers(value[key])]
    if isinstance(value, list):
        return [each for one in value for each in numbers(one)]
    return [float(value)] if isinstance(value, float) else []


def test_slices_come_back_from_parquet_byte_for_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    files_of(
        Path("own"), {"a.csv": rich(), "b/c.csv": plain(), "b/measured/slice.csv": filmed(), "d.csv": plain(1.5, None)}
    )
    assert bssrdf("convert", *sorted(Path("own").rglob("*.csv")), "--out", "all.parquet") == 0
    assert bssrdf("convert", "all.parquet", "--out", "back") == 0
    originals = sorted(Path("own").rglob("*.csv"))
    assert len(originals) == 4
    for file in originals:
        assert (Path("back") / file.relative_to("own")).read_bytes() == file.read_bytes()


def test_fits_come_back_from_parquet_byte_for_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    pieces = {"good": plain(), "bound": plain(sigma_a=1e-7), "few": plain()}
    short = {name: replace(part, **{key: getattr(part, key)[:3] for key in ("r_mm", "rd_per_mm2", "sd_per_mm2")})
             for name, part in pieces["few"].channels.items()}  # fmt: skip
    pieces["few"] = replace(pieces["few"], channels=short, wavelength_nm={"R": 650.0})
    for name, piece in pieces.items():
        channels = fit_slice(piece)
        Path("own", name).mkdir(parents=True)
        fit = Fit(
            "1", f"{name}.csv", "ab", {"model": "auto", "total_r": {"R": 0.5}}, None, piece.eta, piece.g, channels
        )
        write_fit(Path("own", name, "fit.json"), fit)
    assert bssrdf("convert", "own", "--fits", "--out", "all.parquet") == 0
    assert bssrdf("convert", "all.parquet", "--out", "back") == 0
    for name in pieces:
        assert (Path("back") / name / "fit.json").read_bytes() == (Path("own") / name / "fit.json").read_bytes()


def test_a_fit_does_not_depend_on_the_curves_beside_it(tmp_path: Path) -> None:
    slices = {f"plain {seed}": plain((1.3, 1.5)[seed % 2], (None, 0.8)[seed % 2], seed=seed) for seed in range(2)}
    for at in range(2):
        seen = filmed(spot_mm=0.2 + 0.2 * (at % 2), first_mm=0.3 + 0.1 * at, seed=at)
        slices[f"filmed {at}"] = replace(seen, total_r={"G": 0.45}, total_r_sd={"G": 0.01})
    source = bulk(tmp_path / "slices.parquet", slices)
    assert bssrdf("fit", source, "--out", tmp_path / "fits.parquet") == 0
    fits = {each.name: each.fit for each in read_fits_of(tmp_path / "fits.parquet")}
    assert [*fits] == [*slices]
    for name, piece in slices.items():
        many = fits[name]
        assert isinstance(many, Fit)
        one = fit_to_dict(replace(many, channels=fit_slice(piece)))
        assert numbers(fit_to_dict(many)) == pytest.approx(numbers(one), rel=1e-9)
        assert [c.flags for c in many.channels.values()] == [tuple(c["flags"]) for c in one["channels"].values()]


def test_a_bad_slice_is_a_row_with_its_error_and_the_others_are_fitted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = bulk(tmp_path / "slices.parquet", {"good": plain(), "other": plain(seed=1), "odd": plain()})
    table = pq.read_table(source)
    rd = table["rd_per_mm2"].to_pylist()
    rd[-1] = rd[-1][:-1]
    at = table.schema.get_field_index("rd_per_mm2")
    pq.write_table(table.set_column(at, "rd_per_mm2", pa.array(rd)), source)
    assert bssrdf("fit", source, "--model", "dipole", "--out", tmp_path / "fits.parquet") == 3
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert "slice odd: channel 633nm: rd_per_mm2 has 39 values and r_mm 40" in said.err
    assert "4 converged; 1 slices failed" in said.out
    fits = {each.name: each.fit for each in read_fits_of(tmp_path / "fits.parquet")}
    assert isinstance(fits["odd"], InputError)
    assert isinstance(fits["good"], Fit)


def changed(table: Any, name: str, values: list[Any] | None) -> Any:
    """The table with another column, or without it."""
    at = table.schema.get_field_index(name)
    return table.remove_column(at) if values is None else table.set_column(at, name, pa.array(values))


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("eta", [1.3, 1.4], "slice a: eta = 1.3 in channel R and 1.4 in 633nm; one slice has one value"),
        ("g", [0.0, None], "slice a: g = 0.0 in channel R and None in 633nm"),
        ("eta", [-1.0, -1.0], "slice a: eta = -1.0 must be a finite number > 0"),
        ("flux", ["out", "out"], "slice a: flux = 'out' must be one of incident, entering"),
        ("channel", ["R", "R"], "slice a: channel 'R' must be a name that no other row of the slice has"),
        ("r_mm", [[-1.0, 2.0], [1.0, 2.0]], "channel R: rd_per_mm2 has 40 values and r_mm 2"),
        ("r_mm", [R_MM[::-1].tolist()] * 2, "value 2: r_mm = 19.51"),
        ("rd_per_mm2", [[float("inf")] * 40] * 2, "value 1: rd_per_mm2 = inf must be a finite number"),
        ("sd_per_mm2", [[0.0] * 40] * 2, "value 1: sd_per_mm2 = 0.0 must be above 0"),
        ("rd_per_mm2", [None, None], "channel R: lacks rd_per_mm2"),
        ("total_r", [3.0, 0.5], "must be a share, not per cent: give 0.03"),
        ("eta", None, "slice a: lacks eta; add lines such as"),
        ("r_mm", None, "lacks the column r_mm; add it"),
        ("eta", [float("nan")] * 2, "slice a: lacks eta; add lines such as"),
        ("eta", ["x", "y"], "column eta is of type string; write it as double"),
        ("eta", [True, True], "column eta is of type bool; write it as double"),
        ("rd_per_mm2", [[True] * 40] * 2, "column rd_per_mm2 is of type list<element: bool>; write it as list<"),
        ("rd_per_mm2", [1.0, 2.0], "column rd_per_mm2 is of type double; write it as list<"),
        ("provenance", ["{", "{"], "column provenance holds what is not JSON"),
        ("name", ["a", None], "has a row without a name"),
    ],
)  # fmt: skip
def test_bad_rows_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], column: str, value: Any, said: str
) -> None:
    source = bulk(tmp_path / "slices.parquet", {"a": plain()})
    pq.write_table(changed(pq.read_table(source), column, value), source)
    out = tmp_path / ("back" if column == "provenance" else "fits.parquet")
    command = ("convert",) if column == "provenance" else ("fit",)
    assert bssrdf(*command, source, "--out", out) == 3
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert said in lines[0]


def test_what_is_no_parquet_of_ours_is_refused_by_its_cause(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = bulk(tmp_path / "slices.parquet", {"a": plain()})
    table = pq.read_table(source)
    names = ("later", "extra", "cut", "text", "index", "nothing")
    later, extra, cut, text, index, nothing = (tmp_path / f"{name}.parquet" for name in names)
    pq.write_table(table.replace_schema_metadata({"bssrdf format": "2"}), later)
    pq.write_table(table.append_column("etta", pa.array([1.0, 2.0])), extra)
    cut.write_bytes(source.read_bytes()[:-100])
    text.write_text("r,rd\n")
    pq.write_table(table.append_column("__index_level_0__", pa.array([3, 1])), index)
    pq.write_table(table.slice(0, 0), nothing)
    for file, said in (
        (later, "format = 2 is newer than this version reads (1); update bssrdf"),
        (extra, "column etta is not known; did you mean eta?"),
        (cut, "is not a whole Parquet file"),
        (text, "is not a whole Parquet file"),
        (index, "column __index_level_0__ is the index of pandas; write it by to_parquet(index=False)"),
        (nothing, "holds no slice; give a Parquet file that does"),
        (tmp_path / "none.parquet", "is not there; check the path"),
    ):
        assert bssrdf("fit", file, "--out", tmp_path / "fits.parquet") == 3
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1
        assert said in lines[0]
        assert not (tmp_path / "fits.parquet").exists()


def test_what_other_tools_write_reads_the_same(tmp_path: Path) -> None:
    source, folder = bulk(tmp_path / "slices.parquet", {"é/ß 雪": plain()}), tmp_path / "folder"
    table, expected = pq.read_table(source), [*read_slices(source)]
    folder.mkdir()
    (folder / "._0.parquet").write_bytes(b"of another system")
    for columns, kind in (
        (("r_mm", "rd_per_mm2", "sd_per_mm2"), pa.large_list(pa.float64())),
        (("r_mm", "rd_per_mm2", "sd_per_mm2"), pa.list_(pa.float64(), 40)),
        (("name", "channel", "flux"), pa.large_string()),
        (("name", "channel", "flux"), pa.dictionary(pa.int32(), pa.string())),
        (("eta", "g"), pa.decimal128(9, 3)),
    ):
        other = table
        for name in columns:
            other = other.set_column(other.schema.get_field_index(name), name, other[name].cast(kind))
        pq.write_table(other.replace_schema_metadata(None), folder / "0.parquet")
        assert repr([*read_slices(folder)]) == repr(expected)


def test_slices_that_are_cut_by_a_group_of_rows_stay_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bssrdf.batch.slices_parquet.ROWS", 3)
    slices = {str(at): plain(seed=at) for at in range(5)}
    read = [each for group in read_slices(bulk(tmp_path / "slices.parquet", slices)) for each in group]
    assert [each.name for each in read] == [*slices]
    assert all(isinstance(each.slice, Slice) and len(each.slice.channels) == 2 for each in read)


def test_keys_of_the_command_win_over_the_columns(tmp_path: Path) -> None:
    source = bulk(tmp_path / "slices.parquet", {"a": plain()})
    (only,) = next(iter(read_slices(source, {"g": 0.5, "total_r": {"R": 0.3}})))
    assert isinstance(only.slice, Slice)
    assert only.slice.g == 0.5
    assert only.slice.total_r == {"R": 0.3, "633nm": plain().total_r["633nm"]}


def test_names_that_lead_outside_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = bulk(tmp_path / "slices.parquet", {"../../a.csv": plain(), "/b.csv": plain(seed=1)})
    assert bssrdf("convert", source, "--out", tmp_path / "back") == 3
    assert "leads outside" in capsys.readouterr().err
    assert not (tmp_path.parent / "a.csv").exists()
