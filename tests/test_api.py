"""`import bssrdf`: every stage by one call, names that no sub-package takes, and wrong input refused by its value."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bssrdf
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.transport.dipole import Medium, rd
from bssrdf.transport.precision import scoped_x64

R_MM = np.linspace(1.0, 20.0, 40)
KEYS: dict[str, Any] = {"eta": 1.4, "flux": "entering", "exit": "hemisphere", "scale_rel_sd": 0.001}


@scoped_x64
def light() -> np.ndarray:
    return np.array([float(rd(Medium(0.02, 1.0, 1.4), r)) for r in R_MM])


def test_public_names_are_not_modules_even_when_every_sub_package_was_imported() -> None:
    code = """
import importlib, pkgutil, types
import bssrdf
for module in pkgutil.iter_modules(bssrdf.__path__):
    if module.ispkg:
        importlib.import_module(f"bssrdf.{module.name}")
public = [name for name in dir(bssrdf) if not name.startswith("_")]
assert "fit_slice" in public and "measure_session" in public
assert not [name for name in bssrdf._HOME if isinstance(getattr(bssrdf, name), types.ModuleType)]
for call, argument in ((bssrdf.fit_slice, "nowhere.csv"), (bssrdf.measure_session, "nowhere")):
    try:
        call(argument)
    except bssrdf.InputError as error:
        assert "nowhere" in str(error)
"""
    root = Path(__file__).resolve().parents[1]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=root, timeout=120)
    assert done.returncode == 0, done.stderr


def test_arrays_paths_and_the_command_line_give_one_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    piece = bssrdf.Slice.from_arrays(R_MM, light(), light() / 100, total_r=0.45, total_r_sd=0.01, **KEYS)
    file = tmp_path / "slice.csv"
    bssrdf.write_slice(file, piece)
    options = {"model": "dipole", "eta": 1.35}
    fits = [bssrdf.fit_slice(source, **options) for source in (piece, file, str(file))]
    assert run(cli, ["fit", str(file), "--json", "--model", "dipole", "--eta", "1.35"]) == 0
    printed = json.loads(capsys.readouterr().out)["channels"]["mono"]
    for fit in fits:
        assert fit.eta == 1.35
        assert fit.channels["mono"].sigma_a_per_mm == pytest.approx(printed["sigma_a_per_mm"], rel=1e-12)
        assert fit.channels["mono"].flags == tuple(printed["flags"])
    saved = bssrdf.read_fit(fits[1].save(tmp_path / "fit.json"))
    assert replace(saved, curve=None).channels["mono"].sigma_sp_per_mm == fits[0].channels["mono"].sigma_sp_per_mm


def test_rows_are_put_in_order_and_frames_are_read_by_column() -> None:
    class Frame(dict):
        columns = property(lambda self: list(self))

        def __len__(self) -> int:
            return len(self["r_mm"])

    falling = slice(None, None, -1)
    piece = bssrdf.Slice.from_arrays(R_MM[falling], light()[falling], **KEYS)
    assert np.array_equal(piece.channels["mono"].r_mm, R_MM)
    twice = Frame(
        channel=np.repeat(["G", "R"], len(R_MM)), r_mm=np.tile(R_MM, 2), rd_per_mm2=np.append(light(), light() / 2)
    )
    piece = bssrdf.Slice.from_dataframe(twice, **KEYS)
    assert list(piece.channels) == ["G", "R"]
    assert np.array_equal(piece.channels["R"].rd_per_mm2, light() / 2)
    assert np.isnan(piece.channels["R"].sd_per_mm2).all()


def good() -> Any:
    return bssrdf.Slice.from_arrays(R_MM, light(), **KEYS)


WRONG = {
    "negative radii": (lambda: bssrdf.Slice.from_arrays(-R_MM, light(), **KEYS), "-1"),
    "nothing but NaN": (lambda: bssrdf.Slice.from_arrays(R_MM, light() * np.nan, **KEYS), "nan"),
    "m for mm": (lambda: bssrdf.Slice.from_arrays(R_MM / 1000, light() * 1e6, **KEYS), "multiply them by 1000"),
    "other shape": (lambda: bssrdf.Slice.from_arrays(R_MM, light()[:5], **KEYS), "5 values for 40"),
    "a table": (lambda: bssrdf.Slice.from_arrays(np.ones((2, 2)), light(), **KEYS), "(2, 2)"),
    "words": (lambda: bssrdf.Slice.from_arrays(["a", "b"], light(), **KEYS), "not made of numbers"),
    "sd of 0": (lambda: bssrdf.Slice.from_arrays(R_MM, light(), 0 * R_MM, **KEYS), "above 0"),
    "no convention": (lambda: bssrdf.Slice.from_arrays(R_MM, light(), eta=1.4), "lacks flux, exit"),
    "wrong keyword": (lambda: bssrdf.fit_slice(good(), modle="mc"), "did you mean model?"),
    "wrong model": (lambda: bssrdf.fit_slice(good(), model="monte carlo"), "'monte carlo' must be one of auto"),
    "wrong window": (lambda: bssrdf.fit_slice(good(), window_mm=(3, 1)), "the smaller one first"),
    "wrong eta": (lambda: bssrdf.fit_slice(good(), eta="big"), "'big'"),
    "wrong channel": (lambda: bssrdf.fit_slice(good(), total_r={"G": 0.5}), "G is not known"),
    "no slice": (lambda: bssrdf.fit_slice(3), "3 is neither a slice nor a path"),
    "wrong option": (lambda: bssrdf.measure_session("here", band=3), "did you mean band_mm?"),
    "negative absorption": (lambda: bssrdf.rd([1.0], sigma_a_per_mm=-1, sigma_sp_per_mm=1, eta=1.4), "-1"),
    "no radii": (lambda: bssrdf.rd([], sigma_a_per_mm=0, sigma_sp_per_mm=1, eta=1.4), "radii"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_input_is_refused_with_its_value(what: str) -> None:
    call, said = WRONG[what]
    with pytest.raises(bssrdf.InputError) as caught:
        call()
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_fit_shows_itself_and_escapes_names() -> None:
    awkward = '<i>"M"</i></script>\n'
    fit = bssrdf.fit_slice(bssrdf.Slice.from_arrays(R_MM, light(), material=awkward, **KEYS), model="dipole")
    html = fit._repr_html_()
    assert "<i>" not in html
    assert "Did the fit settle?" in html
    assert "mono" in fit.table()
    assert len(fit.plot().axes) == 2


def test_the_curve_comes_back_from_a_fit_and_is_one_in_any_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The fit is not a test of the table: it shows that header, columns and units of the file are right."""
    files = {unit: tmp_path / f"{unit}.csv" for unit in ("mm", "cm")}
    for unit, factor in (("mm", 1), ("cm", 10)):
        medium = ["--sigma-a", 0.01 * factor, "--sigma-sp", 1.0 * factor, "--eta", 1.4, "--g", 0.8]
        assert run(cli, ["curve", *map(str, medium), "--unit", unit, "--out", str(files[unit])]) == 0
    one, other = (bssrdf.read_slice(files[unit]) for unit in ("mm", "cm"))
    for column in ("r_mm", "rd_per_mm2"):
        mm, cm = (getattr(each.channels["curve"], column) for each in (one, other))
        assert np.allclose(mm, cm, rtol=1e-12, atol=0)
    assert one.total_r["curve"] == pytest.approx(other.total_r["curve"], rel=1e-12)
    found = bssrdf.fit_slice(files["cm"], model="mc").channels["curve"]
    assert found.sigma_a_per_mm == pytest.approx(0.01, rel=0.005)
    assert found.sigma_sp_per_mm == pytest.approx(1.0, rel=0.005)


