"""Loop's subdivision (1987) of a closed mesh: a scan of few triangles becomes smooth before it is seen from near."""

from __future__ import annotations

import numpy as np

from bssrdf.render.surface_nets import Points


def subdivided(vertices: Points, faces: np.ndarray) -> tuple[Points, np.ndarray]:
    """Vertices (n, 3) and faces (4 m, 3) of the next finer mesh: old vertices moved, then a new one per edge."""
    n = len(vertices)
    faces = faces.astype(np.int64)
    sides = np.sort(faces[:, [[1, 2], [2, 0], [0, 1]]], axis=2)
    ends, edge = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    edge = edge.reshape(-1, 3)
    opposite = _summed(edge.ravel(), vertices[faces.ravel()], len(ends))
    middles = 3 / 8 * vertices[ends].sum(axis=1) + opposite / 8
    a, b, c = faces.T
    ab, bc, ca = n + edge[:, 2], n + edge[:, 0], n + edge[:, 1]
    finer = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return np.concatenate([_moved(vertices, ends), middles]), finer.astype(np.uint32)


def _moved(vertices: Points, ends: np.ndarray) -> Points:
    """Old vertices, drawn towards their neighbours."""
    pairs = np.concatenate([ends, ends[:, ::-1]])
    neighbours = _summed(pairs[:, 0], vertices[pairs[:, 1]], len(vertices))
    valence = np.bincount(pairs[:, 0], minlength=len(vertices))[:, None]
    share = (5 / 8 - np.square(3 / 8 + np.cos(2 * np.pi / valence) / 4)) / valence
    return np.asarray((1 - valence * share) * vertices + share * neighbours)


def _summed(index: np.ndarray, values: Points, n: int) -> Points:
    return np.stack([np.bincount(index, values[:, axis], n) for axis in range(3)], axis=1)
