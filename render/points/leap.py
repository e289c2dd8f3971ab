"""Scatterings that a walk skips where no surface is near: it leaves the empty sphere about it as walks made once did.

From its centre a walk first crosses a sphere at a place, along a direction, after a number of scatterings, all drawn
together from a store of walks in a medium without bounds. The store holds for every medium of one g: lengths in 1/σt.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from bssrdf.render.points.record import BodySurface, Floats
from bssrdf.transport.photon import State, free_path, normalised, scatter, stream_states

RADII = 2.0 * 2.0 ** (np.arange(7) / 2)
"""Of the spheres [1/σt], up to 16. Walks in a sphere of 2 scatter four times: less would save nothing."""
DRAWS = 1 << 14
"""Walks per sphere: their mean number of scatterings is known to 0.6 %."""
FIELDS = 7
"""Of a stored walk: the place on the unit sphere, the direction there, the number of scatterings."""
_CELLS = 96
"""Of the grid of distances, along the longest side of a body."""


@functools.cache
def stored_leaps(g: float) -> Floats:
    """Where walks that start along +z leave the spheres, (radii, DRAWS, FIELDS)."""
    leaps = np.empty((len(RADII), DRAWS, FIELDS))
    states = stream_states(0, len(RADII))
    for radius, state, rows in zip(RADII, states, leaps, strict=True):
        _leave(radius, g, state, rows)
    return leaps


@njit(nogil=True, cache=True)
def _leave(radius: float, g: float, state: State, rows: Floats) -> None:
    for row in rows:
        x, y, z, ux, uy, uz, n = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0
        while True:
            step = free_path(state)
            along = x * ux + y * uy + z * uz
            short = radius * radius - (x * x + y * y + z * z)
            ahead = -along + np.sqrt(along * along + short)
            if step >= ahead:
                x, y, z = x + ahead * ux, y + ahead * uy, z + ahead * uz
                break
            x, y, z = x + step * ux, y + step * uy, z + step * uz
            ux, uy, uz = scatter(state, g, ux, uy, uz)
            ux, uy, uz = normalised(ux, uy, uz)
            n += 1
        row[0], row[1], row[2] = x / radius, y / radius, z / radius
        row[3], row[4], row[5], row[6] = ux, uy, uz, n


@dataclass(frozen=True)
class RoomGrid:
    """Lower bounds of the distance to a surface at the centres of cubic cells."""

    low: Floats
    """The corner where the grid starts, (3,)."""
    cell: float
    room: NDArray[np.float32]
    """(nx, ny, nz)."""

    def nearest_beam(self, places: Floats, vectors: Floats, flux: Floats, least: float) -> Floats:
        """For each cell the unit vector along the sum of vectors (n, 3) in the nearest cell with places, (cells, 3).

        It is 0 where that sum is below `least` of the flux (n,) there.
        """
        shape = self.room.shape
        cell = np.ravel_multi_index(tuple(((places - self.low) / self.cell).astype(int).T), shape)
        total = np.stack([np.bincount(cell, vectors[:, axis], self.room.size) for axis in range(3)], axis=1)
        size = np.linalg.norm(total, axis=1, keepdims=True)
        enough = size > least * np.bincount(cell, flux, self.room.size)[:, None]
        unit = np.where(enough, total / np.maximum(size, 1e-300), 0)
        held = np.bincount(cell, minlength=self.room.size).reshape(shape) > 0
        nearest = ndimage.distance_transform_edt(~held, return_distances=False, return_indices=True)
        return np.asarray(unit[np.ravel_multi_index(tuple(nearest.reshape(3, -1)), shape)])


def room_grid(surface: BodySurface) -> RoomGrid:
    """The distance transform of the cells that the surface runs through, less what cells can hide."""
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    cell = float((high - low).max()) / _CELLS
    shape = np.ceil((high - low) / cell).astype(int) + 1
    free = np.ones(shape, bool)
    for points in _sprinkled(surface, cell / 2):
        free[tuple(((points - low) / cell).astype(int).T)] = False
    apart = cell * ndimage.distance_transform_edt(free)
    hidden = cell * (np.sqrt(3) / 2 + 1 / 3)  # a place in its cell, and the surface between points of a triangle
    return RoomGrid(low, cell, np.maximum(apart - hidden, 0).astype(np.float32))


def _sprinkled(surface: BodySurface, spacing: float) -> list[Floats]:
    """Points on the triangles, no place of which is farther than `spacing`/√3 from one."""
    corners = surface.vertices[surface.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.maximum(np.ceil(longest / spacing).astype(int), 1)
    found = []
    for n in np.unique(parts):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        keep = i + j <= n
        weights = np.stack([i[keep], j[keep], n - i[keep] - j[keep]], axis=1) / n
        found.append((weights @ corners[parts == n]).reshape(-1, 3))
    return found
