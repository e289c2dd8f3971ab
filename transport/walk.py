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
SURVIVORS_WEIGHT = 1.0
MAX_SCATTERINGS = 1_000_000


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
    edges: NDArray[np.float64],
    scores: NDArray[np.float64],
    paths: NDArray[np.float64],
    counts: NDArray[np.int64],
) -> None:
    """Follow n_photons and add their exits to `scores`, `paths` and `counts`.

    scores: (2 sides, 3 orders of scattering 0, 1, ≥ 2, n_r + 1, N_MU); paths: (2, n_r + 1), weight × path length;
    counts: (3,), steps, photons, and photons given up after MAX_SCATTERINGS. A photon that meets the surface scores
    the share that Fresnel lets out, and then is reflected with the remaining probability.
    """
    cos_incidence = math.sqrt(1.0 - sin_incidence * sin_incidence)
    sin_inside = sin_incidence / eta
    steps = 0
    for _ in range(n_photons):
        x = y = z = path = 0.0
        if radius > 0.0:
            cos_a, sin_a = azimuth(state)
            offset = radius * math.sqrt(-0.5 * math.log(1.0 - uniform(state)))
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
            if weight < ROULETTE_BELOW:
                if uniform(state) * SURVIVORS_WEIGHT >= weight:
                    break
                weight = SURVIVORS_WEIGHT
            if n >= MAX_SCATTERINGS:
                counts[2] += 1
                break
            ux, uy, uz = scatter(state, g, ux, uy, uz)
            if n & 15 == 0:
                ux, uy, uz = normalised(ux, uy, uz)
    counts[0] += steps
    counts[1] += n_photons
