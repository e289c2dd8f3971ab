"""The dipole and the sampling of its radius on Dr.Jit arrays: Jensen et al. 2001, section 2.1 and eq. 4.

Lengths in scene units, coefficients in 1/scene unit. Everything is elementwise: one channel (`Float`) or all of them
(`Spectrum`) at a time, in single precision, and finite at r = 0 and at sigma_a = 0. The literal forms in float64 are
those of `transport.dipole`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import drjit as dr

Value = Any
"""A Dr.Jit array of one channel or of all; Mitsuba and Dr.Jit have no static types."""

Law = Literal["exact", "exponential"]
LAWS = ("exact", "exponential")
TAIL = 5e-4
"""Share of the diffusely reflected light beyond the probes' reach, which is left out."""

_FARTHEST = 5e3
"""Reduced mean free paths: single precision would blur the depth of the source for a longer probe."""
_LEAST_ARGUMENT = 2.0**-24
_WIDEST_DECAY = 1e3
"""The exponential is not a density at σtr = 0: it falls at least once in so many reduced mean free paths."""


@dataclass
class DipoleSources:
    """What eq. 4 needs of a medium."""

    albedo_p: Value
    sigma_tr: Value
    z_r: Value
    z_v: Value

    def total(self) -> Value:
        """R = ∫ 2πr R_d dr."""
        return self.albedo_p / 2 * (dr.exp(-self.sigma_tr * self.z_r) + dr.exp(-self.sigma_tr * self.z_v))


def dipole(sigma_a: Value, sigma_sp: Value, boundary_a: Value) -> DipoleSources:
    """The two sources of a medium whose boundary has A = `boundary_a`."""
    z_r = 1 / (sigma_a + sigma_sp)
    return DipoleSources(sigma_sp * z_r, dr.sqrt(3 * sigma_a / z_r), z_r, z_r * (1 + 4 / 3 * boundary_a))


def rd(source: DipoleSources, d2_r: Value, d2_v: Value) -> Value:
    """R_d, eq. 4, for the squares of the distances from the real and the virtual source."""

    def part(z: Value, d2: Value) -> Value:
        inverse = dr.rsqrt(d2)
        x = source.sigma_tr * d2 * inverse
        return z * inverse * (1 + x) * dr.exp(-x) * inverse * inverse

    return source.albedo_p / (4 * math.pi) * (part(source.z_r, d2_r) + part(source.z_v, d2_v))


def rd_flat(source: DipoleSources, r2: Value) -> Value:
    """R_d(r) on a plane, for r²."""
    return rd(source, r2 + dr.square(source.z_r), r2 + dr.square(source.z_v))


def sample_radius(source: DipoleSources, u: Value, law: Law) -> Value:
    """A radius on a plane for a uniform number `u`, one channel; its density over the area is `radius_density`."""
    return _sample_exponential(source, u) if law == "exponential" else _sample_exact(source, u)


def radius_density(source: DipoleSources, r2: Value, law: Law) -> Value:
    """Density per area of `sample_radius`, for r²: R_d(r)/R, or the paper's σtr e^(−σtr r)/(2πr)."""
    if law == "exact":
        return rd_flat(source, r2) / dr.maximum(source.total(), 1e-30)
    rate, r = _rate(source), dr.sqrt(r2)
    return rate * dr.exp(-rate * r) / (2 * math.pi * dr.maximum(r, 1e-6 * source.z_r))


def reach(source: DipoleSources) -> Value:
    """The radius beyond which lies at most the share TAIL of R, as far as a probe keeps its digits."""
    return dr.minimum(_radius(source.sigma_tr, source.z_v, -math.log(TAIL)), _FARTHEST * source.z_r)


def _sample_exact(source: DipoleSources, u: Value) -> Value:
    """The tail is one closed form for each source: choose the source by its share, then invert its own tail."""
    near, far = dr.exp(-source.sigma_tr * source.z_r), dr.exp(-source.sigma_tr * source.z_v)
    share = near / (near + far)
    real = u < share
    z = dr.select(real, source.z_r, source.z_v)
    rest = dr.select(real, (share - u) / share, (1 - u) / (1 - share))
    return _radius(source.sigma_tr, z, -dr.log(dr.maximum(rest, _LEAST_ARGUMENT)))


def _sample_exponential(source: DipoleSources, u: Value) -> Value:
    return -dr.log(dr.maximum(1 - u, _LEAST_ARGUMENT)) / _rate(source)


def _rate(source: DipoleSources) -> Value:
    return dr.maximum(source.sigma_tr, 1 / (_WIDEST_DECAY * source.z_r))


def _radius(sigma_tr: Value, z: Value, depth: Value) -> Value:
    """Where a source's tail has fallen to e^(−depth) of its total.

    With d = z e^y the tail (z/d) e^(−σtr (d − z)) gives y + σtr z (e^y − 1) = depth: Lambert's W, by Halley's steps
    from an upper bound, which are exact to rounding after three.
    """
    a = sigma_tr * z
    y = dr.minimum(depth, dr.log(1 + depth / dr.maximum(a, 1e-12)))
    for _ in range(3):
        bend = a * dr.exp(y)
        slope = 1 + bend
        excess = y + bend - a - depth
        y -= excess / (slope - excess * bend / (2 * slope))
    y = dr.maximum(y, 0)
    return z * dr.sqrt(dr.maximum(dr.exp(2 * y) - 1, 0))
