"""The kernel of points and its sum over a surface against the table's own integrals and a literal sum."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from bssrdf.render.kernel import DISCS, WIDEST, Kernels, kernels, radii
from bssrdf.render.points.gather import gather
from bssrdf.transport import dipole, scoped_x64, table_model

Floats = NDArray[np.float64]
ALBEDO = np.array([0.5, 0.95, 0.99])
ETA, G = 1.4, 0.3


@pytest.fixture(scope="module")
def table() -> Kernels:
    return kernels(ETA, G, ALBEDO)


def grid(edge: float, half: float) -> tuple[Floats, NDArray[np.int64]]:
    """A square of triangles about the origin, their corners moved at random by up to a quarter of an edge."""
    n = 2 * round(half / edge)
    x = np.linspace(-half, half, n + 1)
    across, up = np.meshgrid(x, x)
    vertices = np.stack([across, up, np.zeros_like(up)], axis=-1)
    vertices[1:-1, 1:-1, :2] += edge / 4 * np.random.default_rng(1).uniform(-1, 1, (n - 1, n - 1, 2))
    i = np.arange(n)
    a = (i[:, None] * (n + 1) + i).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    return vertices.reshape(-1, 3), faces


def ball(radius: float, parts: int) -> tuple[Floats, NDArray[np.int64]]:
    theta, phi = np.linspace(0, np.pi, parts + 1), 2 * np.pi * np.arange(2 * parts) / (2 * parts)
    sine = np.sin(theta)[:, None]
    up = np.broadcast_to(np.cos(theta)[:, None], (parts + 1, 2 * parts))
    vertices = radius * np.stack([sine * np.cos(phi), sine * np.sin(phi), up], axis=-1).reshape(-1, 3)
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(parts), np.arange(2 * parts), indexing="ij"))
    a, b = i * 2 * parts + j, i * 2 * parts + (j + 1) % (2 * parts)
    faces = np.concatenate([np.stack([a, a + 2 * parts, b], 1), np.stack([b, a + 2 * parts, b + 2 * parts], 1)])
    return vertices, faces


def by_table(albedo: float, r: Floats) -> Floats:
    model = table_model(ETA, G)

    @scoped_x64
    def light() -> Floats:
        return np.asarray(model.rd(dipole.Medium(1 - albedo, albedo, ETA), r))

    return light()


def test_all_light_of_the_kernel_is_the_total_of_the_table(table: Kernels) -> None:
    model = table_model(ETA, G)
    total = [float(scoped_x64(model.total)(dipole.Medium(1 - albedo, albedo, ETA))) for albedo in ALBEDO]
    np.testing.assert_allclose(table.total, total, rtol=1e-9)
    np.testing.assert_allclose(2 * np.pi * table.inside[:, -1, 0], total, rtol=1e-5)


def test_kernel_is_the_tables_rd_and_its_means_over_discs(table: Kernels) -> None:
    r = radii()
    some = (r > 0.05) & (r < 40)
    for k, albedo in enumerate(ALBEDO):
        np.testing.assert_allclose(table.disc[k, some, 0], by_table(albedo, r[some]), rtol=3e-3)
    u, azimuth = np.meshgrid((np.arange(64) + 0.5) / 64, 2 * np.pi * (np.arange(64) + 0.5) / 64)
    place = int(np.argmin(np.abs(r - 1.7)))
    for j in (2, DISCS):
        s = WIDEST * math.sqrt(j / DISCS) * r[place] * np.sqrt(u)
        distance = np.sqrt(r[place] ** 2 + s * s + 2 * r[place] * s * np.cos(azimuth))
        for k, albedo in enumerate(ALBEDO):
            assert table.disc[k, place, j] == pytest.approx(by_table(albedo, distance).mean(), rel=3e-3)


@pytest.mark.parametrize("edge", [0.3, 1.0, 3.0, 10.0, 1e5])
@pytest.mark.parametrize("opening", [0.2, 0.4, 0.6])
def test_even_light_on_a_plane_gives_the_total_for_any_mesh_and_opening(
    table: Kernels, edge: float, opening: float
) -> None:
    """The middle of a square: what lies beyond it would have sent the rest of the integral."""
    half = 80 * max(edge, 0.5)
    vertices, faces = grid(edge, half)
    middle = vertices[np.linalg.norm(vertices, axis=1) < 2.5 * edge]
    faces = faces[np.linalg.norm(vertices[faces].mean(axis=1), axis=1) < half]
    light = gather(vertices[faces], np.ones((len(faces), 3, 3)), middle, table, ALBEDO, np.ones(3), opening)
    beyond = [
        1 - 2 * np.pi * np.interp(half, radii(), inside) / R
        for inside, R in zip(table.inside[..., 0], table.total, strict=True)
    ]
    np.testing.assert_allclose(light.mean(axis=0) / table.total, 1 - np.array(beyond), atol=2e-3)
    assert np.all(np.abs(light / table.total - 1) < 0.005 + np.array(beyond))


@pytest.mark.parametrize("edge", [0.5, 1.0, 2.0])
def test_light_across_a_shadows_edge_is_the_tables_line_integral(table: Kernels, edge: float) -> None:
    """From the half plane y > 0 comes ∫ 2r acos(x/r) R_d dr at the distance x in the dark."""
    vertices, faces = grid(edge, 100 * edge)
    row = np.abs(vertices[:, 1]) < 0.3 * edge
    vertices[row, 1] = 0  # the edge runs along a row of the mesh
    lit = vertices[faces].mean(axis=1)[:, 1] > 0
    dark = vertices[(np.abs(vertices[:, 0]) < 4 * edge) & (vertices[:, 1] < -0.4) & (vertices[:, 1] > -6)]
    light = gather(vertices[faces], np.ones((1, 3, 3)) * lit[:, None, None], dark, table, ALBEDO, np.ones(3), 0.4)
    for k, albedo in enumerate(ALBEDO):
        expected = [line_integral(albedo, -y) for y in dark[:, 1]]
        assert np.mean(light[:, k]) == pytest.approx(np.mean(expected), rel=0.003)
        np.testing.assert_allclose(light[:, k], expected, rtol=0.01, atol=2e-6)  # of what leaves in the light


def line_integral(albedo: float, x: float) -> float:
    r = np.geomspace(x, 200, 4001)
    middle = np.sqrt(r[:-1] * r[1:])
    return float(np.sum(2 * middle * np.arccos(x / middle) * by_table(albedo, middle) * np.diff(r)))


def test_sum_over_a_bent_surface_is_the_literal_one(table: Kernels) -> None:
    vertices, faces = ball(3.0, 12)
    rng = np.random.default_rng(2)
    shine = rng.uniform(0, 1, (len(vertices), 3)) ** 2
    light = gather(vertices[faces], shine[faces], vertices, table, ALBEDO, np.array([1.0, 2.0, 0.7]), 0.4)
    some = rng.choice(len(vertices), 12, replace=False)
    literal = [literal_sum(vertices, faces, shine, vertices[i], k, s) for i in some for k, s in enumerate((1, 2, 0.7))]
    np.testing.assert_allclose(light[some].ravel(), literal, rtol=0.02)
    assert np.mean(light[some].ravel() / literal) == pytest.approx(1, abs=0.003)


def literal_sum(
    vertices: Floats, faces: NDArray[np.int64], shine: Floats, place: Floats, k: int, scale: float
) -> float:
    """R_d at the middles of the equal parts of every triangle; its own are cut along rays from the place."""
    u, v = (part.ravel() for part in np.meshgrid(*[(np.arange(96) + 0.5) / 96] * 2))
    total = 0.0
    r = np.geomspace(1e-5, 40, 4000)
    log_rd = np.log(by_table(float(ALBEDO[k]), r))
    for face in faces:
        first = int(np.argmin(np.linalg.norm(vertices[face] - place, axis=1)))
        corners, light = vertices[np.roll(face, -first)], shine[np.roll(face, -first), k]
        weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
        area = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])) / 2
        distance = np.linalg.norm(weights @ corners - place, axis=1) * scale
        rd = scale**2 * np.exp(np.interp(np.log(distance), np.log(r), log_rd))
        total += area * float(np.mean(rd * 2 * u * (weights @ light)))
    return total


def test_media_between_those_of_the_table_lie_between() -> None:
    nodes = 1 - np.linspace(0.5, 0, 17) ** 2  # light varies evenly with √(1 − α′)
    coarse, exact = kernels(ETA, G, nodes), kernels(ETA, G, ALBEDO[1:])
    vertices, faces = grid(1.0, 20)
    middle = vertices[np.linalg.norm(vertices, axis=1) < 2]
    corners, shine = vertices[faces], np.ones((len(faces), 3, 2))
    between = gather(corners, shine, middle, coarse, ALBEDO[1:], np.ones(2), 0.4)
    np.testing.assert_allclose(between, gather(corners, shine, middle, exact, ALBEDO[1:], np.ones(2), 0.4), rtol=0.02)
