"""The light that leaves at places of a surface: R_d summed over all light that entered, by a tree.

A node that is small against its distance counts as one disc. A triangle that is not is integrated exactly where it lies
in the plane of the place: ∫ R_d dA over it is the sum over its edges of ∫ (∫₀ʳ R_d s ds) dφ, which holds for any size
of the triangle against the mean free path, so that a coarse mesh ends at the BRDF.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from bssrdf.render.kernel import DISCS, FIRST, OCTAVES, PER_OCTAVE, WIDEST, Kernels
from bssrdf.render.points.record import Floats
from bssrdf.render.points.tree import LightTree, Singles, build_tree

_NODES, _WEIGHTS = (part.astype(np.float32) for part in np.polynomial.legendre.leggauss(3))
"""Of the integral along each side of the foot on an edge: two leave 2e-4 on the bust's triangles."""
_single: Any = np.float32
Vector = tuple[float, float, float]
_DEEPEST = 64
_STEEP = 0.7
"""Radius of a node over the length 1/σtr in which light falls, from which on a disc does not stand for it…"""
_COUNTS = 1e-2
"""…where it sends more than that, over what was found so far, nearer ones first…"""
_LEAST = 1e-5
"""…and more than that over what leaves where most light enters. Under shadows with hard edges on skin1, where most
nodes are steep, all three leave 0.6 % rms; opening each of them would take four times as long for 0.4 %."""


def gather(
    corners: Floats,
    light: Floats,
    places: Floats,
    table: Kernels,
    albedo: Floats,
    sigma_tp: Floats,
    opening: float,
) -> Floats:
    """Radiant exitance at the places (p, 3), in the unit of `light`, shape (p, channels).

    Args: corners: of triangles, (m, 3, 3), and `light`, the flux per area that entered at them, (m, 3, channels);
    albedo, sigma_tp: α′ and σt′ [1/scene unit] of the medium under each place, (p, channels) or (channels,);
    opening: radius of a node over its distance below which it counts as one, up to 0.6.
    """
    tree = build_tree(corners, light)
    shape = (len(places), light.shape[-1])
    row, share = _between(table.albedo, np.broadcast_to(albedo, shape))
    scale = np.broadcast_to(sigma_tp, shape).astype(np.float32)
    decay = np.sqrt(3 * (1 - np.broadcast_to(albedo, shape))).astype(np.float32) * scale
    found = _sum(
        tree,
        corners.astype(np.float32),
        light.astype(np.float32),
        places.astype(np.float32),
        table.disc,
        table.inside,
        row,
        share,
        scale,
        np.log2(scale / np.float32(FIRST)),
        decay,
        (_LEAST * light.max(axis=(0, 1)) * table.total.max()).astype(np.float32),
        _single(opening),
    )
    return np.asarray(found, np.float64)


def _between(nodes: Floats, values: Floats) -> tuple[NDArray[np.int32], Singles]:
    """The node below each value, and the share of the one above it."""
    row = np.clip(np.searchsorted(nodes, values, side="right") - 1, 0, max(len(nodes) - 2, 0))
    above = np.minimum(row + 1, len(nodes) - 1)
    share = (values - nodes[row]) / np.maximum(nodes[above] - nodes[row], 1e-300)
    return row.astype(np.int32), np.where(above > row, np.clip(share, 0, 1), 0).astype(np.float32)


