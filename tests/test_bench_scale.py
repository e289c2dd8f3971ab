"""`bench scale` and `bench tables` count what they say they count."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bssrdf.cli import cli
from bssrdf.commands.console import run


def test_the_bench_of_scale_writes_its_scores_and_names_the_device(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    out = tmp_path / "scale"
    options = ["--slices", "2", "--slices", "4", "--files", "3", "--workers", "1", "--out", str(out)]
    assert run(cli, ["bench", "scale", *options]) == 0
    scores = json.loads((out / "scale.json").read_text())
    assert [score["curves"] for score in scores["bulk"]] == [6, 12]
    assert all(score["seconds"] > 0 and score["fits_seconds"] > 0 for score in scores["bulk"])
    assert "CPU" in scores["device"]
    assert scores["workers"][0]["inputs_per_second"] == pytest.approx(3 / scores["workers"][0]["seconds"])
    assert (out / "scale.png").stat().st_size > 10_000
