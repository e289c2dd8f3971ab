"""The light that leaves a closed body that is not flat: what walks find at some places mends what points find at all.

The kernel of points was made for a plane: round a bend and in a thin part too little light comes out. By how much
changes slowly along the surface, so that walks from few places tell it: the mean over a neighbourhood takes their noise
away, and the detail of points stays.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from bssrdf.render.points.record import BodySurface, Entered, Floats, Integers
from bssrdf.render.points.walk import Inside, walked

_NEIGHBOURS = 64
"""Places in a mean."""
_RADIUS = 1.5
"""Of a mean, over the distance between places: about 28 count."""
_BETWEEN = 4
"""Places that a vertex lies between."""
_DEPOSIT = 7
"""Vertices that share light which entered between them."""


def mended(
    surface: BodySurface,
    entered: Entered,
    inside: Inside,
    exitance: Floats,
    even: Floats,
    *,
    spacing: float,
    walks: int,
    seed: int = 0,
) -> Floats:
    """Radiant exitance of each vertex of a closed body, (n, channels), from that of points.

    Args: even: what the table returns of even light over that along the normal, (channels,); spacing: of the places
    that `walks` walks per channel start from.
    """
    light = shifted(surface, entered.table / even, entered.direction, 1 / (inside.sigma_a + inside.sigma_sp))
    chosen = sparse_faces(surface, spacing, seed)
    corners = surface.faces[chosen]
    places, normals = surface.vertices[corners].mean(axis=1), surface.normals[corners].mean(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    found = walked(surface, light, inside, places, normals, walks=walks, seed=seed).mean
    missing = found - exitance[corners].mean(axis=1)
    tree = cKDTree(places)
    missing = _mean_around(tree, places, normals, missing, normals, _NEIGHBOURS, _RADIUS * spacing)
    missing = _mean_around(tree, surface.vertices, surface.normals, missing, normals, _BETWEEN, spacing / 2)
    return np.maximum(exitance + missing, 0)


def _mean_around(
    tree: cKDTree, at: Floats, facing: Floats, values: Floats, normals: Floats, most: int, radius: float
) -> Floats:
    """Mean of the values at the tree's points near each place, on its side of the body; (k, channels)."""
    apart, near = tree.query(at, range(1, min(most, len(values)) + 1))
    aligned = np.maximum(np.einsum("ijk,ik->ij", normals[near], facing), 1e-6)
    weight = aligned * np.exp(-0.5 * (np.square(apart) - np.square(apart[:, :1])) / radius**2)
    return np.asarray(np.einsum("ij,ijc->ic", weight / weight.sum(axis=1, keepdims=True), values[near]))


def shifted(surface: BodySurface, light: Floats, direction: Floats, path: Floats) -> Floats:
    """Light per area (n, channels) moved along the surface as far as it runs sideways in a mean free path (channels,).

    Walks take all light to enter as even light does. To first order what enters slantwise differs by where it
    begins to diffuse: 1/σt′ along its mean direction (n, 3).
    """
    area = surface.areas()
    normals = surface.normals
    sideways = direction - np.einsum("ij,ij->i", direction, normals)[:, None] * normals
    lit = np.flatnonzero(light.any(axis=1))
    tree = cKDTree(surface.vertices)
    moved = light.copy()
    for channel, length in enumerate(path.tolist()):
        flux = light[lit, channel] * area[lit]
        for at, sign in ((surface.vertices[lit] + length * sideways[lit], 1.0), (surface.vertices[lit], -1.0)):
            moved[:, channel] += sign * _deposited(tree, area, at, flux)
    return moved


def _deposited(tree: cKDTree, area: Floats, at: Floats, flux: Floats) -> Floats:
    """Per area of the vertices near each place."""
    apart, near = tree.query(at, _DEPOSIT)
    weight = area[near] * (np.square(1 - np.square(apart / apart[:, -1:])) + 1e-12)  # none for the last, which may tie
    weight *= (flux / weight.sum(axis=1))[:, None]
    return np.asarray(np.bincount(near.ravel(), weight.ravel(), len(area)) / np.maximum(area, 1e-300))


def sparse_faces(surface: BodySurface, spacing: float, seed: int) -> Integers:
    """One face of each cube of that side through which the surface runs, drawn by area."""
    centres = surface.vertices[surface.faces].mean(axis=1)
    cube = np.floor(centres / spacing).astype(np.int64)
    late = np.random.default_rng(seed).exponential(size=len(centres)) / np.maximum(surface.triangle_areas(), 1e-300)
    order = np.argsort(late)
    _, first = np.unique(cube[order], axis=0, return_index=True)
    return np.asarray(order[first], np.int64)
