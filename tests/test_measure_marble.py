"""Simulated sessions of marble, green, in light that no dipole made: what the camera saw is what comes out."""

from pathlib import Path

import numpy as np
import pytest
from builders import film, of_kinds
from scipy.interpolate import make_smoothing_spline

from bssrdf.measure.session import measure_session
from bssrdf.rig.sim.blurred import Radiance
from bssrdf.rig.sim.light import SeenLight
from bssrdf.rig.sim.picture import PictureGeometry, picture
from bssrdf.session.records import Beam, Camera, Geometry, Material, Reference, Session
from bssrdf.transport.discrete_ordinates import half_space
from bssrdf.transport.exit_radiance import transmittance

LIGHT = Path(__file__).parent / "fixtures/marble_green_45deg.csv"
SIGMA_A, SIGMA_SP, ETA, VIEW_DEG = 0.0041, 2.62, 1.5, 45.0
MFP_MM = 1 / (SIGMA_A + SIGMA_SP)
SPOT_MM, MM_PER_PX, SHAPE = 0.2, 0.05, (192, 272)
"""A frame of 13.6 mm square, which 5 % of the light leaves."""
EXPOSURES_S = [0.001 * 2**k for k in range(13)]
BLACK, WHITE, READ_NOISE_E, RHO = 512, 65535, 3.0, 0.99


@pytest.fixture(scope="module")
def marble() -> SeenLight:
    """Monte Carlo light, its noise smoothed over the radius, scaled to the exact total at this angle."""
    lo, hi, light, error = np.loadtxt(LIGHT, delimiter=",", skiprows=4).T
    area, middle = np.pi * (hi**2 - lo**2)[1:], np.sqrt(lo[1:] * hi[1:])
    curve = make_smoothing_spline(
        np.log(middle), np.log(light[1:] / area * middle**1.5), w=(light / error)[1:] ** 2, lam=2.0
    )
    fine = np.concatenate([[0.0], np.geomspace(middle[0], middle[-1], 1000)])
    centre = np.sqrt(fine[1:-1] * fine[2:])
    rings = np.exp(curve(np.log(centre))) * centre**-1.5 * np.pi * np.diff(fine[1:] ** 2)
    seen = half_space(SIGMA_SP / (SIGMA_SP + SIGMA_A), 0.0, ETA, np.cos(np.radians([VIEW_DEG]))).radiance[0]
    total = float(transmittance(ETA, np.array(1.0)) * seen)
    beyond = np.append(np.cumsum(np.append(light[0], rings)[::-1])[::-1], 0.0)
    assert beyond[0] == pytest.approx(total, rel=3e-3)
    return SeenLight(fine, beyond * total / beyond[0])


def tile_picture(view):
    """A white tile that spreads nothing: the spot itself."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    steps = (np.arange(8) - 3.5) / 8
    total = np.zeros(SHAPE)
    for dx in steps:
        for dy in steps:
            r2 = np.sum(np.square(view.surface_mm(x + dx, y + dy)), axis=0)
            total += RHO * 2 / (np.pi * SPOT_MM**2) * np.exp(-2 * r2 / SPOT_MM**2) / 64
    return total


def write_session(path: Path, light: SeenLight, seed: int) -> Session:
    """Glare of 1e-5 of the sample's peak; the same unknown error of up to 3 % on each label of both."""
    rng = np.random.default_rng(seed)
    views = [
        PictureGeometry(SHAPE, MM_PER_PX, VIEW_DEG, centre_px=(136 + dx, 96 + dy), spot_radius_mm=SPOT_MM)
        for dx, dy in rng.uniform(-1, 1, (2, 2))
    ]
    sample = picture(light, views[0])
    pictures = {"sample": sample + 1e-5 * sample.max(), "reference": tile_picture(views[1])}
    e_per_s = 0.7 * (WHITE - BLACK) / EXPOSURES_S[0] / max(image.max() for image in pictures.values())
    label_error = rng.uniform(-0.03, 0.03, len(EXPOSURES_S))
    session = Session(
        path,
        Camera("mono", BLACK, WHITE),
        Material("Marble", ETA),
        Geometry(MM_PER_PX, view_angle_deg=VIEW_DEG, view_angle_sd_deg=0.2, mm_per_px_rel_sd=0.001),
        Beam(channels=("G",), spot_radius_mm=SPOT_MM),
        Reference("tile", (RHO,)),
    )
    true_s = [t * (1 + error) for t, error in zip(EXPOSURES_S, label_error, strict=True)]
    return film(session, of_kinds(pictures, e_per_s), EXPOSURES_S, rng, true_s=true_s, read_noise_e=READ_NOISE_E)


def errors(tmp_path: Path, light: SeenLight, seed: int):
    """Relative errors of R, of the curve from 1 to 20 mfp′, and the curve's stated ones."""
    measured = measure_session(write_session(tmp_path / str(seed), light, seed), glare=True).slice
    part = measured.channels["G"]
    curve = Radiance(light, SPOT_MM, 20.0)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    r = (part.r_hi_mm + part.r_lo_mm) / 2 + np.outer(nodes, part.r_hi_mm - part.r_lo_mm) / 2
    truth = np.sum(weights[:, None] * r * curve(r, np.zeros_like(r)), 0) / np.sum(weights[:, None] * r, 0)
    window = (part.r_mm > MFP_MM) & (part.r_mm < 20 * MFP_MM)
    return (
        measured.total_r["G"] / light.total - 1,
        (part.rd_per_mm2 / truth - 1)[window],
        (part.sd_per_mm2 / truth)[window],
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_a_hard_session_gives_back_the_light(tmp_path, marble, seed):
    total, curve, sd = errors(tmp_path, marble, seed)
    assert abs(total) < 0.003
    assert np.all(np.abs(curve) < np.maximum(0.01, 3 * sd))


def test_glare_that_is_not_asked_to_be_taken_off_is_flagged(tmp_path, marble):
    assert "glare" in measure_session(write_session(tmp_path / "s", marble, 0)).slice.flags


@pytest.mark.slow
def test_twenty_hard_sessions_give_back_the_light(tmp_path, marble):
    every = [errors(tmp_path, marble, seed) for seed in range(20)]
    totals = np.array([total for total, _, _ in every])
    assert np.abs(totals).max() < 0.003
    assert abs(totals.mean()) < 0.001
    for _, curve, sd in every:
        assert np.all(np.abs(curve) < np.maximum(0.01, 3 * sd))
