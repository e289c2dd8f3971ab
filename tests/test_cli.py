"""The command line as a user meets it: options, exit codes, JSON lines, and one line for an error."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest

from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.errors import DeviceError
from bssrdf.session.slice_csv import HEADER
from bssrdf.transport.dipole import Medium, rd, total_r
from bssrdf.transport.precision import scoped_x64

HEAVY = ("cv2", "jax", "matplotlib", "mitsuba", "numba", "rawpy")


@scoped_x64
def dipole_slice(channels: str = "RG", n: int = 40, *, with_total: bool = True) -> str:
    """slice.csv of a medium of the dipole, 1 % errors. With its total_r all tests compile the same kernel."""
    medium = Medium(0.02, 1.0, 1.4)
    rows = [
        f"{channel},{r!r},{value!r},{value / 100!r}"
        for channel in channels
        for r, value in [(float(r), float(rd(medium, r))) for r in np.linspace(1, 20, n)]
    ]
    head = '# eta = 1.4\n# flux = "entering"\n# exit = "hemisphere"\n'
    if with_total:
        head += f"# total_r = {float(total_r(medium))!r}\n"
    return "\n".join([f"{head}channel,r_mm,rd_per_mm2,sd_per_mm2", *rows, ""])


@scoped_x64
def dipole_total() -> float:
    return float(total_r(Medium(0.02, 1.0, 1.4)))


@pytest.fixture
def good(tmp_path: Path) -> Path:
    file = tmp_path / "good.csv"
    file.write_text(dipole_slice())
    return file


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """Too few radii to fit."""
    file = tmp_path / "short.csv"
    file.write_text(dipole_slice("G", 3))
    return file


def bssrdf(*arguments: object) -> int:
    return run(cli, [str(argument) for argument in arguments])


def lines(capsys: pytest.CaptureFixture[str]) -> tuple[list[str], list[str]]:
    captured = capsys.readouterr()
    return captured.out.splitlines(), captured.err.splitlines()


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_help_imports_nothing_heavy() -> None:
    shown = python(f"""
import sys
from bssrdf.cli import cli
from bssrdf.commands.console import run
for arguments in [[], *([name] for name in cli.commands)]:
    assert run(cli, [*arguments, "--help"]) == 0
assert not set({HEAVY!r}) & set(sys.modules), set({HEAVY!r}) & set(sys.modules)
""")
    assert all(f"bssrdf {name}" in shown for name in cli.commands)


def test_fit_imports_little_more_than_jax(good: Path) -> None:
    code = f"""
import sys
from bssrdf.cli import cli
from bssrdf.commands.console import run
assert run(cli, ["fit", {str(good)!r}, "--model", "dipole"]) == 0
heavy = {{"cv2", "matplotlib", "numba", "rawpy"}} & set(sys.modules)
assert not heavy, heavy
"""
    python(code)


def test_measure_imports_no_matplotlib_no_jax_and_no_rig() -> None:
    python("""
