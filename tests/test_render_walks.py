"""Walks towards stored light, and what they mend: in even light, in balls, with no step left out."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from literal_ball import BALLS, RINGS, WalkedBall, read
from numpy.typing import NDArray

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

from bssrdf.render.interface import transmittance_table
from bssrdf.render.kernel import cosines
from bssrdf.render.points import leap, walk
from bssrdf.render.points.blend import mended, sampled, sparse_faces
from bssrdf.render.points.entry import entry_lobes
from bssrdf.render.points.record import BodySurface, Entered
from bssrdf.render.points.walk import Inside, walked
from bssrdf.transport.fresnel import fresnel_t

Floats = NDArray[np.float64]

pytestmark = pytest.mark.usefixtures("mitsuba_mono")


def ball(radius: float, rings: int = 40) -> BodySurface:
    """Triangles between circles of latitude."""
    theta = np.linspace(0, math.pi, rings + 1)[1:-1]
    phi = np.arange(2 * rings) * math.pi / rings
    t, f = np.meshgrid(theta, phi, indexing="ij")
    band = np.stack([np.sin(t) * np.cos(f), np.sin(t) * np.sin(f), np.cos(t)], axis=-1).reshape(-1, 3)
    normals = np.concatenate([band, [[0, 0, 1], [0, 0, -1]]])
    i, j = np.meshgrid(np.arange(rings - 2), np.arange(2 * rings), indexing="ij")
    a, b = 2 * rings * i + j, 2 * rings * i + (j + 1) % (2 * rings)
    quads = np.stack([a, a + 2 * rings, b + 2 * rings, a, b + 2 * rings, b], axis=-1).reshape(-1, 3)
    round_, north, south = np.arange(2 * rings), len(band), len(band) + 1
    top = np.stack([np.full_like(round_, north), round_, (round_ + 1) % (2 * rings)], axis=1)
    last = len(band) - 2 * rings
    bottom = np.stack([np.full_like(round_, south), last + (round_ + 1) % (2 * rings), last + round_], axis=1)
    faces = np.concatenate([quads, top, bottom]).astype(np.int64)
    return BodySurface(radius * normals, normals, np.zeros((len(normals), 2)), faces)


def cube(half: float, n: int) -> BodySurface:
    """Of n × n squares a side; vertices along its edges stand apart in their normals."""
    grid = np.linspace(-half, half, n + 1)
    a, b = (each.ravel() for each in np.meshgrid(grid, grid, indexing="ij"))
    i, j = (each.ravel() for each in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    p = i * (n + 1) + j
    faces = np.concatenate([np.stack([p, p + n + 1, p + n + 2], 1), np.stack([p, p + n + 2, p + 1], 1)])
    vertices, normals, sides = [], [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            order = faces if side > 0 else faces[:, ::-1]
            sides.append(order + len(sides) * len(a))
            vertices.append(np.roll(np.stack([np.full(len(a), side * half), a, b], axis=1), axis, axis=1))
            normals.append(np.roll(np.tile([side, 0.0, 0.0], (len(a), 1)), axis, axis=1))
    found = np.concatenate(vertices)
    return BodySurface(found, np.concatenate(normals), np.zeros((len(found), 2)), np.concatenate(sides))


def centres(surface: BodySurface) -> tuple[Floats, Floats]:
    normals = surface.normals[surface.faces].mean(axis=1)
    return surface.vertices[surface.faces].mean(axis=1), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def evenly(surface: BodySurface, eta: float, light: Floats, alpha: float = 0.0) -> Entered:
    """Of light (n, channels) that is the same from all sides; within the body its mean direction is the normal's."""
    mu = cosines()
    enters = transmittance_table(eta, alpha) * mu
    mean = np.trapezoid(enters * np.sqrt(1 - (1 - mu**2) / eta**2), mu) / np.trapezoid(enters, mu)
    return Entered(light, light, -mean * surface.normals)


def diffuse(cosine: Floats) -> Floats:
    """Leaves as from Lambert's surface."""
    return np.ones((len(cosine), 3))


def in_beam(surface: BodySurface, eta: float) -> Entered:
    """Under a parallel beam along −z of irradiance 1."""
    cos = np.maximum(surface.normals[:, 2], 0)
    light = np.repeat((cos * np.asarray(fresnel_t(eta, cos)))[:, None], 3, axis=1)
    inside = np.sqrt(1 - (1 - cos**2) / eta**2)
    direction = -np.array([0, 0, 1 / eta]) - (inside - cos / eta)[:, None] * surface.normals
    return Entered(light, light, direction)


