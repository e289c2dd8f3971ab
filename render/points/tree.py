"""A tree over triangles of light: what stands for all that a node holds, seen from afar."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from bssrdf.render.points.record import Floats, Integers

Singles = NDArray[np.float32]


class LightTree(NamedTuple):
    """A heap: node i has the nodes 2i and 2i + 1 below it; the last half of the nodes hold a triangle each or none."""

    centre: Singles
    """Mean place of the light, (nodes, 3)."""
    radius: Singles
    """Of the ball about it that holds all, (nodes,)."""
    spread: Singles
    """Covariance of the place of the light: xx, yy, zz, xy, xz, yz, (nodes, 6)."""
    flux: Singles
    """(nodes, channels)."""
    triangle: NDArray[np.int32]
    """Of each leaf, or −1, (nodes/2,)."""


def build_tree(corners: Floats, light: Floats) -> LightTree:
    """Over triangles (m, 3, 3) with light per area that is linear between their corners, (m, 3, channels)."""
    levels = max(1, math.ceil(math.log2(max(len(corners), 2))))
    leaves = 1 << levels
    triangle = np.full(leaves, -1, np.int32)
    ordered, starts = _halved(corners.mean(axis=1), levels)
    held = np.diff(starts) > 0
    n_channels = light.shape[-1]
    centre, spread, flux = np.zeros((2 * leaves, 3)), np.zeros((2 * leaves, 6)), np.zeros((2 * leaves, n_channels))
    low, high = np.full((2 * leaves, 3), np.inf), np.full((2 * leaves, 3), -np.inf)
    leaf, chosen = leaves + np.flatnonzero(held), ordered[starts[:-1][held]]
    triangle[held] = chosen
    centre[leaf], spread[leaf], flux[leaf] = _moments(corners, light, chosen)
    first, second, third = np.moveaxis(corners[chosen], 1, 0)
    low[leaf] = np.minimum(np.minimum(first, second), third)
    high[leaf] = np.maximum(np.maximum(first, second), third)
    _sum_up(levels, centre, spread, flux, low, high)
    reach = np.linalg.norm(np.maximum(high - centre, centre - low), axis=1)
    radius = np.where(np.isfinite(reach), reach, 0)
    off = [np.linalg.norm(corner - centre[leaf], axis=1) for corner in (first, second, third)]
    radius[leaf] = np.maximum(np.maximum(*off[:2]), off[2])
    return LightTree(_single(centre), _single(radius), _single(spread), _single(flux), triangle)


def _single(values: Floats) -> Singles:
    return values.astype(np.float32)


_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _moments(corners: Floats, light: Floats, chosen: Integers) -> tuple[Floats, Floats, Floats]:
    """Mean place, its covariance, and flux of each triangle."""
    at, shine = corners[chosen], light[chosen]
    across = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
    flux = np.linalg.norm(across, axis=1)[:, None] / 2 * shine.mean(axis=1)
    grey = shine.sum(axis=2)
    share = np.where(grey.sum(axis=1, keepdims=True) > 0, grey, 1)
    share /= share.sum(axis=1, keepdims=True)
    centre = np.einsum("mk,mkx->mx", (1 + share) / 4, at)
    off = at - centre[:, None]
    mean = np.einsum("mk,mkx->mx", share, off)
    # of the products of barycentric coordinates: 6, 2 or 1 twentieths of the light at the corners that they share
    spread = [
        np.einsum("mk,mk,mk->m", off[..., i], off[..., j], 2 * share + 1)
        + mean[:, i] * off[..., j].sum(axis=1)
        + off[..., i].sum(axis=1) * mean[:, j]
        + off[..., i].sum(axis=1) * off[..., j].sum(axis=1)
        for i, j in _PAIRS
    ]
    return centre, np.stack(spread, axis=1) / 20, flux


def _sum_up(levels: int, centre: Floats, spread: Floats, flux: Floats, low: Floats, high: Floats) -> None:
    for level in range(levels - 1, -1, -1):
        node = np.arange(1 << level, 2 << level)
        left, right = 2 * node, 2 * node + 1
        flux[node] = flux[left] + flux[right]
        weight = [np.maximum(flux[child].sum(axis=1), 1e-300) for child in (left, right)]
        share = weight[0] / (weight[0] + weight[1])
        centre[node] = _mean(centre, left, right, share)
        apart = centre[left] - centre[right]
        between = np.stack([apart[:, i] * apart[:, j] for i, j in _PAIRS], axis=1)
        spread[node] = _mean(spread, left, right, share) + (share * (1 - share))[:, None] * between
        low[node], high[node] = np.minimum(low[left], low[right]), np.maximum(high[left], high[right])


def order(points: Floats) -> Integers:
    """An order of the points (n, 3) in which neighbours follow each other."""
    return _halved(points, max(1, math.ceil(math.log2(max(len(points), 2)))))[0]


def _mean(values: Floats, left: Integers, right: Integers, share: Floats) -> Floats:
    return share[:, None] * values[left] + (1 - share)[:, None] * values[right]


def _halved(points: Floats, levels: int) -> tuple[Integers, Integers]:
    """An order of the points in which halves of halves lie together, and where each of the 2^levels parts starts."""
    ordered, starts = np.arange(len(points)), np.array([0, len(points)])
    for _ in range(levels):
        middles = (starts[:-1] + starts[1:] + 1) // 2
        _part_halves(points, ordered, starts, middles)
        starts = np.append(np.stack([starts[:-1], middles], axis=1).ravel(), starts[-1])
    return ordered, starts


@numba.njit(cache=True, parallel=True, nogil=True)
def _part_halves(points: Floats, order: Integers, starts: Integers, middles: Integers) -> None:
    for part in numba.prange(len(middles)):
        if starts[part + 1] - starts[part] > 1:
            low, high = starts[part], starts[part + 1]
            keys = np.empty(high - low)
            axis = _longest_axis(points, order[low:high])
            for i in range(low, high):
                keys[i - low] = points[order[i], axis]
            _select(keys, order[low:high], middles[part] - low)


@numba.njit(cache=True)
def _longest_axis(points: Floats, order: Integers) -> int:
    best, axis = -1.0, 0
    for k in range(3):
        least, most = np.inf, -np.inf
        for i in order:
            x = points[i, k]
            least, most = min(least, x), max(most, x)
        if most - least > best:
            best, axis = most - least, k
    return axis


@numba.njit(cache=True)
def _select(keys: Floats, order: Integers, middle: int) -> None:
    """Exchange until none of the keys before `middle` is above one from there on (Hoare 1961)."""
    low, high = 0, len(keys) - 1
    while low < high:
        pivot = keys[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while keys[i] < pivot:
                i += 1
            while keys[j] > pivot:
                j -= 1
            if i <= j:
                keys[i], keys[j] = keys[j], keys[i]
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return
