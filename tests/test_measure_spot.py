"""The beam's radius: from a knife edge, and from its spot on a tile that spreads light."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.special import erf

from bssrdf.calib.beam_radius import knife_edge_radius
from bssrdf.calib.surface import Surface
from bssrdf.cli import cli
from bssrdf.commands.console import BAD_INPUT, WRONG_USAGE, run
from bssrdf.errors import InputError
from bssrdf.measure.hdr import Hdr
from bssrdf.measure.image import Image, beam_on_tile, spot_radius_mm
from bssrdf.session.records import Geometry
from bssrdf.session.session_toml import read_calibration

SPREAD = Path(__file__).parent / "fixtures/tile_spread.csv"
VIEW_DEG, MFP_MM, PHOTONS = 45.0, 0.086, 4_000_000
SHAPE = (240, 320)


def tile_image(radius_mm, mm_per_px):
    """Photons that land in a Gaussian spot and wander in the tile, counted by the pixels of a Bayer mosaic."""
    rng = np.random.default_rng(1)
    r_mfp, beyond = np.loadtxt(SPREAD, delimiter=",").T
    r = MFP_MM * np.interp(rng.random(PHOTONS), beyond[::-1], r_mfp[::-1])
    azimuth = rng.uniform(0, 2 * np.pi, PHOTONS)
    x, y = r * np.array([np.cos(azimuth), np.sin(azimuth)]) + rng.normal(0, radius_mm / 2, (2, PHOTONS))
    column = np.rint(x / mm_per_px + 160.3)
    row = np.rint(y * np.cos(np.radians(VIEW_DEG)) / mm_per_px + 119.8)
    edges = [np.arange(n + 1) - 0.5 for n in SHAPE]
    light = np.histogram2d(row, column, edges)[0].astype(np.float32)
    nothing = np.zeros(SHAPE, np.uint8)
    geometry = Geometry(mm_per_px, view_angle_deg=VIEW_DEG)
    hdr = Hdr(light, np.maximum(light, 1), nothing + 1, nothing)
    return Image("reference", hdr, "RGGB", tuple("RGB"), Surface(geometry))


@pytest.mark.parametrize(("radius_mm", "mm_per_px"), [(0.15, 0.05), (0.3, 0.1)])
def test_the_spread_of_the_tile_is_taken_off(radius_mm, mm_per_px):
    image = tile_image(radius_mm, mm_per_px)
    spot = image.spot
    found = beam_on_tile(image, spot, VIEW_DEG)
    assert spot_radius_mm(image, spot) > 1.3 * radius_mm
    assert found.value == pytest.approx(radius_mm, rel=0.1)
    assert abs(found.value - radius_mm) < 2 * found.sd < 0.2 * radius_mm


def test_a_spot_on_an_opaque_target_is_as_wide_as_the_beam(tmp_path):
    y, x = np.mgrid[:100, :140]
    along = (y - 52.3) * 2**0.5
    light = 3000 * np.exp(-2 * (0.03 / 0.15) ** 2 * ((x - 70.4) ** 2 + along**2)) + 100
    tifffile.imwrite(tmp_path / "spot.tif", np.random.default_rng(0).poisson(light).astype(np.uint16))
    out = str(tmp_path / "calibration.toml")
    assert run(cli, ["calibrate", "spot", str(tmp_path / "spot.tif"), "--mm-per-px", "0.03", "--out", out]) == 0
    assert read_calibration(tmp_path / "calibration.toml")["beam"]["spot_radius_mm"] == pytest.approx(0.15, rel=0.03)


def test_what_cannot_tell_a_spot_is_refused_with_one_line(tmp_path, capsys):
    edge, image, out = (tmp_path / name for name in ("edge.csv", "spot.tif", "calibration.toml"))
    edge.write_text("position_mm,light\n0,1\n0.1,x\n")
    tifffile.imwrite(image, np.full((40, 40), 65535, np.uint16))
    assert run(cli, ["calibrate", "spot", str(edge), "--out", str(out)]) == BAD_INPUT
    assert run(cli, ["calibrate", "spot", str(image), "--mm-per-px", "0.03", "--out", str(out)]) == BAD_INPUT
    assert run(cli, ["calibrate", "spot", str(image), "--out", str(out)]) == WRONG_USAGE
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 3
    assert "edge.csv: contains a value that is not a number" in lines[0]
    assert "spot.tif: is saturated in the spot" in lines[1]
    assert "--mm-per-px" in lines[2]
    assert not out.exists()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_knife_edge_gives_the_radius(sign):
    x = np.linspace(-0.6, 0.8, 40)
    light = 5 + 100 * (1 + erf(sign * np.sqrt(2) * (x - 0.07) / 0.21)) / 2
    noisy = light + np.random.default_rng(0).normal(0, 0.3, x.shape)
    assert knife_edge_radius(x, noisy) == pytest.approx(0.21, rel=0.03)
    with pytest.raises(InputError, match="at least five"):
        knife_edge_radius(x[:4], noisy[:4])
