"""The absorbing photon walk, compiled. Lengths in mean free paths 1/σt."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bssrdf.transport.exit_radiance import N_MU
from bssrdf.transport.photon import (
    State,
    azimuth,
    bin_of,
    free_path,
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
"""Room for copies that wait; when it is full, photons are no longer split."""


@njit(inline="always")
def target_weight(kappa: float, r_max: float, rho: float, z: float) -> float:
    """The weight that a photon should have at (rho, z): small far out, so that many photons are there.

    It follows the decay e^(−κ ρ) of the light itself up to the last bin; the deep, which returns less, gets fewer.
    """
    return math.exp(-FOLLOW * kappa * (rho - 2.0 * max(rho - r_max, 0.0) - 0.5 * z))


@njit(nogil=True, cache=True)
def walk(
    n_photons: int,
    state: State,
    albedo: float,
    g: float,
    eta: float,
    depth: float,
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
                to_z = z + d * uz
                if to_z >= 0.0 and to_z <= depth:
                    break
                wall = 0.0 if to_z < 0.0 else depth
                b = (wall - z) / uz
                x += ux * b
                y += uy * b
                z = wall
                path += b
                d -= b
                reflected, mu, side = 0.0, uz, 1
                if to_z < 0.0:
                    side = 0
                    reflected, mu = reflectance_inside(eta, -uz)
                if reflected < 1.0:
                    out = weight * (1.0 - reflected)
                    i = bin_of(edges, math.sqrt(x * x + y * y))
                    scores[side, min(n, 2), i, min(int(mu * mu * N_MU), N_MU - 1)] += out
                    paths[side, i] += out * path
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
