"""`bssrdf export`: what it takes, what it refuses in one line, and what it says of what it wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bssrdf.cli import cli
from bssrdf.commands.console import run

CHANNEL: dict[str, Any] = {
    "model": "mc",
    "sigma_a_per_mm": 0.0041,
    "sigma_a_sd_per_mm": 0.0001,
    "sigma_a_interval95_per_mm": [0.0039, 0.0043],
    "sigma_sp_per_mm": 2.62,
    "sigma_sp_sd_per_mm": 0.02,
    "sigma_sp_interval95_per_mm": [2.58, 2.66],
    "correlation": -0.9,
    "total_r_measured": 0.8,
    "total_r_model": 0.7995,
    "window_mm": [0.5, 12.0],
    "n": 180,
    "chi2_reduced": 1.0,
    "status": "converged",
    "flags": [],
}


def fit_document(**changes: Any) -> dict[str, Any]:
    return {
        "format": 1,
        "version": "0.1.0",
        "input": {"path": "slice.csv", "sha256": "0"},
        "options": {},
        "material": "soap",
        "eta": 1.5,
        "g": 0.0,
        "about": {"space": "camera"},
        "channels": {name: dict(CHANNEL) for name in "RGB"},
    } | changes


@pytest.fixture
def fit(tmp_path: Path) -> Path:
    return written(tmp_path / "soap.json", fit_document())


def written(path: Path, document: dict[str, Any]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def export(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    """Exit code and what stands on stderr, its lines each one message."""
    code = run(cli, ["export", *map(str, arguments), "--quiet"])
    said = capsys.readouterr().err
    assert "Traceback" not in said
    return code, said


def refused(capsys: pytest.CaptureFixture[str], code: int, *arguments: object) -> str:
    """The one line that a refused export leaves; nothing is written."""
    out = Path(str(arguments[arguments.index("--out") + 1]))
    found, said = export(capsys, *arguments)
    assert found == code, said
    if code == 3:
        assert said.count("\n") == 1, said
    assert not out.exists()
    return said


def with_channel(**changes: Any) -> dict[str, Any]:
    document = fit_document()
    document["channels"]["G"] |= changes
    return document


@pytest.mark.parametrize(
    ("target", "suffix"), [("blender", "py"), ("mitsuba", "xml"), ("mitsuba", "py"), ("pbrt", "pbrt")]
)
def test_fit_is_written_for_each_renderer(
    fit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], target: str, suffix: str
) -> None:
    out = tmp_path / f"out.{suffix}"
    code, said = export(capsys, fit, "--to", target, "--out", out)
    assert (code, said) == (0, "")
    text = out.read_text(encoding="utf-8")
    for line in ("soap, from", "kept: ", "unit: 1 ", "colour space: ", "eta: 1.5", "residuals: "):
        assert line in text


@pytest.mark.parametrize(
    ("status", "why"), [("rejected", "contradict"), ("unidentifiable", "determine"), ("upper_bound", "upper bound")]
)
def test_untrusted_fit_is_refused_and_marked_where_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], status: str, why: str
) -> None:
    path, out = written(tmp_path / "fit.json", with_channel(status=status)), tmp_path / "o.pbrt"
    said = refused(capsys, 3, path, "--to", "pbrt", "--out", out)
    assert why in said
    assert "--untrusted" in said
    code, said = export(capsys, path, "--to", "pbrt", "--out", out, "--untrusted")
    assert code == 0
    assert "NOT TRUSTED: G" in said
    assert "# note: NOT TRUSTED: G" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (with_channel(model="dipole"), "dipole renderers"),
        (fit_document(g=None), "g was not given"),
        (fit_document(g=-0.3), "below 0"),
        (with_channel(sigma_a_per_mm=0.0), "σa is 0 in G"),
        (fit_document(about={}), "colour space not stated"),
    ],
)
def test_what_must_be_known_is_said_in_a_line_and_in_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], document: dict[str, Any], words: str
) -> None:
    path, out = written(tmp_path / "fit.json", document), tmp_path / "o.py"
    code, said = export(capsys, path, "--to", "blender", "--out", out)
    assert code == 0
    assert words in said
    assert said.count("\n") == 1
    assert words in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (with_channel(status="failed", sigma_a_per_mm=None, sigma_sp_per_mm=None), "G is failed and has no value"),
        (fit_document(channels=dict.fromkeys(("633nm", "532nm", "473nm"), CHANNEL)), "--rgb"),
        (fit_document(channels=dict.fromkeys("RG", CHANNEL)), "has no channel B"),
        (with_channel(sigma_a_per_mm=2e7), "black to a renderer"),
        (fit_document(eta=0.8), "eta"),
    ],
)
def test_what_cannot_be_exported_is_refused_by_its_cause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], document: dict[str, Any], words: str
) -> None:
    path = written(tmp_path / "fit.json", document)
    assert words in refused(capsys, 3, path, "--to", "blender", "--out", tmp_path / "o.py")


def test_other_channels_can_stand_for_red_green_and_blue(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = fit_document(channels=dict.fromkeys(("473nm", "532nm", "633nm"), CHANNEL))
    path = written(tmp_path / "fit.json", document)
    out = tmp_path / "o.pbrt"
    assert export(capsys, path, "--to", "pbrt", "--rgb", "633nm,532nm,473nm", "--out", out)[0] == 0
    assert "two" not in refused(capsys, 2, path, "--to", "pbrt", "--rgb", "633nm", "--out", tmp_path / "p.pbrt")


@pytest.mark.parametrize(
    "options",
    [
        ("--to", "blender", "--renderer-version", "9.9"),
        ("--to", "blender", "--renderer-version", "new"),
        ("--to", "blender", "--unit", "inch"),
        ("--to", "maya"),
        ("--to", "usd", "--keep", "medium"),
    ],
)
def test_unknown_version_unit_target_or_keep_is_wrong_usage(
    fit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...]
) -> None:
    refused(capsys, 2, fit, *options, "--out", tmp_path / ("o.usda" if "usd" in options else "o.py"))


def test_suffix_of_another_format_is_wrong_usage(fit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "end in .py" in refused(capsys, 2, fit, "--to", "blender", "--out", tmp_path / "o.xml")


def test_space_that_the_fit_is_not_in_is_refused(fit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, 3, fit, "--to", "pbrt", "--space", "acescg", "--out", tmp_path / "o.pbrt")
    assert "measure --space acescg" in said


def test_published_name_and_nearest_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert export(capsys, "marble", "--to", "pbrt", "--out", tmp_path / "o.pbrt")[0] == 0
    said = refused(capsys, 3, "marbel", "--to", "pbrt", "--out", tmp_path / "p.pbrt")
    assert "Marble" in said


def test_path_wins_over_a_published_name_and_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "marble" / "fit.json", fit_document())
    code, said = export(capsys, "marble", "--to", "pbrt", "--out", tmp_path / "o.pbrt")
    assert code == 0
    assert "the path was taken" in said
    assert 'MakeNamedMedium "soap"' in (tmp_path / "o.pbrt").read_text(encoding="utf-8")


def test_folder_of_fits_gives_one_library_or_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b", "c"):
        written(tmp_path / "fits" / name / "fit.json", fit_document(material="soap" if name < "c" else "wax/½"))
    code, _ = export(capsys, tmp_path / "fits", "--to", "pbrt", "--out", tmp_path / "all.pbrt")
    assert code == 0
    text = (tmp_path / "all.pbrt").read_text(encoding="utf-8")
    assert [text.count(f'MakeNamedMedium "{name}"') for name in ("soap", "soap 2", "wax/½")] == [1, 1, 1]
    assert export(capsys, tmp_path / "fits", "--to", "blender", "--out", tmp_path / "all")[0] == 0
    assert sorted(path.name for path in (tmp_path / "all").iterdir()) == ["soap.py", "soap_2.py", "wax_½.py"]


def test_table_takes_a_folder_of_fits_as_a_library(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        written(tmp_path / "fits" / name / "fit.json", fit_document(material=name))
    assert run(cli, ["table", str(tmp_path / "fits"), "--format", "json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["material"], row["channel"]) for row in rows] == [(name, c) for name in "ab" for c in "RGB"]
    assert run(cli, ["table", str(tmp_path / "fits" / "nothing")]) == 3


def test_empty_folder_and_missing_file_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "nothing").mkdir()
    said = refused(capsys, 3, tmp_path / "nothing", "--to", "pbrt", "--out", tmp_path / "o.pbrt")
    assert "holds no fit.json" in said
    said = refused(capsys, 3, tmp_path / "no.json", "--to", "pbrt", "--out", tmp_path / "o.pbrt")
    assert "does not exist" in said


def test_present_output_is_kept_unless_forced(fit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "o.pbrt"
    out.write_text("mine")
    assert export(capsys, fit, "--to", "pbrt", "--out", out)[0] == 2
    assert out.read_text() == "mine"
    assert export(capsys, fit, "--to", "pbrt", "--out", out, "--force")[0] == 0