@pytest.mark.parametrize(("eta", "g", "alpha"), [(1.0, 0.0, 0.0), (1.3, 0.85, 0.0), (1.5, 0.0, 0.4)])
def test_a_white_body_in_even_light_sends_out_all_that_enters(eta: float, g: float, alpha: float) -> None:
    surface = ball(4.0)
    white = Inside(np.full(3, 1e-9), np.array([1.0, 1.2, 1.5]), eta, g, alpha)
    places, normals = centres(surface)
    even = evenly(surface, eta, np.ones((len(surface.vertices), 3)), alpha)
    found = walked(surface, even, white, places[::4], normals[::4], walks=32)
    error = np.sqrt(found.variance.sum(axis=0)) / len(places[::4])
    assert np.all(np.abs(found.mean.mean(axis=0) - 1) < 3e-4 + 3 * error)
    assert np.all(error < 2e-3)


def quickest(*names: str, of: Iterable[str]) -> list[Any]:
    """All of them, only those named in a short run of the tests."""
    return [name if name in names else pytest.param(name, marks=pytest.mark.slow) for name in of]


@pytest.mark.parametrize("name", quickest("skin1R_g0.85_ball3", "marbleG_ball1", of=BALLS))
def test_walks_in_a_ball_in_a_beam_agree_with_a_literal_walk(name: str) -> None:
    medium, (known, error) = BALLS[name], read(name)[:2]
    surface, inside, entered = in_a_beam(medium)
    chosen = sparse_faces(surface, medium.radius / 12, 0)
    places, normals = (part[chosen] for part in centres(surface))
    found = walked(surface, entered, inside, places, normals, walks=128)
    ring = np.minimum(((normals[:, 2] + 1) / 2 * RINGS).astype(int), RINGS - 1)
    count = np.bincount(ring, minlength=RINGS)
    mean = np.bincount(ring, found.mean.mean(axis=1), RINGS) / count
    se = np.sqrt(np.bincount(ring, found.variance.mean(axis=1), RINGS)) / count
    matched = medium.eta == 1  # grazing light is spread most
    assert mean.mean() == pytest.approx(known.mean(), rel=0.03 if matched else 0.02)
    lit = slice(RINGS // 2 + 2, None)
    assert np.all(np.abs(mean - known)[lit] < (0.07 if matched else 0.04) * known[lit] + 3 * np.hypot(se, error)[lit])


@pytest.mark.parametrize("name", quickest("matched_ball3", of=("skin1R_ball3", "skin1R_g0.85_ball3", "matched_ball3")))
def test_light_along_a_view_is_that_of_a_literal_walk(name: str) -> None:
    """The intensity in directions across the beam and back towards it: the sum of radiance times area seen."""
    medium, (known, error) = BALLS[name], read(name)[2:]
    surface, inside, entered = in_a_beam(medium)
    places, normals = centres(surface)
    for way in (0.0, 0.6, 0.95):
        towards = np.array([math.sqrt(1 - way * way), 0, way])
        seen = np.flatnonzero(normals @ towards > 0)[::3]
        along = np.tile(towards, (len(seen), 1))
        found = walked(surface, entered, inside, places[seen], normals[seen], towards=along, walks=64)
        area = (surface.triangle_areas() * (normals @ towards))[seen]
        area *= 1 / math.pi / area.sum()  # the disc that is seen, over π times that of the beam
        expected, known_error = (np.interp(way, np.linspace(-0.95, 0.95, RINGS), part) for part in (known, error))
        noise = math.hypot(float(np.sqrt(area**2 @ found.variance[:, 0])), known_error)
        assert abs(area @ found.mean[:, 0] - expected) < 0.03 * expected + 3 * noise, way


def test_a_white_ball_of_coarse_triangles_in_a_beam_sends_out_all_that_enters() -> None:
    """Light whose direction is told at corners, between which the surface bends by 22°, is met whole."""
    surface, white = ball(4.0, rings=8), Inside(np.array([1e-9]), np.array([1.2]), 1.5)
    light = in_beam(surface, white.eta)
    entered = Entered(light.table[:, :1], light.fresnel[:, :1], light.direction)
    found = walked(surface, entered, white, *centres(surface), walks=1024)
    share = surface.triangle_areas() / float(surface.areas() @ entered.fresnel[:, 0])
    error = math.sqrt(float(share**2 @ found.variance[:, 0]))
    assert error < 5e-3
    assert share @ found.mean[:, 0] == pytest.approx(1, abs=0.015 + 2 * error)


def in_a_beam(medium: WalkedBall) -> tuple[BodySurface, Inside, Entered]:
    surface = ball(medium.radius, rings=48)
    inside = Inside(np.array([medium.sigma_a]), np.array([medium.sigma_sp]), medium.eta, medium.g)
    light = in_beam(surface, medium.eta)
    return surface, inside, Entered(light.table[:, :1], light.fresnel[:, :1], light.direction)


@pytest.mark.parametrize("eta", [1.0, 1.5])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_even_light_and_a_beam_are_told_apart_by_their_mean_direction(eta: float, share: float) -> None:
    surface = ball(1.0, 8)
    mean = evenly(surface, eta, np.ones((len(surface.vertices), 1)))
    beam = -surface.normals + 0.4 * np.cross(surface.normals, [1, 2, 3])
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    mixed = Entered(mean.table, mean.fresnel, (1 - share) * mean.direction + share * beam)
    lobes = entry_lobes(surface, mixed, eta, np.asarray(fresnel_t(eta, cosines())))
    np.testing.assert_allclose(lobes.share, share, atol=2e-3)
    if share > 0:
        np.testing.assert_allclose(lobes.beam, beam, atol=0.01)


def test_leaps_end_walks_as_every_step_does(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = ball(15.0)
    inside = Inside(np.array([0.01, 0.05, 0.2]), np.ones(3), 1.3, 0.5)
    entered = in_beam(surface, 1.3)
    places, normals = (part[::32] for part in centres(surface))
    found = []
    for first in (leap.RADII[0], 1e6):
        monkeypatch.setattr(walk, "RADII", leap.RADII * (first / leap.RADII[0]))
        each = walked(surface, entered, inside, places, normals, walks=64)
        found.append((each.mean.mean(axis=0), np.sqrt(each.variance.sum(axis=0)) / len(places)))
    (leapt, error), (stepped, other) = found
    assert np.all(np.abs(leapt - stepped) < 3.5 * np.hypot(error, other))
    assert np.all(error < 0.03 * leapt)


def test_an_evenly_lit_white_ball_is_mended_to_its_light_from_any_error() -> None:
    surface = ball(4.0)
    white = Inside(np.full(3, 1e-9), np.array([1.0, 1.2, 1.5]), 1.3)
    even = np.ones((len(surface.vertices), 3))
    dark = 0.8 * even * (1 + 0.1 * surface.normals[:, :1])
    walks = sampled(surface, evenly(surface, white.eta, even), white, None, diffuse, walks=8)
    light = mended(surface, walks, dark)
    np.testing.assert_allclose(light, 1, rtol=0.05)
    assert np.std(light) < 0.015
    assert np.average(light, axis=0, weights=surface.areas()) == pytest.approx([1, 1, 1], rel=3e-3)


def test_a_ball_lit_from_one_side_grows_redder_into_the_dark_without_coloured_patches() -> None:
    """Of points that miss a fifth of the light, and whose colour is off by 3 % from the lit side to the dark one."""
    surface, inside = ball(6.0), Inside(np.array([0.005, 0.012, 0.02]), np.array([2.2, 2.6, 3.0]), 1.5)
    entered = in_beam(surface, inside.eta)
    places, normals = (part[::8] for part in centres(surface))
    many = walked(surface, entered, inside, places, normals, walks=64).mean
    ring = np.minimum(((normals[:, 2] + 1) * 3).astype(int), 5)
    known = np.log([many[ring == k].mean(axis=0) for k in range(6)])
    height = surface.normals[:, 2]
    true = np.exp(np.stack([np.interp(height, (np.arange(6) - 2.5) / 3, line) for line in known.T], axis=1))
    points = 0.8 * true * (1 + 0.03 * height[:, None] * [1, 0, -1])
    walks = [sampled(surface, entered, inside, None, diffuse, walks=16, seed=seed) for seed in (1, 2)]
    found = [mended(surface, each, points) for each in walks]
    first, second = (np.log((light / light[:, 1:2])[height < 0][:, ::2]) for light in found)
    expected = np.log((true / true[:, 1:2])[height < 0][:, ::2])
    assert np.all((first - second).std(axis=0) < 0.1)
    assert np.all(np.abs(((first + second) / 2 - expected).mean(axis=0)) < 0.12)
    assert known[0, 0] - known[0, 1] > known[-1, 0] - known[-1, 1] + 0.2


def test_what_points_find_on_a_flat_thick_body_stays() -> None:
    surface = cube(40.0, 40)
    inside = Inside(np.full(3, 0.5), np.full(3, 1.0), 1.3)
    light = 1 + 0.3 * np.cos(surface.vertices[:, :1] * [0.1, 0.2, 0.3])
    walks = sampled(surface, evenly(surface, 1.3, light), inside, None, diffuse, walks=4)
    found = mended(surface, walks, 0.2 * light)
    deep = np.sort(np.abs(surface.vertices), axis=1)[:, 1] < 20
    np.testing.assert_array_equal(found[deep], 0.2 * light[deep])
    assert np.mean(found[~deep] != 0.2 * light[~deep]) > 0.3
