"""`bench scale` and `bench tables` count what they say they count."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from builders import film, of_kinds

from bssrdf.bench.scale import same_bits
from bssrdf.cli import cli
from bssrdf.commands.console import run
from bssrdf.session.records import Camera, Session
from bssrdf.transport import WhiteSamples, batches, merged

RNG = np.random.default_rng(0)


def small(path: Path, _: int) -> None:
    """A session of few pixels in the place of the bench's, whose light takes seconds to draw."""
    y, x = np.mgrid[:90, :120] - np.array([44.7, 61.2])[:, None, None]
    r_mm = 0.1 * np.hypot(x, np.sqrt(2) * y)
    tile = np.exp(-((r_mm / 0.6) ** 2))
    sample = 0.5 * np.exp(-((r_mm / 0.8) ** 2)) + 0.02 * np.exp(-((r_mm / 2) ** 2))
    session = Session(path, Camera("mono", 500, 16383))
    film(session, of_kinds({"sample": sample, "reference": tile}, 1e7), [0.001 * 3**k for k in range(8)], RNG)
    (path / "session.toml").write_text(
        "[camera]\nlayout = 'mono'\nblack = 500\nwhite = 16383\n[material]\nname = 'wax'\neta = 1.4\n"
        "[geometry]\nmm_per_px = 0.1\nview_angle_deg = 45.0\n[reference]\nname = 'tile'\nreflectance = [0.5]\n"
    )


def test_the_bench_of_scale_writes_its_scores_and_names_the_device(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("bssrdf.bench.workers.write_large", small)
    out = tmp_path / "scale"
    few = ["--slices", "2", "--slices", "4", "--files", "4", "--workers", "1", "--sessions", "1", "--rounds", "1"]
    assert run(cli, ["bench", "scale", *few, "--out", str(out)]) == 0
    scores = json.loads((out / "scale.json").read_text())
    assert [score["curves"] for score in scores["bulk"]] == [6, 12]
    assert all(score["seconds"] > 0 and score["fits_seconds"] > 0 for score in scores["bulk"])
    assert "CPU" in scores["device"]
    assert scores["files"]["seconds"] > scores["files"]["fits_seconds"] > 0
    (one,) = scores["workers"]
    assert one["sessions"] == 1
    assert len(one["batch_s"]) == len(one["plain_s"]) == 1
    said = capsys.readouterr().out
    assert "4 slice.csv files: " in said
    assert "(1 rounds of 1) |" in said
    assert (out / "scale.png").stat().st_size > 10_000


def test_tables_walked_on_a_cluster_have_the_bits_of_one_process(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("distributed")
    assert run(cli, ["bench", "tables", "--cluster", "local:2", "--core-seconds", "0.05", "--quiet"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["same_bits"] is True
    assert result["photons"] > 0
    one, same, other = (walked(seed) for seed in (3, 3, 4))
    assert same_bits(one, same)
    assert not same_bits(one, other)


def walked(seed: int) -> WhiteSamples:
    etas, per_batch = np.array([1.3]), np.ones(8, int)
    return merged(0.5, etas, per_batch, [batches(0.5, etas, per_batch, at, seed=seed) or [] for at in range(3)])