import sys
import bssrdf.commands.measure, bssrdf.report.progress, bssrdf.measure.session
heavy = {"jax", "matplotlib", "bssrdf.rig"} & set(sys.modules)
assert not heavy, heavy
""")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    import bssrdf as package

    assert bssrdf("--version") == 0
    assert package.__version__ in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [["fit"], ["nonsense"], ["fit", "a.csv", "b.csv", "--out", "fit.json"], ["fit", "a.csv", "--eta", "x"]]
)
def test_wrong_usage_is_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert bssrdf(*arguments) == 2
    assert capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (DeviceError("shutter"), 4),
        (RuntimeError("oops"), 1),
        (KeyboardInterrupt(), 130),
        (PermissionError(13, "No"), 3),
    ],
)
def test_what_goes_wrong_is_one_line_and_an_exit_code(
    error: BaseException, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("bssrdf.session.verify_session", fail)
    assert bssrdf("verify", "somewhere") == code
    _, err = lines(capsys)
    assert len([line for line in err if line]) == 1


@pytest.mark.parametrize("arguments", [["--debug", "verify", "nowhere"], ["verify", "nowhere", "--debug"]])
def test_debug_shows_the_traceback_before_and_after_the_command(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert bssrdf(*arguments) == 3
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--quiet", "init"], ["init", "--quiet"]])
def test_quiet_is_taken_before_and_after_the_command(arguments: list[str], tmp_path: Path) -> None:
    assert bssrdf(*arguments, tmp_path / "s") == 0


@pytest.mark.skipif(sys.platform == "win32", reason="pipes end differently there")
def test_a_reader_that_has_had_enough_is_no_failure() -> None:
    code = "from bssrdf.cli import main; main(['init', '--help'])"
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert child.stdout
    child.stdout.close()
    _, err = child.communicate(timeout=60)
    assert (child.returncode, err) == (0, b"")


def test_an_output_that_exists_is_refused_without_force(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = good.with_name("fit.json")
    out.write_text("mine")
    assert bssrdf("fit", good, "--out", out) == 2
    assert out.read_text() == "mine"
    assert "--force" in capsys.readouterr().err
    assert bssrdf("fit", good, "--out", out, "--force") == 0
    assert json.loads(out.read_text())["format"] == 1


def test_a_lone_slice_is_fitted_without_leaving_a_file(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bssrdf("fit", good, "--model", "dipole") == 0
    out, err = lines(capsys)
    assert any(line.lstrip().startswith("R ") and "σs′ 1.00" in line for line in out)
    assert not err
    assert [file.name for file in good.parent.iterdir()] == [good.name]


def test_json_is_one_object_a_line_with_errors_in_their_place(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text(dipole_slice().replace("# eta = 1.4\n", ""))
    missing = tmp_path / "missing.csv"
    assert bssrdf("fit", bad, good, missing, good, "--json", "--model", "dipole") == 3
    out, err = lines(capsys)
    answers = [json.loads(line) for line in out]
    assert [answer["input"]["path"] for answer in answers] == [str(bad), str(good), str(missing), str(good)]
    assert [set(answer) == {"format", "input", "error"} for answer in answers] == [True, False, True, False]
    assert answers[0]["error"]["code"] == 3
    assert "eta" in answers[0]["error"]["message"]
    assert answers[1] == answers[3]
    assert not err


def test_options_that_one_slice_cannot_meet_do_not_stop_the_others(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    without = tmp_path / "without.csv"
    without.write_text(dipole_slice(with_total=False))
    assert bssrdf("fit", without, good, "--json", "--constraint", "exact", "--model", "dipole") == 3
    failed, fitted = (json.loads(line) for line in lines(capsys)[0])
    assert str(without) in failed["error"]["message"]
    assert "total_r" in failed["error"]["message"]
    assert fitted["channels"]["R"]["sigma_sp_per_mm"] == pytest.approx(1.0, rel=1e-3)


def test_strict_tells_what_is_unidentifiable(good: Path, short: Path) -> None:
    assert bssrdf("fit", short, "--model", "dipole") == 0
    assert bssrdf("fit", short, "--model", "dipole", "--strict") == 5
    assert bssrdf("fit", good, "--model", "dipole", "--strict") == 0


@pytest.mark.parametrize("total", [["--total-r", "{}"], ["--total-r", "R={}", "--total-r", "G={}"]])
def test_keys_of_the_slice_are_taken_from_the_command_line(
    total: list[str], good: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good.write_text(dipole_slice(with_total=False))
    total = [text.format(dipole_total()) for text in total]
    arguments = ["--model", "dipole", "--eta", "1.4", "--material", "wax", "--json"]
    assert bssrdf("fit", good, *total, *arguments) == 0
    fit = json.loads(lines(capsys)[0][0])
    assert fit["material"] == "wax"
    assert fit["channels"]["G"]["total_r_measured"] == pytest.approx(dipole_total())
    assert fit["channels"]["G"]["sigma_a_per_mm"] == pytest.approx(0.02, rel=1e-3)


def test_a_session_is_fitted_into_its_folder_and_a_change_since_is_warned_about(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "s"
    (session / "measured").mkdir(parents=True)
    slice_file = session / "measured" / "slice.csv"
    slice_file.write_text(dipole_slice())
    assert bssrdf("fit", session, "--model", "dipole") == 0
    assert json.loads((session / "fit.json").read_text())["input"]["path"] == str(slice_file)
    capsys.readouterr()
    assert bssrdf("table", session) == 0
    assert not lines(capsys)[1]
    slice_file.write_text(dipole_slice() + "\n")
    assert bssrdf("table", session, "--format", "csv") == 0
    out, err = lines(capsys)
    assert len(out) == 3
    assert len(err) == 1
    assert "changed" in err[0]


def test_a_session_that_was_not_measured_says_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bssrdf("init", tmp_path / "s") == 0
    assert bssrdf("fit", tmp_path / "s") == 3
    assert "bssrdf measure" in lines(capsys)[1][0]


def test_the_published_table_is_checked_against_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert bssrdf("table", "--format", "json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert len(rows) == 36
    for row in rows:
        assert row["difference"] == pytest.approx(row["r_computed"] - row["r_published"], abs=1e-4)
    assert bssrdf("table") == 0
    assert "Jensen" in capsys.readouterr().out


def test_every_key_of_a_slice_is_an_option_of_fit() -> None:
    command = cli.commands["fit"]
    options = {parameter.name for parameter in command.get_params(click.Context(command))}
    assert HEADER.keys() - {"flags", "provenance"} <= options


def commands_of(group: click.Group, path: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], click.Group]]:
    """Every group, with the words that lead to it."""
    found = [(path, group)]
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            found += commands_of(command, (*path, name))
    return found


def test_help_stays_within_80_columns_and_every_summary_is_whole(capsys: pytest.CaptureFixture[str]) -> None:
    for path, group in commands_of(cli):
        assert run(cli, [*path, "--help"]) == 0
        listed = capsys.readouterr().out
        assert max(map(len, listed.splitlines())) <= 80
        assert "..." not in listed.split("Commands:")[1], path
        for name in group.commands:
            assert run(cli, [*path, name, "--help"]) == 0
            assert max(map(len, capsys.readouterr().out.splitlines())) <= 80, (*path, name)


def test_results_stay_within_80_columns(good: Path, short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fits = [good.with_suffix(".json"), short.with_suffix(".json")]
    for slice_, fit in zip((good, short), fits, strict=True):
        assert bssrdf("fit", slice_, "--model", "dipole", "--material", "Skin of an apple", "--out", fit) == 0
    assert bssrdf("table", *fits) == 0
    assert bssrdf("table") == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 80


@pytest.mark.parametrize("module", ["jinja2", "cv2", "matplotlib", "rawpy", "OpenImageIO", "jax", "serial", "colour"])
def test_a_library_that_is_missing_hurts_only_what_needs_it(module: str, good: Path, tmp_path: Path) -> None:
    """Fits run without any of them; a command that needs one names it and goes without a traceback."""
    code = "import sys; sys.modules[sys.argv[1]] = None; from bssrdf.cli import main; main(sys.argv[2:])"

    def done(*words: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", code, module, *map(str, words)], capture_output=True, text=True, timeout=120
        )

    assert done("--help").returncode == 0
    fitted = done("fit", good, "--model", "mc", "--eta", "1.4", "--out", tmp_path / "fit.json")
    assert fitted.returncode == 0, fitted.stderr
    if module == "jinja2":
        refused = done("report", tmp_path / "fit.json", "--out", tmp_path / "page.html")
        assert refused.returncode == 3
        assert refused.stderr.startswith("bssrdf: jinja2 cannot be imported")
        assert len(refused.stderr.splitlines()) == 1
