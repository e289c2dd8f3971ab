"""Photon transport with absorption in the walk, seen by a camera: every collision sends its share towards it.

Not the engine, whose light is counted where photons leave, and not a table: this scores the radiance in the camera's
own direction, at every point of the surface. Lengths in 1/σt.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bssrdf.transport.photon import State, free_path, lambertian, normalised, reflectance_inside, scatter, uniform

Array = NDArray[np.float64]

_ROULETTE_BELOW = 0.1
_SURVIVORS_WEIGHT = 0.3
_FAINT = 25.0
"""Optical depth below the surface from which nothing is scored: e⁻²⁵ of a collision's light."""


class PeeledMedium(NamedTuple):
    """What the light walks in, as `peel_off` takes it; lengths in 1/σt."""

    albedo: float
    g: float
    eta: float
    cos_outside: float
    sin_beam: float
    thickness: float
    back: float


@njit(nogil=True, cache=True)
def peel_off(
    n_photons: int,
    state: State,
    albedo: float,
    g: float,
    eta: float,
    cos_outside: float,
    sin_beam: float,
    thickness: float,
    back: float,
    r_first: float,
    bins_per_e_fold: float,
    around: Array,
    line: Array,
) -> None:
    """Add ∫ L dA of n_photons that entered at the origin, in every bin, to `around` and `line`.

    The camera looks from +y at the outside cosine `cos_outside`; the beam runs towards it, at an angle to the normal
    whose sine outside is `sin_beam`. around: (n_r, n_phi), light scattered twice or more
    where it leaves the surface, n_phi bins of azimuth from +y over 0 to π; line: (n_r,), light scattered once, which
    leaves on the line towards +y. Radial bins: [0, r_first], then evenly in ln r. A face at depth `thickness`, maybe
    infinite, sends back the share `back` diffusely; to meet it counts as a scattering.
    """
    sin_inside = math.sqrt(1.0 - cos_outside * cos_outside) / eta
    cos_inside = math.sqrt(1.0 - sin_inside * sin_inside)
    reflected, _ = reflectance_inside(eta, cos_inside)
    passing = (1.0 - reflected) / (eta * eta * cos_inside)
    n_r, n_phi = around.shape
    for _ in range(n_photons):
        x = y = z = ux = 0.0
        uy = sin_beam / eta
        uz = math.sqrt(1.0 - uy * uy)
        weight = 1.0
        n = 0
        while True:
            d = free_path(state)
            while z + d * uz < 0.0:
                b = -z / uz
                x += ux * b
                y += uy * b
                z = 0.0
                d -= b
                weight *= reflectance_inside(eta, -uz)[0]
                uz = -uz
            at_back = z + d * uz > thickness
            if at_back:
                d = (thickness - z) / uz
            x += ux * d
            y += uy * d
            z += uz * d
            n += 1
            weight *= back if at_back else albedo
            if weight == 0.0:
                break
            depth = z / cos_inside
            if depth < _FAINT:
                cos_theta = uy * sin_inside - uz * cos_inside
                phase = cos_inside / math.pi
                if not at_back:
                    phase = (1.0 - g * g) / (4.0 * math.pi) * (1.0 + g * g - 2.0 * g * cos_theta) ** -1.5
                light = weight * phase * math.exp(-depth) * passing
                out = y + depth * sin_inside
                r = math.sqrt(x * x + out * out)
                i = 0 if r < r_first else 1 + int(math.log(r / r_first) * bins_per_e_fold)
                if i < n_r:
                    if n == 1:
                        line[i] += light
                    else:
                        around[i, min(int(math.acos(out / max(r, 1e-300)) / math.pi * n_phi), n_phi - 1)] += light
            if weight < _ROULETTE_BELOW:
                if uniform(state) * _SURVIVORS_WEIGHT > weight:
                    break
                weight = _SURVIVORS_WEIGHT
            if at_back:
                ux, uy, uz = lambertian(state)
            else:
                ux, uy, uz = scatter(state, g, ux, uy, uz)
            if n & 15 == 0:
                ux, uy, uz = normalised(ux, uy, uz)
