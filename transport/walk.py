"""The absorbing photon walk, compiled. Lengths in mean free paths 1/σt."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bssrdf.transport.exit_radiance import N_MU
from bssrdf.transport.photon import (
    State,
    azimuth,
    bin_of,
    free_path,
    lambertian,
    normalised,
    reflectance_inside,
    scatter,
    uniform,
)

ROULETTE_BELOW = 0.7
SPLIT_ABOVE = 2.0
MAX_COPIES = 8
MAX_SCATTERINGS = 1_000_000
FOLLOW = 0.85
"""How closely the weights follow the light's own decay: 1 would spend most time far out."""
STACK = 4096
"""Room for copies that wait; when it is full, photons stop being split."""
NO_FACE, TOP, BACK, WALL = -1, 0, 1, 2


class Vessel(NamedTuple):
    """What holds the medium, lengths in mean free paths; infinite where there is nothing."""

    depth: float
    back: float
    """Share of light that the back sends back diffusely; below 0 a smooth surface to air."""
    wall: float
    """Radius of an upright cylinder about the beam."""
    wall_is_black: bool


@njit(inline="always")
def target_weight(kappa: float, r_max: float, rho: float, z: float) -> float:
    """The weight that a photon should have at (rho, z): small far out, so that many photons are there.

    It follows the decay e^(−κ ρ) of the light itself up to the last bin; the deep, which returns less, gets fewer.
    """
    return math.exp(-FOLLOW * kappa * (rho - 2.0 * max(rho - r_max, 0.0) - 0.5 * z))


@njit(inline="always")
def to_wall(x: float, y: float, ux: float, uy: float, radius: float) -> float:
    """Way to the cylinder from a point inside."""
    across2 = ux * ux + uy * uy
    if across2 < 1e-18:
        return math.inf
    outwards = x * ux + y * uy
    room = max(radius * radius - x * x - y * y, 0.0)
    return (math.sqrt(outwards * outwards + across2 * room) - outwards) / across2


@njit(inline="always")
def at_wall(
    state: State, eta: float, x: float, y: float, ux: float, uy: float, uz: float
) -> tuple[bool, float, float, float]:
    """Whether light stays inside a smooth wall to air that it meets at (x, y), and its direction then."""
    rho = math.sqrt(x * x + y * y)
    nx, ny = x / rho, y / rho
    outwards = ux * nx + uy * ny
    reflected, _ = reflectance_inside(eta, min(abs(outwards), 1.0))
    return uniform(state) < reflected, ux - 2.0 * outwards * nx, uy - 2.0 * outwards * ny, uz


@njit(nogil=True, cache=True)
def walk(
    n_photons: int,
    state: State,
    albedo: float,
    g: float,
    eta: float,
    vessel: Vessel,
    radius: float,
    sin_incidence: float,
    kappa: float,
    edges: NDArray[np.float64],
    scores: NDArray[np.float64],
    paths: NDArray[np.float64],
    counts: NDArray[np.float64],
) -> None:
    """Follow n_photons and add their exits to `scores`, `paths` and `counts`.

    scores: (2 sides, 3 orders of scattering 0, 1, ≥ 2, n_r + 1, N_MU); paths: (2, n_r + 1), weight × path length;
    counts: (3,), steps, photons, and the weight given up after MAX_SCATTERINGS. A photon that meets the surface scores
    the share that Fresnel lets out, and then is reflected with the remaining probability. Every few scatterings it is
    split or put to roulette so that its weight stays near `target_weight`.
    """
    cos_incidence = math.sqrt(1.0 - sin_incidence * sin_incidence)
    sin_inside = sin_incidence / eta
    r_max = edges[-1]
    every = min(16, max(1, int(1.0 / max(kappa, 1e-9))))
    stack = np.empty((STACK, 9))
    waiting = 0
    started = 0
    steps = 0
    while waiting > 0 or started < n_photons:
        if waiting > 0:
            waiting -= 1
            x, y, z = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2]
            ux, uy, uz = stack[waiting, 3], stack[waiting, 4], stack[waiting, 5]
            weight, path, n = stack[waiting, 6], stack[waiting, 7], int(stack[waiting, 8])
        else:
            started += 1
            x = y = z = path = 0.0
            if radius > 0.0:
                cos_a, sin_a = azimuth(state)
                offset = radius * math.sqrt(0.5 * free_path(state))
                x = offset * cos_a / cos_incidence
                y = offset * sin_a
            ux, uy, uz = sin_inside, 0.0, math.sqrt(1.0 - sin_inside * sin_inside)
            weight = 1.0
            n = 0
        while True:
            steps += 1
            d = free_path(state)
            alive = True
            while True:
                face, b = NO_FACE, d
                to_z = z + d * uz
                if to_z < 0.0:
                    face, b = TOP, -z / uz
                elif to_z > vessel.depth:
                    face, b = BACK, (vessel.depth - z) / uz
                if vessel.wall < math.inf:
                    aside = to_wall(x, y, ux, uy, vessel.wall)
                    if aside < b:
                        face, b = WALL, aside
                if face == NO_FACE:
                    break
                x += ux * b
                y += uy * b
                path += b
                d -= b
                if face == WALL:
                    z += uz * b
                    alive = not vessel.wall_is_black
                    if alive:
                        alive, ux, uy, uz = at_wall(state, eta, x, y, ux, uy, uz)
                    if not alive:
                        break
                    continue
                z = 0.0 if face == TOP else vessel.depth
                if face == BACK and vessel.back > 0.0:
                    alive = uniform(state) < vessel.back
                    if not alive:
                        break
                    ux, uy, uz = lambertian(state)
                    n += 1
                    continue
                reflected, mu = 0.0, uz
                if face == TOP or vessel.back < 0.0:
                    reflected, mu = reflectance_inside(eta, abs(uz))
                if reflected < 1.0:
                    out = weight * (1.0 - reflected)
                    i = bin_of(edges, math.sqrt(x * x + y * y))
                    scores[face, min(n, 2), i, min(int(mu * mu * N_MU), N_MU - 1)] += out
                    paths[face, i] += out * path
                    if uniform(state) >= reflected:
                        alive = False
                        break
                uz = -uz
            if not alive:
                break
            x += ux * d
            y += uy * d
            z += uz * d
            path += d
            n += 1
            weight *= albedo
            copies = 1
            if n % every == 0:
                target = target_weight(kappa, r_max, math.sqrt(x * x + y * y), z)
                if weight < ROULETTE_BELOW * target:
                    if uniform(state) * target >= weight:
                        break
                    weight = target
                elif weight > SPLIT_ABOVE * target:
                    copies = min(int(weight / target), MAX_COPIES, 1 + STACK - waiting)
                    weight /= copies
            if n >= MAX_SCATTERINGS:
                counts[2] += weight
                break
            for _ in range(copies - 1):
                vx, vy, vz = scatter(state, g, ux, uy, uz)
                stack[waiting, 0], stack[waiting, 1], stack[waiting, 2] = x, y, z
                stack[waiting, 3], stack[waiting, 4], stack[waiting, 5] = vx, vy, vz
                stack[waiting, 6], stack[waiting, 7], stack[waiting, 8] = weight, path, n
                waiting += 1
            ux, uy, uz = scatter(state, g, ux, uy, uz)
            if n & 15 == 0:
                ux, uy, uz = normalised(ux, uy, uz)
    counts[0] += steps
    counts[1] += n_photons
