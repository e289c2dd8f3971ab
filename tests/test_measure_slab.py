"""Sessions of 10 mm of skim milk on black, in light of walks: filmed, measured and fitted it is the milk again."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import film, of_kinds
from scipy.integrate import quad

from bssrdf.fit import FitOptions, fit_slice
from bssrdf.holding import Held
from bssrdf.measure.holder import Holder
from bssrdf.measure.session import measure_session
from bssrdf.measure.tail import Boundary, Surroundings, Tail, TailOfSample
from bssrdf.rig.sim.launch import simulated_bench
from bssrdf.rig.sim.light import SeenLight, seen_light
from bssrdf.rig.sim.media import SimSample, published_sample, white_tile
from bssrdf.rig.sim.picture import PictureGeometry, picture
from bssrdf.rig.sim.scene import BenchScene
from bssrdf.session.records import Beam, Camera, ChannelFit, Geometry, Material, Reference, Session, Slice
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.discrete_ordinates import decay_constant
from bssrdf.transport.finite import Sample, log_ratio

MILK = published_sample("Skimmilk").slab(10.0, back=0.0).media
SPOT_MM, VIEW_DEG = 0.4, 45.0
BOUNDARY = Boundary(2.5, 0.9)
EXPOSURES_S = [0.001 * 2**k for k in range(13)]
SLAB = {"thickness_mm": 10.0, "thickness_sd_mm": 0.05, "backing": 0.0, "backing_sd": 0.002}
PLAN = """\
settle_s = 0.02
[material]
name = "Skimmilk"
eta = 1.3
g = 0.0
thickness_mm = 10
thickness_sd_mm = 0.05
backing = 0.0
backing_sd = 0.002
[exposures]
auto = true
"""


def light_of(channel: str) -> SeenLight:
    return seen_light(MILK[channel], VIEW_DEG, photons=1, seed=1)


def measured(
    path: Path, channel: str, *, shape: tuple[int, int], glare: float = 0.0, keys: dict[str, Any] = SLAB
) -> Slice:
    """The slice of a frame of this shape [0.15 mm]; `glare` is that of the pictures and is taken off."""
    rng = np.random.default_rng(3)
    view = PictureGeometry(shape, 0.15, VIEW_DEG, spot_radius_mm=SPOT_MM)
    white = seen_light(white_tile().media["G"], VIEW_DEG, photons=1, seed=1)
    pictures = {"sample": picture(light_of(channel), view, glare), "reference": picture(white, view)}
    e_per_s = 45000 / EXPOSURES_S[0] / max(each.max() for each in pictures.values())
    session = Session(
        path,
        Camera("mono", 512.0, 65535.0),
        Material("Skimmilk", 1.3, 0.0, **keys),
        Geometry(0.15, view_angle_deg=VIEW_DEG, view_angle_sd_deg=0.2, mm_per_px_rel_sd=0.001),
        Beam(channels=(channel,), spot_radius_mm=SPOT_MM),
        Reference("tile", (white.total,), reflectance_sd=(0.001,), coplanar=True),
    )
    film(session, of_kinds(pictures, e_per_s), EXPOSURES_S, rng)
    return measure_session(session, glare=glare > 0).slice


def holds(truth: float, fit: ChannelFit | dict[str, Any], widths: float = 1.0) -> bool:
    """Whether σa lies in its interval, as wide as this and widened by the model error."""
    by = fit if isinstance(fit, dict) else vars(fit)
    found, (low, high) = by["sigma_a_per_mm"], by["sigma_a_interval95_per_mm"]
    room = by["model_error"]["sigma_a"] * found
    return bool(found - widths * (found - low) - room <= truth <= found + widths * (high - found) + room)


@pytest.mark.parametrize("channel", MILK)
def test_milk_on_black_is_fitted_back(channel: str, tmp_path: Path) -> None:
    piece = measured(tmp_path / "s", channel, shape=(240, 340))
    assert piece.total_r[channel] == pytest.approx(light_of(channel).total, rel=3e-3)
    fit = fit_slice(piece, FitOptions(model="mc", tables="shipped"))[channel]
    assert fit.sigma_sp_per_mm == pytest.approx(MILK[channel].sigma_sp, rel=0.01)
    assert fit.sigma_a_per_mm == pytest.approx(MILK[channel].sigma_a, rel=0.2)
    assert holds(MILK[channel].sigma_a, fit, 1.5)  # of three
    assert ("thin_sample" in fit.flags) == (channel == "R")


@pytest.mark.parametrize("glare", [0.0, 3e-3])
def test_light_beyond_a_narrow_frame_is_a_slab_s(glare: float, tmp_path: Path) -> None:
    """8 % of it, of which a half space's tail makes 12 %."""
    told, untold = (
        measured(tmp_path / str(len(keys)), "R", shape=(100, 140), glare=glare, keys=keys) for keys in (SLAB, {})
    )
    total = (1 - glare) * light_of("R").total
    assert told.total_r["R"] == pytest.approx(total, rel=4e-3)
    assert untold.total_r["R"] > 1.04 * total


