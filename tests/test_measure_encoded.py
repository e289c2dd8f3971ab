"""JPEG frames: refused unless their response curve is asked for, and then measured and flagged."""

import cv2
import numpy as np
import pytest

from bssrdf.cli import cli
from bssrdf.commands.console import BAD_INPUT, run
from bssrdf.session.slice_csv import read_slice

EXPOSURES_MS = [1, 2, 4, 8, 16, 32, 64, 128, 256, 512]
SHAPE, CENTRE, MM_PER_PX = (90, 120), (61.2, 44.7), 0.1
TOTAL = 0.3 * 0.8**2 / (0.8 * 0.6**2)


def light(kind):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    r = MM_PER_PX * np.hypot(x - CENTRE[0], (y - CENTRE[1]) * 2**0.5)
    return {"sample": 0.3 * np.exp(-((r / 0.8) ** 2)), "reference": 0.8 * np.exp(-((r / 0.6) ** 2))}.get(kind, 0 * r)


@pytest.fixture
def jpegs(tmp_path):
    """The frames of a gamma camera, in a folder."""
    folder = tmp_path / "photos"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for kind in ("sample", "reference", "dark"):
        for ms in EXPOSURES_MS:
            electrons = rng.poisson(light(kind) * ms * 1.1e4) + rng.normal(0, 5, SHAPE)
            value = 255 * np.clip(electrons / 1e4, 0, 1) ** (1 / 2.2)
            frame = np.repeat(np.rint(value).astype(np.uint8)[..., None], 3, axis=2)
            cv2.imwrite(str(folder / f"{kind}_{ms}ms.jpg"), frame, [cv2.IMWRITE_JPEG_QUALITY, 100])
    return folder


def complete(session):
    file = session / "session.toml"
    text = file.read_text()
    for old, new in (
        ('"unnamed"', '"wax"'),
        ("eta = 1.3", "eta = 1.4"),
        ("mm_per_px = 0.05", f"mm_per_px = {MM_PER_PX}"),
        ("[0.99, 0.99, 0.99]", "[1.0, 1.0, 1.0]"),
    ):
        assert f"= {old}" in text or f"\n{old}" in text
        text = text.replace(old, new, 1)
    file.write_text(text)


def test_they_are_left_out_and_refused_with_a_line_that_names_the_option(jpegs, tmp_path, capsys):
    assert run(cli, ["ingest", str(jpegs), "--out", str(tmp_path / "s")]) == BAD_INPUT
    assert "--response" in capsys.readouterr().err
    assert run(cli, ["ingest", str(jpegs), "--out", str(tmp_path / "s"), "--response"]) == 0
    file = tmp_path / "s/session.toml"
    file.write_text(file.read_text().replace('response = "debevec"', ""))
    capsys.readouterr()
    assert run(cli, ["measure", str(tmp_path / "s"), "--hdr-only"]) == BAD_INPUT
    error = capsys.readouterr().err.strip()
    assert "ms.jpg: is not linear in light" in error
    assert 'response = "debevec"' in error
    assert "\n" not in error


def test_when_asked_for_they_are_measured_by_their_response_curve_and_flagged(jpegs, tmp_path):
    session = tmp_path / "s"
    assert run(cli, ["ingest", str(jpegs), "--out", str(session), "--response"]) == 0
    complete(session)
    assert run(cli, ["measure", str(session), "--quiet"]) == 0
    curve = read_slice(session / "measured/slice.csv")
    assert "not_linear" in curve.flags
    assert curve.provenance["response"] == "debevec"
    assert curve.total_r["G"] == pytest.approx(TOTAL, rel=0.05)
    part = curve.channels["G"]
    bright = (part.r_mm > 0.3) & (part.r_mm < 1.5)
    truth = 0.3 * np.exp(-((part.r_mm / 0.8) ** 2)) / (np.pi * 0.8 * 0.6**2)
    assert np.sqrt(np.mean((part.rd_per_mm2 / truth - 1)[bright] ** 2)) < 0.06
