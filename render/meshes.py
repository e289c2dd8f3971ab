"""Which translucent bodies are open, so that light in them has no inside."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

OPEN_SHAPES = ("Rectangle", "Disk", "Cylinder")


def openings(shapes: list[Any]) -> list[str]:
    """One line for each shape that is open."""
    return [
        f'shape "{shape.id()}" is open ({how}): its translucency is that of a half space under it'
        for shape in shapes
        if (how := _opening(shape))
    ]


def _opening(shape: Any) -> str:
    if not shape.is_mesh():
        kind = shape.class_name()
        return kind.lower() if kind in OPEN_SHAPES else ""
    corners = np.array(shape.vertex_positions_buffer()).reshape(-1, 3)
    faces = np.array(shape.faces_buffer()).reshape(-1, 3)
    free = free_edges(corners, faces)
    return f"{free} edges of one face only" if free else ""


def free_edges(corners: NDArray[np.floating[Any]], faces: NDArray[np.integer[Any]]) -> int:
    """Edges that an odd number of faces share; corners at one place, as at a seam of the texture, are one."""
    _, place = np.unique(corners, axis=0, return_inverse=True)
    merged = place.reshape(-1)[faces]
    edges = np.sort(np.concatenate([merged[:, [0, 1]], merged[:, [1, 2]], merged[:, [2, 0]]]), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return int(np.count_nonzero(counts % 2))