@pytest.mark.parametrize("case", [("0.001", "2", "1.5", "0"), ("1", "0.5", "1.3", "0.9"), ("0", "1", "1.4", "0.5")])
def test_the_light_of_a_curve_adds_up_to_its_r(case: tuple[str, ...], tmp_path: Path) -> None:
    """∫ R_d 2πr dr over radii far in and out is R: of the table, which is not made to be so."""
    sigma_a, sigma_sp, eta, g = map(float, case)
    radii = np.geomspace(1e-3, 400, 4000) / (sigma_a + sigma_sp)
    rd = bssrdf.rd(radii, sigma_a_per_mm=sigma_a, sigma_sp_per_mm=sigma_sp, eta=eta, g=g)
    whole = np.trapezoid(2 * np.pi * radii**2 * rd, np.log(radii)) + 2 * np.pi * radii[0] ** 2 * rd[0]
    out = tmp_path / "curve.csv"
    words = ["--sigma-a", case[0], "--sigma-sp", case[1], "--eta", case[2], "--g", case[3], "--out", str(out)]
    assert run(cli, ["curve", *words]) == 0
    assert whole == pytest.approx(bssrdf.read_slice(out).total_r["curve"], rel=0.02)


def test_a_curve_that_cannot_be_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    medium = ["curve", "--sigma-a", "0.01", "--sigma-sp", "1", "--eta", "1.4"]
    assert run(cli, [*medium, "--r", "1,-2"]) == 3
    assert "-2" in capsys.readouterr().err
    assert run(cli, [*medium, "--g", "2"]) == 3
    assert run(cli, [*medium, "--r", "a"]) == 2
    taken = tmp_path / "taken.csv"
    taken.write_text("mine")
    assert run(cli, [*medium, "--out", str(taken)]) == 2
    assert taken.read_text() == "mine"
    assert run(cli, [*medium, "--r", "2,1", "--plot", str(tmp_path / "p.png")]) == 0
    assert (tmp_path / "p.png").stat().st_size > 10_000