@numba.njit(parallel=True, nogil=True, fastmath=True, cache=True, error_model="numpy")
def _sum(
    tree: LightTree,
    corners: Singles,
    light: Singles,
    places: Singles,
    discs: Singles,
    inside: Singles,
    row: NDArray[np.int32],
    share: Singles,
    scale: Singles,
    octave: Singles,
    decay: Singles,
    least: Singles,
    opening: float,
) -> Singles:
    centre, radius, spread, flux, triangle = tree
    n_channels = flux.shape[1]
    leaves = len(triangle)
    out = np.zeros((len(places), n_channels), np.float32)
    for p in numba.prange(len(places)):
        stack = np.empty(_DEEPEST, np.int32)
        stack[0], top = 1, 1
        x, y, z = places[p]
        found, sums = np.zeros(n_channels, np.float32), np.zeros((2, 4, n_channels), np.float32)
        while top > 0:
            top -= 1
            node = stack[top]
            if flux[node].max() <= 0:
                continue
            dx, dy, dz = x - centre[node, 0], y - centre[node, 1], z - centre[node, 2]
            d2 = dx * dx + dy * dy + dz * dz
            small = radius[node] * radius[node] <= opening * opening * d2
            if small:
                way = (dx, dy, dz)
                _from_afar(sums[0, 0], way, d2, spread[node], flux[node], discs, row[p], share[p], scale[p], octave[p])
                for c in range(n_channels):
                    steep = radius[node] * decay[p, c] > _single(_STEEP)
                    small = small and not (steep and sums[0, 0, c] > max(_single(_COUNTS) * found[c], least[c]))
            if small:
                for c in range(n_channels):
                    found[c] += sums[0, 0, c]
            elif node < leaves:
                near = 2 * node
                if _apart(places[p], centre[near + 1]) < _apart(places[p], centre[near]):
                    near += 1
                stack[top], stack[top + 1] = near ^ 1, near
                top += 2
            else:
                t = triangle[node - leaves]
                _add_triangle(
                    found, sums, places[p], corners[t], light[t], inside, row[p], share[p], scale[p], octave[p]
                )
        out[p] = found
    return out


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _from_afar(
    found: Singles,
    way: Vector,
    d2: float,
    spread: Singles,
    flux: Singles,
    discs: Singles,
    row: NDArray[np.int32],
    share: Singles,
    scale: Singles,
    octave: Singles,
) -> None:
    """Light of a node, `way` from its mean place to where it leaves: a disc as wide as the node is along the way.

    What the node is wider or narrower across the way counts by the slope of R_d.
    """
    x, y, z = way
    along = x * x * spread[0] + y * y * spread[1] + z * z * spread[2]
    along = (along + 2 * (x * y * spread[3] + x * z * spread[4] + y * z * spread[5])) / (d2 * d2)
    across = _single(0.5) * ((spread[0] + spread[1] + spread[2]) / d2 - 2 * along)
    cell = min(along * _single(4 * DISCS / WIDEST**2), _single(DISCS - 1e-3))
    j = int(cell)
    f = cell - j
    log_r = _single(0.5) * math.log2(d2)
    for c in range(len(found)):
        k, t = _place(log_r + octave[c], discs.shape[1])
        value = _of_disc(discs, row[c], k, t, j, f, across)
        if share[c] > 0:
            value += share[c] * (_of_disc(discs, row[c] + 1, k, t, j, f, across) - value)
        beyond = log_r + octave[c] - _single(OCTAVES)
        if beyond > 0:
            value *= _single(2) ** (-3 * beyond)  # diffusing light goes on as the cube of the radius
        found[c] = flux[c] * value * scale[c] * scale[c]


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _of_disc(discs: Singles, row: int, k: int, t: float, j: int, f: float, across: float) -> float:
    slope = discs[row, k, DISCS + 1] + t * (discs[row, k + 1, DISCS + 1] - discs[row, k, DISCS + 1])
    low = discs[row, k, j] + f * (discs[row, k, j + 1] - discs[row, k, j])
    high = discs[row, k + 1, j] + f * (discs[row, k + 1, j + 1] - discs[row, k + 1, j])
    mean = low + t * (high - low)
    return max(mean + across * slope, _single(0.3) * mean)


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _place(octave: float, n: int) -> tuple[int, float]:
    """Where in a table of n radii one lies that is so many octaves above the first, and how far on to the next."""
    at = max(octave * _single(PER_OCTAVE), _single(0))
    k = min(int(at), n - 2)
    return k, min(at - k, _single(1))


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _within(log_r: float, inside: Singles, row: int, share: float, scale: float, octave: float) -> tuple[float, float]:
    """∫₀ʳ R_d s ds, and ∫₀ʳ R_d s² ds [scene unit]."""
    above = log_r + octave
    k, t = _place(above, inside.shape[1])
    first = inside[row, k, 0] + t * (inside[row, k + 1, 0] - inside[row, k, 0])
    second = inside[row, k, 1] + t * (inside[row, k + 1, 1] - inside[row, k, 1])
    if share > 0:
        other = inside[row + 1, k, 0] + t * (inside[row + 1, k + 1, 0] - inside[row + 1, k, 0])
        first += share * (other - first)
        other = inside[row + 1, k, 1] + t * (inside[row + 1, k + 1, 1] - inside[row + 1, k, 1])
        second += share * (other - second)
    low = _single(1) if above >= 0 else _single(2) ** above  # below the first radius they go as its powers
    return first * low, second * low * low / scale


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _apart(a: Singles, b: Singles) -> float:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return x * x + y * y + z * z


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _times(a: float, b: Vector) -> Vector:
    return a * b[0], a * b[1], a * b[2]


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _add_triangle(
    found: Singles,
    sums: Singles,
    place: Singles,
    corners: Singles,
    light: Singles,
    inside: Singles,
    row: NDArray[np.int32],
    share: Singles,
    scale: Singles,
    octave: Singles,
) -> None:
    """Light of a triangle near the place, linear between its corners; `sums` (2, 4, channels) is room to work in."""
    x = (place[0], place[1], place[2])
    a = (corners[0, 0], corners[0, 1], corners[0, 2])
    b = (corners[1, 0], corners[1, 1], corners[1, 2])
    c = (corners[2, 0], corners[2, 1], corners[2, 2])
    ab, ac = _minus(b, a), _minus(c, a)
    normal = _cross(ab, ac)
    twice = math.sqrt(_dot(normal, normal))
    if twice <= 0:
        return
    normal = _times(1 / twice, normal)
    high = _dot(_minus(x, a), normal)
    foot = _minus(x, _times(high, normal))
    height = abs(high)
    log_height = math.log2(height + _single(1e-30))
    below = sums[1]
    for i in range(len(found)):
        below[0, i], below[1, i] = _within(log_height, inside, row[i], share[i], scale[i], octave[i])
        for k in range(4):
            sums[0, k, i] = 0
    from_a, from_b, from_c = _minus(a, foot), _minus(b, foot), _minus(c, foot)
    _add_edge(sums, from_a, from_b, normal, height, inside, row, share, scale, octave)
    _add_edge(sums, from_b, from_c, normal, height, inside, row, share, scale, octave)
    _add_edge(sums, from_c, from_a, normal, height, inside, row, share, scale, octave)
    over_b, over_c = _times(1 / twice, _cross(ac, normal)), _times(1 / twice, _cross(normal, ab))
    u, v = -_dot(over_b, from_a), -_dot(over_c, from_a)
    for i in range(len(found)):
        whole = sums[0, 0, i]
        moment = (sums[0, 1, i], sums[0, 2, i], sums[0, 3, i])
        rise_b, rise_c = light[1, i] - light[0, i], light[2, i] - light[0, i]
        value = (light[0, i] + u * rise_b + v * rise_c) * whole
        value += _dot(over_b, moment) * rise_b + _dot(over_c, moment) * rise_c
        least, most = min(light[0, i], light[1, i], light[2, i]), max(light[0, i], light[1, i], light[2, i])
        found[i] += min(max(value, least * whole), most * whole)


