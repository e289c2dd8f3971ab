"""What a sample's back and walls make of a half space's light, as a ratio of two diffusion solutions.

R(r) = R_half(r) · F(r)/F_half(r), and the total likewise. Both F are of diffusion from a point source, with Robin's
condition at every face, φ = z ∂φ/∂n: extrapolated boundaries will not do, as that of a white back lies 13 mean free
paths away. The lengths z are those of exact transport (`milne`), and the source lies as deep as makes the half space
lose what the model loses near albedo 1; so a thick bright slab's total is exact. Over the transverse wavenumber k a
slab's F is a closed form in μ² = q² + k², and differs from a half space's by e^(−2μτ). A dish's wall takes away a sum
over the slab's modes in depth, which falls as fast with its distance.

Lengths in 1/σt′, F in reduced form, as in `light`: shapes q (b, 1), x (b, n); slopes by ln σt′ leave all mm alone.
Everything is even in q.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np

from bssrdf.transport.arrays import NUMPY, ById, Engine
from bssrdf.transport.dish import Dish, changed_by_wall, of_wall, taken_by_wall
from bssrdf.transport.light import SMALLEST_Q, Light, Look
from bssrdf.transport.slab import Hankel, Top, changed_by_backs, loss_of, milne, of_back, spectrum

SLOPE_Q = 1e-4
"""Where the total's slope near albedo 1 is taken."""
DEEP = 3.0
"""In radii of a dish: what is deeper sends back 1e-6 of the light."""
_LINE, _LINE_WEIGHTS = np.polynomial.laguerre.laggauss(16)
_TINY = 1e-30
LEAST_RATIO = 1e-8


Kind = Literal["half", "slab", "dish"]
"""What back and walls a sample has."""


class Sample(NamedTuple):
    """Depth, back and wall of a sample, (b, 1) each; infinite lengths where it has none."""

    thickness_mm: Any
    back: Any
    """Diffuse reflectance, 0 to 1."""
    radius_mm: Any
    """Of a round dish with the beam on its axis."""
    wall: Any
    """As `back`."""


def top_of(model: Light) -> Top:
    """Near albedo 1 a half space's total is 1 − (source + z) q: the model's own slope gives the source."""
    return _top(ById(model))


@lru_cache(maxsize=64)
def _top(key: ById) -> Top:
    z = milne(key.it.eta)
    slope = key.it.total(NUMPY, np.array([[SLOPE_Q]]))[1][0, 0]
    return Top(float(-slope - z), z)


def log_ratio(e: Engine, dish: bool, sample: Sample, top: Top, log_sigma: Any, q: Any, r: Any) -> Look:
    """ln R/R_half at r [mm], (b, n), and its slopes by ln σt′ and q."""
    xp = e.xp
    half = half_space(e, top, q, xp.exp(log_sigma) * r)
    return of_change(e, half, change(e, dish, sample, top, log_sigma, q, r))


def of_change(e: Engine, half: Look, less: Look) -> Look:
    """The same from its parts."""
    xp = e.xp
    ratio, told = _ratio(xp, half[0], less[0])
    base, safe = xp.where(told, half[0], 1.0), xp.where(told, ratio, 1.0)
    slopes = [
        xp.where(told, (change_by - (ratio - 1) * half_by) / base / safe, 0.0)
        for change_by, half_by in zip(less[1:], half[1:], strict=True)
    ]
    return level_of_change(e, half[0], less[0]), slopes[0], slopes[1]


def level_of_change(e: Engine, half: Any, less: Any) -> Any:
    """The value alone."""
    ratio, _ = _ratio(e.xp, half, less)
    return e.xp.log(e.xp.maximum(ratio, LEAST_RATIO))


def _ratio(xp: Any, half: Any, less: Any) -> tuple[Any, Any]:
    """1 where there is no light; and where it is known."""
    lit = half > _TINY
    ratio = xp.where(lit, 1 + less / xp.where(lit, half, 1.0), 1.0)
    return ratio, lit & (ratio > LEAST_RATIO)


