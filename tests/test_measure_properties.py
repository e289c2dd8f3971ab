"""Laws of merge and slice for drawn cameras, brackets and curves, and for broken files."""

import re
from pathlib import Path

import numpy as np
import pytest
from builders import film, of_kinds
from hypothesis import given, settings
from hypothesis import strategies as st

from bssrdf.calib.sensor import Sensor
from bssrdf.cli import cli
from bssrdf.commands.console import BAD_INPUT, run
from bssrdf.measure.hdr import NO_DATA, SATURATED, DarkPaired, Shot, merge
from bssrdf.measure.profile import Points, bin_edges, profile
from bssrdf.session.records import Beam, Camera, Geometry, Material, Reference, Session
from bssrdf.session.session_toml import write_session
from bssrdf.session.slice_csv import read_slice

SHAPE = (24, 32)


@st.composite
def brackets(draw):
    """A sensor, a smooth scene [DN/s] and its shots, in any order, some exposures taken twice."""
    white = draw(st.sampled_from([1023, 4095, 65535]))
    sensor = Sensor(draw(st.floats(0, white / 4)), 0.98 * white, draw(st.floats(0.2, 8)), draw(st.floats(0, 20)))
    seconds = draw(st.lists(st.floats(1e-4, 10), min_size=1, max_size=6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    peak = draw(st.floats(0.01, 10)) * (white - sensor.black_dn) / min(seconds)
    radiance = np.broadcast_to(peak * np.logspace(0, -4, SHAPE[1]), SHAPE)

    def frame(light):
        electrons = rng.poisson(light * sensor.gain_e_per_dn) + rng.normal(0, sensor.read_noise_e, SHAPE)
        return np.clip(np.rint(electrons / sensor.gain_e_per_dn + sensor.black_dn), 0, white).astype(np.uint16)

    shots = []
    for number, t in enumerate(draw(st.permutations([*seconds, seconds[0]]))):
        sample = DarkPaired(frame(radiance * t), frame(0 * radiance), 1)
        shots.append(Shot(f"{number}", t, lambda sample=sample: sample))
    return sensor, radiance, shots


@settings(max_examples=40, deadline=None)
@given(brackets())
def test_a_merge_is_a_number_with_an_error_wherever_a_sample_was_good(bracket):
    sensor, radiance, shots = bracket
    good = np.sum([shot.load().raw < sensor.saturation_dn for shot in shots], axis=0)
    if not good.any():
        return
    image = merge(shots, sensor)
    np.testing.assert_array_equal(image.count, good)
    np.testing.assert_array_equal(image.mask == SATURATED | NO_DATA, good == 0)
    used = good > 0
    assert np.all(np.isfinite(image.radiance[used]))
    assert np.all(image.variance[used] > 0)
    assert np.all(np.isnan(image.radiance[~used]))
    backwards = merge(shots[::-1], sensor)
    np.testing.assert_array_equal(image.radiance, backwards.radiance)
    untouched = good == len(shots)
    pull = (image.radiance - radiance)[untouched] / np.sqrt(image.variance[untouched])
    assert np.all(np.abs(pull) < 8)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.3, 4), st.floats(0, 0.5), st.floats(0.02, 0.1), st.sampled_from([None, 0.5, 2.0]), st.integers(0, 99)
)
def test_bins_hold_the_curve_whatever_its_fall_and_the_grid_and_a_glint_changes_nothing(fall, skirt, px, band, seed):
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-0.5, 0.5, 2)
    y, x = np.mgrid[-70:71, -90:91].astype(float)
    across, along = px * (x - centre[0]).ravel(), px * 2**0.5 * (y - centre[1]).ravel()

    def curve(r):
        return np.exp(-fall * r) + skirt / (1 + r) ** 3

    value = curve(np.hypot(across, along))
    if band is not None:
        near = np.abs(along) < band / 2
        across, along, value = across[near], along[near], value[near]
    edges = bin_edges(px, 80 * px)
    points = Points(across, along, value, (1e-3 * value) ** 2, np.ones_like(value))
    plain = profile(points, edges, (px, px * 2**0.5), band)
    assert np.all(plain.r_hi > plain.r_lo)
    assert np.all(np.diff(plain.r) > 0)
    outer = plain.r > 4 * px
    nodes, weights = np.polynomial.legendre.leggauss(5)
    r = (plain.r_hi + plain.r_lo) / 2 + np.outer(nodes, plain.r_hi - plain.r_lo) / 2
    truth = np.sum(weights[:, None] * r * curve(r), 0) / np.sum(weights[:, None] * r, 0)
    np.testing.assert_allclose(plain.value[outer], truth[outer], rtol=0.02)
    value = value.copy()
    value[rng.integers(len(value))] += 100
    glint = profile(points._replace(value=value), edges, (px, px * 2**0.5), band)
    np.testing.assert_allclose(glint.value[outer], plain.value[outer], rtol=0.02)


def small_session(path: Path) -> list[Path]:
    """A small session on disk; its frames."""
    y, x = np.mgrid[:60, :80]
    r = 0.1 * np.hypot(x - 40, (y - 30) * 2**0.5)
    pictures = {"sample": 0.2 * np.exp(-r / 0.5), "reference": np.exp(-((r / 0.4) ** 2))}
    session = Session(
        path,
        Camera("mono", black=500),
        Material("wax", 1.4),
        Geometry(0.1),
        Beam(spot_radius_mm=0.4),
        Reference("tile", (0.99,)),
    )
    film(session, of_kinds(pictures, 3e6), (0.01, 0.04, 0.16, 0.64), np.random.default_rng(0))
    write_session(path, session)
    return sorted((path / "frames").iterdir())


def test_a_sample_brighter_than_white_is_an_error(tmp_path, capsys):
    small_session(tmp_path / "s")
    file = tmp_path / "s/session.toml"
    file.write_text(file.read_text().replace("[0.99]", "[1.19]").replace('"wax"', '"a lamp"'))
    frames = tmp_path / "s/frames.csv"
    swapped = {"reference": "sample", "sample": "reference"}
    frames.write_text(re.sub(r"(?<=,)(sample|reference)", lambda kind: swapped[kind[0]], frames.read_text()))
    assert run(cli, ["measure", str(tmp_path / "s"), "--quiet"]) == BAD_INPUT
    assert "is beyond what a sample can reflect" in capsys.readouterr().err


def test_a_band_without_pixels_is_an_error(tmp_path, capsys):
    small_session(tmp_path / "s")
    assert run(cli, ["measure", str(tmp_path / "s"), "--quiet", "--band-mm", "1e-9"]) == BAD_INPUT
    assert "widen --band-mm" in capsys.readouterr().err


@pytest.mark.parametrize("seed", range(8))
def test_a_broken_frame_is_refused_with_one_line_or_measured(tmp_path, capsys, seed):
    rng = np.random.default_rng(seed)
    victim = rng.choice(small_session(tmp_path / "s"))
    content = bytearray(victim.read_bytes())
    if seed % 2:
        content = content[: rng.integers(len(content))]
    for at in rng.integers(len(content), size=20) if content else ():
        content[at] ^= 1 << rng.integers(8)
    victim.write_bytes(content)
    code = run(cli, ["measure", str(tmp_path / "s"), "--quiet"])
    if code == 0:
        curve = read_slice(tmp_path / "s/measured/slice.csv")
        assert np.all(np.isfinite(curve.channels["mono"].rd_per_mm2))
    else:
        assert code == BAD_INPUT
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
        assert not (tmp_path / "s/measured").exists()