@numba.njit(fastmath=True, cache=True, error_model="numpy")
def _add_edge(
    sums: Singles,
    start: Vector,
    end: Vector,
    normal: Vector,
    height: float,
    inside: Singles,
    row: NDArray[np.int32],
    share: Singles,
    scale: Singles,
    octave: Singles,
) -> None:
    """The sector between the foot of the place and an edge, and its first moment, negative where it runs clockwise.

    Along the edge s = p sinh w, at the distance p from the foot, so that r = p cosh w and dφ = dw/cosh w.
    """
    along = _minus(end, start)
    length = math.sqrt(_dot(along, along))
    twice = _dot(_cross(start, end), normal)
    if abs(twice) <= _single(1e-6) * length * length:
        return
    p = abs(twice) / length
    along = _times(1 / length, along)
    first, last = _dot(start, along), _dot(end, along)
    out = _times(1 / p, _minus(start, _times(first, along)))
    low, high = math.asinh(first / p), math.asinh(last / p)
    sign = math.copysign(_single(0.5), twice)
    for side in range(2):
        a, b = (low, min(high, _single(0))) if side == 0 else (max(low, _single(0)), high)
        if b <= a:
            continue
        for node in range(len(_NODES)):
            w = _single(0.5) * (a + b + (b - a) * _NODES[node])
            cosh = math.cosh(w)
            turn = sign * (b - a) * _WEIGHTS[node] / cosh
            tanh = math.sqrt(max(1 - 1 / (cosh * cosh), _single(0))) * (1 - 2 * (side == 0))
            r = math.sqrt(p * p * cosh * cosh + height * height)
            log_r = math.log2(r + _single(1e-30))
            lean = math.sqrt(max(r - height, _single(0)) / (r + height + _single(1e-30)))
            for i in range(len(row)):
                whole, moment = _within(log_r, inside, row[i], share[i], scale[i], octave[i])
                sums[0, 0, i] += turn * (whole - sums[1, 0, i])
                moment = turn * (moment - sums[1, 1, i]) * lean
                sums[0, 1, i] += moment * (out[0] / cosh + tanh * along[0])
                sums[0, 2, i] += moment * (out[1] / cosh + tanh * along[1])
                sums[0, 3, i] += moment * (out[2] / cosh + tanh * along[2])
