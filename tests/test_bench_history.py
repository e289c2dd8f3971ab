"""The history of the bench: every run is kept with its commit, and what became slower is told."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bssrdf.bench.fit import FitScore, ratios
from bssrdf.bench.history import appended
from bssrdf.cli import cli
from bssrdf.commands.console import BAD_INPUT, run
from bssrdf.errors import InputError


def test_runs_are_appended_with_their_commit_and_only_a_slow_down_is_told(tmp_path: Path) -> None:
    file = tmp_path / "history.jsonl"
    for ratio in (4.0, 4.4, 3.8):
        assert appended(file, {"mc soft": ratio, "dipole exact": 9.0}) == []
    (remark,) = appended(file, {"mc soft": 2.0, "dipole exact": 8.9, "new": 1.0})
    assert remark == "mc soft: 2.00 x its peer, 4.00 x before"
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    assert [line["ratios"]["mc soft"] for line in lines] == [4.0, 4.4, 3.8, 2.0]
    assert all(line["commit"] and line["utc"] for line in lines)


def test_a_line_that_is_no_run_is_refused_before_anything_is_timed(tmp_path: Path) -> None:
    file = tmp_path / "history.jsonl"
    file.write_text('{"commit": "a", "ratios": {"mc soft": 2}}\n[1]\n')
    with pytest.raises(InputError, match="line 2 is not a run"):
        appended(file, {"mc soft": 2.0})
    assert run(cli, ["bench", "fit", "--history", str(file)]) == BAD_INPUT
    assert len(file.read_text().splitlines()) == 2


def test_ratios_are_to_scipy_in_the_same_run() -> None:
    scores = [
        FitScore(name, speed, 0, 0, 0, 0, 0) for name, speed in (("a", 30.0), ("scipy least_squares exact", 15.0))
    ]
    assert ratios(scores) == {"a": 2.0, "scipy least_squares exact": 1.0}
