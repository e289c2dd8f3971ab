"""Photon transport of an oblique beam, scored at every collision towards cameras in its plane. No table.

No two azimuths about such a beam are alike: a slice across its plane is scored in a narrow sector about it. Lengths in
1/σt.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bssrdf.bench.camera_walk import FAINT, ROULETTE_BELOW, SURVIVORS_WEIGHT, phase
from bssrdf.transport.photon import State, free_path, normalised, reflectance_inside, scatter, uniform

Floats = NDArray[np.float64]

HALF_SECTOR = math.radians(10.0)
"""On either side of the slice; over it the second harmonic of the light falls by 2 %."""


@njit(nogil=True, cache=True)
def oblique_walk(
    n_photons: int,
    state: State,
    albedo: float,
    g: float,
    eta: float,
    sin_beam: float,
    sines: Floats,
    r_first: float,
    rings_per_e_fold: float,
    across: Floats,
    around: Floats,
    total: Floats,
) -> None:
    """Add ∫ L dA of n_photons that entered at the origin and run on towards +x, towards cameras in the x–z plane.

    `sines` of the cameras' angles outside are positive where the beam runs to. across, around: (cameras, rings), light
    of the sectors about ±y over their share of a circle, and of all azimuths; total: (cameras,). Rings: [0, r_first],
    then evenly in ln r.
    """
    inside = np.sqrt(1.0 - (sines / eta) ** 2)
    passing = np.empty(sines.size)
    for a in range(sines.size):
        passing[a] = (1.0 - reflectance_inside(eta, inside[a])[0]) / (eta * eta * inside[a]) / (4.0 * math.pi)
    n_rings = across.shape[1]
    widest, share = math.sin(HALF_SECTOR), 2.0 * HALF_SECTOR / math.pi
    for _ in range(n_photons):
        x = y = z = uy = 0.0
        ux = sin_beam / eta
        uz = math.sqrt(1.0 - ux * ux)
        weight = 1.0
        order = 0
        while True:
            d = free_path(state)
            while z + d * uz < 0.0:
                b = -z / uz
                x, y, z, d = x + ux * b, y + uy * b, 0.0, d - b
                weight *= reflectance_inside(eta, -uz)[0]
                uz = -uz
            x, y, z = x + ux * d, y + uy * d, z + uz * d
            weight *= albedo
            order += 1
            for a in range(sines.size if z < FAINT else 0):
                depth = z / inside[a]
                if depth > FAINT:
                    continue
                towards = ux * sines[a] / eta - uz * inside[a]
                light = weight * math.exp(-depth) * passing[a] * phase(g, towards)
                total[a] += light
                out = x + depth * sines[a] / eta
                r = math.sqrt(out * out + y * y)
                i = 0 if r < r_first else 1 + int(math.log(r / r_first) * rings_per_e_fold)
                if i < n_rings:
                    around[a, i] += light
                    if abs(out) < r * widest:
                        across[a, i] += light / share
            if weight < ROULETTE_BELOW:
                if uniform(state) * SURVIVORS_WEIGHT > weight:
                    break
                weight = SURVIVORS_WEIGHT
            ux, uy, uz = scatter(state, g, ux, uy, uz)
            if order & 15 == 0:
                ux, uy, uz = normalised(ux, uy, uz)
