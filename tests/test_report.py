"""What people read: tables in every format, a fit in words."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace

import pytest

from bssrdf.bench.demo import DemoCell, table_lines
from bssrdf.report.progress import stages, steps
from bssrdf.report.table import combine, fits_table, format_rows
from bssrdf.report.text import fit_text
from bssrdf.session.flags import Flag
from bssrdf.session.records import ChannelFit, Fit

CHANNEL = ChannelFit(
    model="dipole",
    sigma_a_per_mm=0.0021,
    sigma_a_sd_per_mm=0.0001,
    sigma_a_interval95_per_mm=(0.0019, 0.0023),
    sigma_sp_per_mm=2.19,
    sigma_sp_sd_per_mm=0.02,
    sigma_sp_interval95_per_mm=(2.15, 2.23),
    correlation=-0.93,
    total_r_measured=0.83,
    total_r_model=0.826,
    window_mm=(0.5, 12.0),
    n=180,
    chi2_reduced=1.04,
    status="converged",
    model_error={"sigma_a": 0.06, "sigma_sp": 0.02},
)
FIT = Fit("0.1.0", "s/slice.csv", "0" * 64, {}, "marble", 1.5, None, {"R": CHANNEL})
AWKWARD = [{"name": "100 % A_b & | c", "value": 1.5}, {"name": "plain", "value": None}]


def test_csv_and_json_are_read_back() -> None:
    assert json.loads(format_rows(AWKWARD, "json")) == AWKWARD
    assert list(csv.reader(io.StringIO(format_rows(AWKWARD, "csv")))) == [
        ["name", "value"],
        ["100 % A_b & | c", "1.5"],
        ["plain", ""],
    ]


def test_markdown_lines_have_the_same_cells_and_width() -> None:
    lines = format_rows(AWKWARD, "md", note="source").splitlines()
    assert len({len(line) for line in lines[:4]}) == 1
    assert {line.replace(r"\|", "").count("|") for line in lines[:4]} == {3}
    assert lines[-1] == "source"


def test_latex_signs_are_escaped() -> None:
    assert r"100 \% A\_b \& | c & 1.5 \\" in format_rows(AWKWARD, "latex")


def test_a_table_for_a_paper_has_errors_intervals_and_rules() -> None:
    bound = replace(CHANNEL, status="upper_bound")
    lines = fits_table(
        [replace(FIT, material="50 % milk_2", channels={"R": CHANNEL, "G": bound})], "latex"
    ).splitlines()
    assert [line for line in lines if line.startswith(("\\top", "\\mid", "\\bottom"))] == [
        "\\toprule",
        "\\midrule",
        "\\bottomrule",
    ]
    assert r"50 \% milk\_2 & R & $2.190 \pm 0.020$ & 2.15--2.23 & $0.00210 \pm 0.00010$ & 0.0019--0.0023" in lines[4]
    assert "$< 0.0023$" in lines[5]


def test_a_table_of_fits_has_one_row_a_channel_and_nothing_for_nan() -> None:
    unknown = replace(CHANNEL, sigma_a_per_mm=math.nan, status="unidentifiable", flags=("noise",))
    other = replace(FIT, material="slate", channels={"R": CHANNEL, "G": unknown})
    rows = json.loads(fits_table([FIT, other], "json"))
    assert [(row["material"], row["channel"]) for row in rows] == [("marble", "R"), ("slate", "R"), ("slate", "G")]
    assert rows[0]["sigma_a_per_mm"] == 0.0021
    assert rows[2]["sigma_a_per_mm"] is None
    assert rows[2]["flags"] == "noise"


def test_a_repeat_that_tells_nothing_takes_nothing_from_the_others() -> None:
    unknown = replace(CHANNEL, sigma_a_per_mm=math.nan, total_r_model=math.nan, status="rejected")
    (row,) = json.loads(fits_table([FIT, replace(FIT, channels={"R": unknown})], "json"))
    assert row["r"] == CHANNEL.total_r_model


def test_a_fit_in_words_gives_the_digits_that_the_error_carries() -> None:
    text = fit_text(FIT)
    assert "σs′ 2.190 ± 0.020/mm" in text
    assert "σa 0.00210 ± 0.00010/mm" in text
    assert "2 % in σs′ and 6 % in σa" in text


@pytest.mark.parametrize(
    ("status", "shown", "hidden"),
    [("upper_bound", "σa < 0.0023/mm", "±  0"), ("unidentifiable", "unidentifiable", "σa"), ("failed", "failed", "σa")],
)
def test_a_fit_in_words_shows_no_number_that_must_not_be_used(status: str, shown: str, hidden: str) -> None:
    channel = replace(CHANNEL, status=status, chi2_reduced=math.nan)
    text = fit_text(replace(FIT, channels={"R": channel}))
    assert shown in text
    assert hidden not in text
    assert "nan" not in text


def test_each_flag_is_explained_once_with_its_channels() -> None:
    flagged = replace(CHANNEL, flags=("poor_fit",))
    text = fit_text(replace(FIT, channels={"R": flagged, "G": CHANNEL, "B": flagged}))
    assert " ".join(text.split()).count(Flag.POOR_FIT.meaning) == 1
    assert "R, B: poor_fit" in text


def test_quiet_progress_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with steps(quiet=True) as step, stages("work", quiet=True) as stage:
        step("merge", 1, 2)
        stage("now")
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


def test_progress_goes_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    with steps(quiet=False) as step:
        step("merge", 1, 2)
    assert capsys.readouterr().out == ""


def test_repeats_are_one_row_whose_error_grows_where_they_disagree() -> None:
    def repeat(sigma_sp: float) -> Fit:
        return replace(FIT, channels={"R": replace(CHANNEL, sigma_sp_per_mm=sigma_sp)})

    (agree,) = json.loads(fits_table([repeat(2.18), repeat(2.20)], "json"))
    (disagree,) = json.loads(fits_table([repeat(2.0), repeat(2.4)], "json"))
    assert agree["n"] == disagree["n"] == 2
    assert agree["sigma_sp_per_mm"] == pytest.approx(2.19)
    assert disagree["sigma_sp_per_mm"] == pytest.approx(2.2)
    assert agree["inflation_sigma_sp"] == 1
    assert agree["sigma_sp_sd_per_mm"] == pytest.approx(0.02 / 2**0.5, rel=0.02)
    assert disagree["inflation_sigma_sp"] == pytest.approx(0.2 * 2**0.5 / 0.02, rel=0.01)
    assert disagree["sigma_sp_sd_per_mm"] == pytest.approx(0.2, rel=0.01)


def test_repeats_without_errors_are_averaged_and_their_spread_is_the_error() -> None:
    combined = combine([1.0, 3.0, math.nan], [math.nan, math.nan, math.nan])
    assert (combined.n, combined.mean) == (2, 2.0)
    assert combined.sd == pytest.approx(1.0)
    assert combine([], []).n == 0


def test_the_table_of_the_demonstration_fits_a_terminal() -> None:
    widest = DemoCell(
        "Spectralon", "G", "sigma_a", "mc", 0.0041, 6.9e-05, 7.91e-05, 7.19e-05, 8.69e-05, "converged", ()
    )
    cells = [
        replace(widest, quantity=quantity, model=model)
        for quantity in ("sigma_sp", "sigma_a")
        for model in ("mc", "dipole")
    ]
    lines = table_lines(cells)
    assert max(map(len, lines)) <= 80
    assert "7.19e-05–8.69e-05 ✗" in "".join(lines)
