"""Loop's subdivision: a closed mesh stays closed, flat stays flat, and an icosahedron comes nearer to a ball."""

from __future__ import annotations

import numpy as np

from bssrdf.bench.loop_subdivision import subdivided

GOLDEN = (1 + 5**0.5) / 2
CORNERS = np.array(
    [
        *[(s, t * GOLDEN, 0) for s in (-1, 1) for t in (-1, 1)],
        *[(0, s, t * GOLDEN) for s in (-1, 1) for t in (-1, 1)],
        *[(t * GOLDEN, 0, s) for s in (-1, 1) for t in (-1, 1)],
    ],
    dtype=float,
)


def icosahedron() -> tuple[np.ndarray, np.ndarray]:
    import scipy.spatial

    faces = scipy.spatial.ConvexHull(CORNERS).simplices
    a, b, c = np.moveaxis(CORNERS[faces], 1, 0)
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    return CORNERS, np.where(inwards[:, None], faces[:, ::-1], faces)


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_a_closed_mesh_stays_closed_and_faces_outwards() -> None:
    vertices, faces = subdivided(*icosahedron())
    assert (len(vertices), len(faces)) == (42, 80)
    ends = faces.astype(int)[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(np.unique(ends, axis=0)) == len(ends)  # each edge once in each direction
    assert {tuple(pair) for pair in ends} == {tuple(pair) for pair in ends[:, ::-1]}
    assert volume(vertices, faces) > 0


def test_it_rounds_off_and_moves_with_the_mesh() -> None:
    vertices, faces = icosahedron()
    shift = np.array([3.0, -2.0, 5.0])
    moved, _ = subdivided(vertices + shift, faces)
    radii = []
    for _ in range(3):
        vertices, faces = subdivided(vertices, faces)
        radii.append(np.linalg.norm(vertices, axis=1))
    np.testing.assert_allclose(moved - shift, subdivided(*icosahedron())[0], atol=1e-12)
    assert np.ptp(radii[2]) / radii[2].mean() < 0.02


def test_new_points_of_a_flat_part_lie_in_it() -> None:
    grid = np.array([(x, y, 0.0) for x in range(5) for y in range(5)])
    square = [(5 * x + y, 5 * x + y + 5, 5 * x + y + 6) for x in range(4) for y in range(4)]
    other = [(5 * x + y, 5 * x + y + 6, 5 * x + y + 1) for x in range(4) for y in range(4)]
    finer, _ = subdivided(grid, np.array(square + other))
    np.testing.assert_allclose(finer[12], [2, 2, 0], atol=1e-12)  # the middle has six even neighbours
    assert np.all(finer[:, 2] == 0)