HOLDERS = {
    "on black": Held("slab", 10.0, 0.0),
    "on white": Held("slab", 10.0, 0.9),
    "cup": Held("dish", 10.0, 0.0, 25.0, 0.0),
    "deep glass": Held("dish", np.inf, 0.0, 15.0, 0.3),
}


@pytest.mark.parametrize("name", HOLDERS)
def test_the_outer_light_is_that_of_the_fit_and_adds_up(name: str) -> None:
    held, mfp, sigma_tr = HOLDERS[name], 0.8, 0.05
    holder = Holder(held, 1.3)
    n_modes = holder.modes(2.0)
    assert n_modes is not None
    tail = TailOfSample(1.0, sigma_tr, mfp, 0.0, BOUNDARY, holder, n_modes)
    r = np.array([3.0, 6.0, 9.0, 12.0, 14.0])
    sample = Sample(*(np.array([[each]]) for each in (holder.thickness, held.back, held.radius, held.wall)))
    place = np.array([[-np.log(mfp)]]), np.array([[sigma_tr * mfp]]), r[None]
    ratio = np.exp(log_ratio(NUMPY, held.kind == "dish", sample, holder.top, *place)[0][0])
    np.testing.assert_allclose(tail(r), ratio * Tail(1.0, sigma_tr, mfp, 0.0, BOUNDARY)(r), rtol=5e-4)
    assert not np.any(tail(np.array([30.0]))) or held.kind == "slab"
    angle = np.linspace(0, 2 * np.pi, 361)
    beyond = quad(lambda at: 2 * np.pi * at * tail(np.array([at]))[0], 8.0, min(held.radius, 200.0), limit=200)[0]
    assert tail.beyond((8 * np.cos(angle), 8 * np.sin(angle))) == pytest.approx(beyond, rel=1e-4)
    assert tail.beyond((30 * np.cos(angle), 30 * np.sin(angle))) < (1e-12 if held.kind == "dish" else beyond)


def test_a_sample_deeper_than_light_goes_has_the_tail_of_a_half_space() -> None:
    deep = Holder(Held("slab", 60.0, 0.0), 1.3)
    n_modes = deep.modes(2.0)
    assert n_modes is not None
    tail, half = TailOfSample(1.0, 0.4, 0.8, 0.0, BOUNDARY, deep, n_modes), Tail(1.0, 0.4, 0.8, 0.0, BOUNDARY)
    square = np.array([8.0, 8.0, -8.0, -8.0, 8.0]), np.array([-8.0, 8.0, 8.0, -8.0, -8.0])
    np.testing.assert_allclose(tail(np.array([3.0, 20.0])), half(np.array([3.0, 20.0])), rtol=1e-5)
    assert tail.beyond(square) == pytest.approx(half.beyond(square), rel=1e-4)
    assert Holder(Held("slab", 6000.0, 0.0), 1.3).modes(2.0) is None


@pytest.mark.parametrize("g", [0.0, 0.5, 0.9])
def test_the_attenuation_of_a_total_is_that_of_the_medium_which_has_it(g: float) -> None:
    around = Surroundings(1.4, g, VIEW_DEG, 0.0)
    for total in (0.02, 0.2, 0.6, 0.9, 0.99):
        loss = around.loss(total)
        scattering = (1 - loss) / (1 - g)
        kappa = decay_constant(scattering / (scattering + loss), g) * (scattering + loss)
        assert around.attenuation(total) == pytest.approx(kappa, rel=1e-6)


def test_a_slab_s_total_tells_less_attenuation_than_a_half_space_s() -> None:
    """What the back takes is not taken for absorption, and does not count where mean free paths are short."""
    around = Surroundings(1.3, 0.0, VIEW_DEG, 0.0)
    half = around.attenuation(0.7)
    told = around._replace(held=HOLDERS["on black"]).attenuation_by_mfp(0.7)
    assert around.attenuation_by_mfp(0.7)(1.4) == half
    assert told(1.4) < 0.75 * half
    assert told(0.01) == pytest.approx(half, rel=0.01)


def by_command(*words: object) -> str:
    done = subprocess.run([sys.executable, "-m", "bssrdf", *map(str, words), "--quiet"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_milk_on_black_by_the_bench_and_the_commands(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    scene = BenchScene(SimSample("Skimmilk", MILK), white_tile(), mm_per_px=0.15, spot_radius_mm=SPOT_MM)
    with simulated_bench(scene, speed=50.0) as bench:
        by_command("capture", tmp_path / "plan.toml", "--rig", bench.rig_file, "--out", tmp_path / "s")
    by_command("measure", tmp_path / "s")
    channels = json.loads(by_command("fit", "--model", "mc", "--json", tmp_path / "s"))["channels"]
    for name, medium in MILK.items():
        assert channels[name]["sigma_sp_per_mm"] == pytest.approx(medium.sigma_sp, rel=0.01)
        assert channels[name]["sigma_a_per_mm"] == pytest.approx(medium.sigma_a, rel=0.2)
        assert holds(medium.sigma_a, channels[name])
