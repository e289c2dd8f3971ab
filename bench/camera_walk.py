"""Photon transport scored exactly at a right angle to the plane of view, as a thin slice across it is seen. No table.

About the beam all azimuths are alike: each collision may be turned so that the light it sends towards the camera leaves
the surface at a right angle to the camera's plane. So all of them score, no sector is averaged over, and no harmonic is
cut off. Lengths in 1/σt.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bssrdf.transport.photon import State, free_path, normalised, reflectance_inside, scatter, uniform

Floats = NDArray[np.float64]

FAINT = 14.0
"""Optical depth from which nothing is scored: e⁻¹⁴ of a collision's light."""
ROULETTE_BELOW, SURVIVORS_WEIGHT = 0.1, 0.3


@njit(inline="always")
def phase(g: float, cos_theta: float) -> float:
    """4π times Henyey–Greenstein's."""
    x = 1.0 + g * g - 2.0 * g * cos_theta
    return (1.0 - g * g) / (x * math.sqrt(x))


@njit(nogil=True, cache=True)
def camera_walk(
    n_photons: int,
    state: State,
    albedo: float,
    g: float,
    eta: float,
    cosines: Floats,
    r_first: float,
    rings_per_e_fold: float,
    across: Floats,
    around: Floats,
    total: Floats,
) -> None:
    """Add ∫ L dA of n_photons that entered at the origin along the normal, towards each of `cosines` outside.

    across, around: (angles, rings), light scattered twice or more, as if all azimuths were at a right angle to the
    plane of view, and over all azimuths; total: (angles,), all light. Rings: [0, r_first], then evenly in ln r.
    """
    sines = np.sqrt(1.0 - cosines * cosines) / eta
    inside = np.sqrt(1.0 - sines * sines)
    passing = np.empty(cosines.size)
    for a in range(cosines.size):
        passing[a] = (1.0 - reflectance_inside(eta, inside[a])[0]) / (eta * eta * inside[a]) / (4.0 * math.pi)
    n_rings = across.shape[1]
    for _ in range(n_photons):
        x = y = z = ux = uy = 0.0
        uz = weight = 1.0
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
            rho = math.sqrt(x * x + y * y)
            for a in range(cosines.size if z < FAINT else 0):
                depth = z / inside[a]
                if depth > FAINT:
                    continue
                light = weight * math.exp(-depth) * passing[a]
                aside = depth * sines[a]  # on its way up it moves by this towards the camera, here at +y
                straight = light * phase(g, uy * sines[a] - uz * inside[a])
                total[a] += straight
                if order == 1:
                    continue
                r = math.sqrt(x * x + (y + aside) ** 2)
                i = 0 if r < r_first else 1 + int(math.log(r / r_first) * rings_per_e_fold)
                if i < n_rings:
                    around[a, i] += straight
                if aside < rho:
                    r = math.sqrt(rho * rho - aside * aside)
                    i = 0 if r < r_first else 1 + int(math.log(r / r_first) * rings_per_e_fold)
                    if i < n_rings:  # two cameras see it at a right angle; a turn by dβ turns the place by dβ
                        back = aside / rho
                        side = math.sqrt(1.0 - back * back)
                        outwards, along = (ux * x + uy * y) / rho, (uy * x - ux * y) / rho
                        for sign in (-1.0, 1.0):
                            towards = (sign * along * side - outwards * back) * sines[a]
                            across[a, i] += light * phase(g, towards - uz * inside[a]) / 2.0
            if weight < ROULETTE_BELOW:
                if uniform(state) * SURVIVORS_WEIGHT > weight:
                    break
                weight = SURVIVORS_WEIGHT
            ux, uy, uz = scatter(state, g, ux, uy, uz)
            if order & 15 == 0:
                ux, uy, uz = normalised(ux, uy, uz)
