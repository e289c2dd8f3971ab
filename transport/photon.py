"""What every photon walk is made of, compiled: random numbers, flight, scattering, the surface. Lengths in 1/σt."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

State = NDArray[np.uint64]
"""Four words of xoshiro256+, changed in place by each draw."""


CACHE_LINES = 32
"""Words from one stream's state to the next: threads that write to one cache line would wait for each other."""


def stream_states(seed: int, n_streams: int, *key: int) -> NDArray[np.uint64]:
    """Independent generator states of shape (n_streams, 4), the same for one seed and key on every machine."""
    children = np.random.SeedSequence(seed, spawn_key=key).spawn(n_streams)
    states = np.zeros((n_streams, CACHE_LINES), np.uint64)
    states[:, :4] = [child.generate_state(4, np.uint64) for child in children]
    return states[:, :4]


@njit(inline="always")
def uniform(state: State) -> float:
    """Next number in [0, 1): xoshiro256+, Blackman and Vigna 2021."""
    result = state[0] + state[3]
    shifted = state[1] << np.uint64(17)
    state[2] ^= state[0]
    state[3] ^= state[1]
    state[1] ^= state[2]
    state[0] ^= state[3]
    state[2] ^= shifted
    state[3] = (state[3] << np.uint64(45)) | (state[3] >> np.uint64(19))
    return (result >> np.uint64(11)) * 1.1102230246251565e-16


def _ziggurat() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right edges of 256 layers of equal area under e^−x, and e^−x there (Marsaglia and Tsang 2000)."""
    x = np.empty(257)
    x[1] = 7.697117470131487
    area = math.exp(-x[1]) * (x[1] + 1)
    x[0] = area / math.exp(-x[1])
    for i in range(2, 256):
        x[i] = -math.log(area / x[i - 1] + math.exp(-x[i - 1]))
    x[256] = 0.0
    return x, np.exp(-x)


_EDGE, _HEIGHT = _ziggurat()


@njit(inline="always")
def free_path(state: State) -> float:
    """Distance to the next collision, in mean free paths: the ziggurat, which takes no logarithm 99 times in 100."""
    start = 0.0
    while True:
        u = uniform(state) * 256.0
        layer = int(u)
        x = (u - layer) * _EDGE[layer]
        if x < _EDGE[layer + 1]:
            return start + x
        if layer == 0:
            start += _EDGE[1]  # beyond the last layer the law starts again
        elif _HEIGHT[layer] + uniform(state) * (_HEIGHT[layer + 1] - _HEIGHT[layer]) < math.exp(-x):
            return start + x


@njit(inline="always")
def azimuth(state: State) -> tuple[float, float]:
    """Cosine and sine of a uniform angle, without calling either (von Neumann)."""
    while True:
        a = 2.0 * uniform(state) - 1.0
        b = uniform(state)
        s = a * a + b * b
        if 1e-30 < s <= 1.0:
            return (a * a - b * b) / s, 2.0 * a * b / s


@njit(inline="always")
def lambertian(state: State) -> tuple[float, float, float]:
    """A direction upwards, as a diffuse back sends light."""
    cos_a, sin_a = azimuth(state)
    across2 = uniform(state)
    across = math.sqrt(across2)
    return across * cos_a, across * sin_a, -math.sqrt(1.0 - across2)


@njit(inline="always")
def scattering_cosine(state: State, g: float) -> float:
    """Cosine of a Henyey–Greenstein deflection."""
    if abs(g) < 1e-4:  # the closed form below divides by g; here it is its own first order
        c = 2.0 * uniform(state) - 1.0
        return c + 1.5 * g * (1.0 - c * c)
    t = (1.0 - g * g) / (1.0 - g + 2.0 * g * uniform(state))
    return min(1.0, max(-1.0, (1.0 + g * g - t * t) / (2.0 * g)))


@njit(inline="always")
def scatter(state: State, g: float, ux: float, uy: float, uz: float) -> tuple[float, float, float]:
    """A new direction after one Henyey–Greenstein scattering."""
    c = scattering_cosine(state, g)
    s = math.sqrt(1.0 - c * c)
    cos_a, sin_a = azimuth(state)
    if g == 0.0:
        return s * cos_a, s * sin_a, c
    sign = math.copysign(1.0, uz)  # an orthonormal basis about u without a square root: Duff et al. 2017
    k = -1.0 / (sign + uz)
    m = ux * uy * k
    p, q = s * cos_a, s * sin_a
    vx = c * ux + p * (1.0 + sign * ux * ux * k) + q * m
    vy = c * uy + p * sign * m + q * (sign + uy * uy * k)
    vz = c * uz - p * sign * ux - q * uy
    return vx, vy, vz


@njit(inline="always")
def normalised(ux: float, uy: float, uz: float) -> tuple[float, float, float]:
    """A direction whose length has drifted by rounding, at length 1 again."""
    fix = 1.5 - 0.5 * (ux * ux + uy * uy + uz * uz)
    return ux * fix, uy * fix, uz * fix


@njit(inline="always")
def reflectance_inside(eta: float, cos_inside: float) -> tuple[float, float]:
    """Fr for unpolarised light that meets the surface from inside, and the cosine outside (0 in total reflection)."""
    outside2 = 1.0 - eta * eta * (1.0 - cos_inside * cos_inside)
    if outside2 <= 0.0:
        return 1.0, 0.0
    cos_outside = math.sqrt(outside2)
    r_s = (eta * cos_inside - cos_outside) / (eta * cos_inside + cos_outside)
    r_p = (cos_inside - eta * cos_outside) / (cos_inside + eta * cos_outside)
    return 0.5 * (r_s * r_s + r_p * r_p), cos_outside


@njit(inline="always")
def bin_of(edges: NDArray[np.float64], value: float) -> int:
    """Index of the bin [edges[i], edges[i+1]) that holds `value`; the last index is the overflow. edges[0] is 0."""
    lo, hi = 0, edges.size - 1
    if value >= edges[hi]:
        return hi
    while hi - lo > 1:
        mid = (lo + hi) >> 1
        if value >= edges[mid]:
            lo = mid
        else:
            hi = mid
    return lo