def half_space(e: Engine, top: Top, q: Any, x: Any) -> Look:
    """F_half and its slopes by ln x and q: a line of images above the surface, e^(−t) along it."""
    x2, d2, d, y, pulse = _images(e.xp, top, q, x)
    by_x = -(x2 / d2 * (3 + 3 * y + y * y) * pulse).sum(-1)
    return ((1 + y) * pulse).sum(-1), by_x, e.xp.sign(q) * -(y * d * pulse).sum(-1)


def level_of_half_space(e: Engine, top: Top, q: Any, x: Any) -> Any:
    """The value alone."""
    *_, y, pulse = _images(e.xp, top, q, x)
    return ((1 + y) * pulse).sum(-1)


def _images(xp: Any, top: Top, q: Any, x: Any) -> tuple[Any, ...]:
    aq = xp.maximum(xp.abs(q), SMALLEST_Q)[..., None]
    z = top.source + top.z * xp.asarray(_LINE)
    x2 = (x * x)[..., None]
    d2 = x2 + z * z
    d = xp.sqrt(d2)
    y = aq * d
    return x2, d2, d, y, xp.asarray(_LINE_WEIGHTS / (2 * np.pi)) * z * xp.exp(-y) / (d2 * d)


def change(e: Engine, dish: bool, sample: Sample, top: Top, log_sigma: Any, q: Any, r: Any) -> Look:
    """F − F_half at r [mm], and its slopes by ln σt′ and q."""
    here = _in_paths(e, dish, sample, log_sigma)
    back = of_back(e, top, here.back, here.tau, q, e.xp.exp(log_sigma) * r / here.tau)
    if not dish:
        return back
    wall = of_wall(e, here, top, q, r / sample.radius_mm)
    return tuple(a + b for a, b in zip(back, wall, strict=True))


def changes(
    e: Engine, dish: bool, by: Hankel, near: Sequence[Sample], about: Sample, top: Top, log_sigma: Any, q: Any, r: Any
) -> list[Any]:
    """F − F_half alone, for samples near one."""
    xp = e.xp
    every = [_in_paths(e, dish, sample, log_sigma) for sample in near]
    tau = _in_paths(e, dish, about, log_sigma).tau
    found = changed_by_backs(e, by, top, [(one.back, one.tau) for one in every], tau, q, xp.exp(log_sigma) * r / tau)
    if not dish:
        return found
    n, b = len(near), q.shape[0]
    joined = Dish(*(xp.concatenate(each, axis=0) for each in zip(*every, strict=True)))
    shares = xp.concatenate([r / sample.radius_mm for sample in near], axis=0)
    walls = changed_by_wall(e, joined, top, xp.concatenate([q] * n, axis=0), shares)
    return [each + walls[k * b : (k + 1) * b] for k, each in enumerate(found)]


def total_ratio(e: Engine, dish: bool, sample: Sample, top: Top, log_sigma: Any, q: Any) -> Look:
    """R/R_half over the whole surface, (b, 1), and its slopes by ln σt′ and q."""
    xp = e.xp
    aq = xp.maximum(xp.abs(q), SMALLEST_Q)
    here = _in_paths(e, dish, sample, log_sigma)
    slab = spectrum(e, top, here.back, here.tau, aq)
    value, by_s, by_q = slab.value, here.tau * slab.by_tau, slab.by_mu
    if dish:
        taken = taken_by_wall(e, here, top, aq)
        value, by_s, by_q = (a - b for a, b in zip((value, by_s, by_q), taken, strict=True))
    over_half = xp.exp(aq * top.source) * (1 + aq * top.z)
    by_half = top.source + top.z / (1 + aq * top.z)
    return over_half * value, over_half * by_s, xp.sign(q) * over_half * (by_q + by_half * value)


def _in_paths(e: Engine, dish: bool, sample: Sample, log_sigma: Any) -> Dish:
    sigma, back = e.xp.exp(log_sigma), loss_of(sample.back)
    if not dish:
        return Dish(sigma * sample.thickness_mm, back, sample.radius_mm, sample.wall)
    depth = e.xp.minimum(sample.thickness_mm, DEEP * sample.radius_mm)
    return Dish(sigma * depth, back, sigma * sample.radius_mm, loss_of(sample.wall))
