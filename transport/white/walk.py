"""The white walk, compiled: photons that scatter without absorption and serve many media at once. Lengths in 1/σt.

In units of 1/σt a path of n scatterings is as likely in every medium of one g, but for the factor albedo^n. So one
walk, scored with albedo^n, gives the light of any albedo; and a walk that is always reflected at the surface, with a
weight Fr for each index, gives that of any index. The same random numbers serve all of them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bssrdf.transport.exit_radiance import N_MU
from bssrdf.transport.photon import (
    State,
    free_path,
    normalised,
    reflectance_inside,
    scatter,
    uniform,
)

Floats = NDArray[np.float64]

ROULETTE_BELOW = 0.6
SPLIT_ABOVE = 2.0
MAX_COPIES = 8
STACK = 4096
"""Room for copies that wait; when it is full, photons stop being split."""
COARSE = 4
"""Radial bins that share one bin of exit directions."""


@njit(inline="always")
def across_weight(cos_azimuth: float) -> float:
    """Weight whose mean over light is its radiance across the radius less that over all azimuths.

    From the cosine of the azimuth between the radius and the direction: −a₂ + a₄ − a₆/2, the even harmonics at 90°. The
    half stands for the alternating rest, which matters within one mean free path only.
    """
    second = 2.0 * cos_azimuth * cos_azimuth - 1.0
    return -2.0 * second + 2.0 * (2.0 * second * second - 1.0) - second * (4.0 * second * second - 3.0)


@njit(inline="always")
def jump_factor(kappa_s: float) -> float:
    """Mean of albedo^n until diffusing light first leaves a sphere of radius s about its start, κ s/sinh(κ s)."""
    return 1.0 if kappa_s < 1e-9 else kappa_s / math.sinh(kappa_s)


@njit(nogil=True, cache=True)
def white_walk(
    n_photons: int,
    state: State,
    g: float,
    etas: Floats,
    sines: Floats,
    across_beam: bool,
    albedos: Floats,
    kappas: Floats,
    follow: float,
    r_unit: float,
    r_zero: float,
    bins_per_v: float,
    jump_depth: float,
    jump_margin: float,
    curve: Floats,
    angles: Floats,
    across: Floats,
    totals: Floats,
) -> int:
    """Follow n_photons, add their exits to the scores, and return the number of steps.

    sines: (n_eta,), of the beam's angle inside; all 0, or a single index, since each bends the beam in its own way.
    across_beam: the curve is scored as at a right angle to the plane of incidence, else as the mean over all azimuths.
    albedos, kappas: (n_a,), decay constants in 1/σt, the first the albedo whose light is sampled in proportion.
    follow: the decay [σt] that the photons' weights follow outwards.
    Radial bins are uniform in v = ln(1 + r/(r_unit r_zero)), bins_per_v of them a unit, r_unit the walk's 1/σt′.
    curve: (n_r + 1, n_eta, n_a), light scattered twice or more, the last bin all beyond; angles: (n_r / COARSE,
    n_eta, n_a, N_MU), the same by direction; across: how much more of it leaves at a right angle to the radius;
    totals: (2, n_eta, n_a), light scattered once, and twice or more.
    Deeper than jump_depth a photon jumps to a sphere about it that ends jump_margin under the surface, as diffusing
    light does: this continues the longest paths analytically.
    """
    n_eta, n_a = etas.size, albedos.size
    n_r = curve.shape[0] - 1
    log_albedo = np.log(albedos)
    log_first = log_albedo[0]
    second = albedos[0] ** 2  # every photon scatters twice: the first order is known exactly, not sampled
    r_max = r_unit * r_zero * math.expm1(n_r / bins_per_v)
    every = min(16, max(1, int(1.0 / max(follow, 1e-9))))
    offset = g / (1.0 - g)
    by_index = np.empty(n_eta)
    by_jump = np.empty(n_a)
    surviving = np.empty(n_a)
    stack = np.empty((STACK, 8 + n_eta + n_a))
    waiting = 0
    started = 0
    steps = 0
    while waiting > 0 or started < n_photons:
        if waiting > 0:
            waiting -= 1
            row = stack[waiting]
            x, y, z, ux, uy, uz, weight, n = row[0], row[1], row[2], row[3], row[4], row[5], row[6], int(row[7])
            by_index[:] = row[8 : 8 + n_eta]
            by_jump[:] = row[8 + n_eta :]
        else:
            started += 1
            x = y = z = uy = 0.0
            ux, uz = sines[0], math.sqrt(1.0 - sines[0] * sines[0])
            weight = 1.0
            n = 0
            by_index[:] = 1.0
            by_jump[:] = 1.0
        while True:
            steps += 1
            d = free_path(state)
            alive = True
            while z + d * uz < 0.0:
                b = -z / uz
                x += ux * b
                y += uy * b
                z = 0.0
                d -= b
                before = after = 0.0
                rho = math.sqrt(x * x + y * y)
                i = min(int(math.log1p(rho / (r_unit * r_zero)) * bins_per_v), n_r)
                k = i // COARSE
                sine = math.sqrt(ux * ux + uy * uy)
                side = 1.0 + across_weight(x / max(rho, 1e-300)) if across_beam else 1.0
                sideways = across_weight((x * ux + y * uy) / max(rho * sine, 1e-300))
                for a in range(n_a):
                    surviving[a] = weight * by_jump[a] * math.exp(n * log_albedo[a])
                for e in range(n_eta):
                    reflected, mu = reflectance_inside(etas[e], -uz)
                    before = max(before, by_index[e])
                    passed = by_index[e] * (1.0 - reflected)
                    by_index[e] *= reflected
                    after = max(after, by_index[e])
                    if passed > 0.0:
                        m = min(int(mu * mu * N_MU), N_MU - 1)
                        for a in range(n_a):
                            out = passed * surviving[a]
                            totals[min(n, 2) - 1, e, a] += out
                            if n > 1:
                                curve[i, e, a] += out * side
                                if i < n_r:
                                    angles[k, e, a, m] += out
                                    across[k, e, a, m] += out * sideways
                if uniform(state) * before >= after:
                    alive = False
                    break
                weight *= before / after
                uz = -uz
            if not alive:
                break
            x += ux * d
            y += uy * d
            z += uz * d
            n += 1
            if n >= 2 and z > jump_depth:
                s = z - jump_margin
                for a in range(n_a):
                    by_jump[a] *= jump_factor(kappas[a] * s)
                x += offset * ux
                y += offset * uy
                z += offset * uz
                ux, uy, uz = scatter(state, 0.0, ux, uy, uz)
                x += s * ux
                y += s * uy
                z += s * uz
                ux, uy, uz = scatter(state, 0.0, ux, uy, uz)
                continue
            copies = 1
            if n >= 2 and n % every == 0:
                strength = 0.0
                for e in range(n_eta):
                    strength = max(strength, by_index[e])
                now = weight * strength * by_jump[0] * math.exp(n * log_first)
                rho = math.sqrt(x * x + y * y)
                target = second * math.exp(-follow * (rho - 2.0 * max(rho - r_max, 0.0) - 0.5 * z))
                if now < ROULETTE_BELOW * target:
                    if uniform(state) * target >= now:
                        break
                    weight *= target / now
                elif now > SPLIT_ABOVE * target:
                    copies = min(int(now / target), MAX_COPIES, 1 + STACK - waiting)
                    weight /= copies
            for _ in range(copies - 1):
                vx, vy, vz = scatter(state, g, ux, uy, uz)
                row = stack[waiting]
                row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7] = x, y, z, vx, vy, vz, weight, n
                row[8 : 8 + n_eta] = by_index
                row[8 + n_eta :] = by_jump
                waiting += 1
            ux, uy, uz = scatter(state, g, ux, uy, uz)
            if n & 15 == 0:
                ux, uy, uz = normalised(ux, uy, uz)
    return steps
