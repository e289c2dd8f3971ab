"""Walks towards stored light, and what they mend: in even light, in balls, with no step left out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from literal_ball import BALLS, RINGS, read
from numpy.typing import NDArray

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

from bssrdf.render.kernel import kernels
from bssrdf.render.medium import even_return
from bssrdf.render.points import leap, walk
from bssrdf.render.points.blend import mended, shifted, sparse_faces
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
    found = walked(surface, np.ones((len(surface.vertices), 3)), white, places[::4], normals[::4], walks=32)
    error = np.sqrt(found.variance.sum(axis=0)) / len(places[::4])
    assert np.all(np.abs(found.mean.mean(axis=0) - 1) < 3e-4 + 3 * error)
    assert np.all(error < 2e-3)


@pytest.mark.parametrize("name", BALLS)
def test_walks_in_a_ball_in_a_beam_agree_with_a_literal_walk(name: str) -> None:
    known, error = read(name)
    medium = BALLS[name]
    surface = ball(medium.radius, rings=48)
    inside = Inside(np.array([medium.sigma_a]), np.array([medium.sigma_sp]), medium.eta, medium.g)
    entered = in_beam(surface, medium.eta)
    path = 1 / (inside.sigma_a + inside.sigma_sp)
    light = shifted(surface, entered.fresnel[:, :1], entered.direction, path)
    chosen = sparse_faces(surface, medium.radius / 12, 0)
    places, normals = (part[chosen] for part in centres(surface))
    found = walked(surface, light, inside, places, normals, walks=256)
    ring = np.minimum(((normals[:, 2] + 1) / 2 * RINGS).astype(int), RINGS - 1)
    count = np.bincount(ring, minlength=RINGS)
    mean = np.bincount(ring, found.mean.mean(axis=1), RINGS) / count
    se = np.sqrt(np.bincount(ring, found.variance.mean(axis=1), RINGS)) / count
    assert mean.mean() == pytest.approx(known.mean(), rel=0.01)
    lit = slice(RINGS // 2, None)  # of where light runs inside walks know the mean only: no harder test than a beam
    assert np.all(np.abs(mean - known)[lit] < 0.12 * known[lit] + 3 * np.hypot(se, error)[lit])


def test_what_was_moved_sideways_is_the_same_light() -> None:
    surface = ball(4.0)
    entered = in_beam(surface, 1.3)
    moved = shifted(surface, entered.fresnel, entered.direction, np.array([0.2, 0.5, 1.0]))
    np.testing.assert_allclose(surface.areas() @ moved, surface.areas() @ entered.fresnel, rtol=1e-9)
    straight = shifted(surface, entered.fresnel, -surface.normals, np.ones(3))
    np.testing.assert_allclose(straight, entered.fresnel, atol=1e-12)


def test_leaps_end_walks_as_every_step_does(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = ball(15.0)
    inside = Inside(np.array([0.01, 0.05, 0.2]), np.ones(3), 1.3, 0.5)
    entered = in_beam(surface, 1.3)
    places, normals = (part[::16] for part in centres(surface))
    found = []
    for first in (leap.RADII[0], 1e6):
        monkeypatch.setattr(walk, "RADII", leap.RADII * (first / leap.RADII[0]))
        each = walked(surface, entered.fresnel, inside, places, normals, walks=64)
        found.append((each.mean.mean(axis=0), np.sqrt(each.variance.sum(axis=0)) / len(places)))
    (leapt, error), (stepped, other) = found
    assert np.all(np.abs(leapt - stepped) < 3.5 * np.hypot(error, other))
    assert np.all(error < 0.02 * leapt)


def test_an_evenly_lit_white_ball_is_mended_to_its_light_from_any_error() -> None:
    surface = ball(4.0)
    white = Inside(np.full(3, 1e-9), np.array([1.0, 1.2, 1.5]), 1.3)
    even = np.ones((len(surface.vertices), 3))
    entered = Entered(even, even, -surface.normals)
    dark = 0.8 * even * (1 + 0.1 * surface.normals[:, :1])
    light = mended(surface, entered, white, dark, np.ones(3), walks=16)
    np.testing.assert_allclose(light, 1, rtol=0.03)
    assert np.average(light, axis=0, weights=surface.areas()) == pytest.approx([1, 1, 1], rel=3e-3)


def test_a_white_medium_returns_even_light_as_it_does_a_beam() -> None:
    grey, white = even_return(kernels(1.3, 0.0, np.array([0.5, 1.0])), 1.3, 0.0)
    np.testing.assert_allclose(white, 1, atol=0.01)
    assert grey > 1.04  # what enters slantwise stays near the surface


def test_what_points_find_on_a_flat_thick_body_stays() -> None:
    surface = cube(40.0, 40)
    inside = Inside(np.full(3, 0.5), np.full(3, 1.0), 1.3)
    light = 1 + 0.3 * np.cos(surface.vertices[:, :1] * [0.1, 0.2, 0.3])
    entered = Entered(light, light, -surface.normals)
    found = mended(surface, entered, inside, 0.2 * light, np.ones(3), walks=4)
    deep = np.sort(np.abs(surface.vertices), axis=1)[:, 1] < 20
    np.testing.assert_array_equal(found[deep], 0.2 * light[deep])
    assert np.mean(found[~deep] != 0.2 * light[~deep]) > 0.3
