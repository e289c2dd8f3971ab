"""Where the diffused light entered: three-axis probes through a body, several hits, channels and axes weighed together.

After King et al. 2013, with the dipole's own radius. Lengths in scene units.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from bssrdf.render.sampling import DipoleSources, Law, radius_density, rd, rd_flat, reach, sample_radius

AXIS_SHARES = (0.8, 0.1, 0.1)
"""Of the probes along the normal and along the two tangents."""
SMALLEST = 1e-4
"""Reach, over the size of a coordinate, below which single precision cannot tell two points of a surface apart."""
_STEP = 4e-6
"""How far beyond a hit the probe goes on, over the sizes of a coordinate and of the probe: a few roundings."""


@dataclass
class LitPoint:
    """A lit point and the body about it."""

    si: Any
    frame: Any
    """Of the geometric normal, outward."""
    side: Any
    """+1 where the shape's own normals point outward, −1 elsewhere."""
    source: DipoleSources
    channel_shares: Any
    """Chance of each channel to choose the radius; they add up to 1."""
    widest: DipoleSources | None = None
    """Draws half of the radii where the coefficients vary: light may come from where they spread it farther."""

    def sources(self) -> list[DipoleSources]:
        """The dipoles that draw radii, each as often."""
        return [self.source] if self.widest is None else [self.source, self.widest]

    def reach(self) -> Any:
        """How far away an entry may be found."""
        farthest = [dr.max(reach(source)) for source in self.sources()]
        return farthest[0] if len(farthest) == 1 else dr.maximum(*farthest)


@dataclass
class ProbeHit:
    """A point x_i where light may have entered."""

    si: Any
    weight: Any
    """What R_d is to be multiplied by: one over the density of the point; 0 where none was found."""
    density: Any
    """Of such points over the surface."""
    found: Any


def channel_shares(contribution: Any) -> Any:
    """Chances in proportion to what each channel contributes."""
    total = dr.sum(contribution)
    return dr.select(total > 0, contribution / dr.maximum(total, 1e-30), 1 / dr.size_v(mi.Spectrum))


def pick_channel(value: Any, shares: Any, u: Any) -> Any:
    """The value in the channel that `u` chooses with `shares`."""
    picked, bound = value[0], shares[0]
    for i in range(1, dr.size_v(mi.Spectrum)):
        picked = dr.select(u < bound, picked, value[i])
        bound = bound + shares[i]
    return picked


def size_of(p: Any) -> Any:
    """Size of a point's coordinates, for the rounding errors of a ray there."""
    return 1 + dr.max(dr.abs(p))


def entry_density(body: LitPoint, offset: Any, normal: Any, law: Law) -> Any:
    """Density over the surface at `offset` from the lit point of all probes' hits together."""

    def density(r2: Any) -> Any:
        each = [radius_density(source, mi.Spectrum(r2), law) for source in body.sources()]
        return dr.sum(body.channel_shares * sum(each)) / len(each)

    return _over_axes(body.frame, offset, normal, density)


def _over_axes(frame: Any, offset: Any, normal: Any, density: Callable[[Any], Any]) -> Any:
    """The sum over the axes of a density in the plane across each, given for the square of the radius there."""
    square, tilt = dr.square(frame.to_local(offset)), dr.abs(frame.to_local(normal))
    return (
        AXIS_SHARES[0] * tilt.z * density(square.x + square.y)
        + AXIS_SHARES[1] * tilt.x * density(square.y + square.z)
        + AXIS_SHARES[2] * tilt.y * density(square.x + square.z)
    )


def rd_between(source: DipoleSources, offset: Any, normal: Any) -> Any:
    """R_d for light that enters at `offset` from where it leaves, on a surface of any form.

    The paper's rule: the real source stays 1/σt′ straight below the entry, and nearer than that it is never seen. The
    virtual one keeps its distance on a plane, for over a curved surface it would stray into the open.
    """
    r2, rise = dr.squared_norm(offset), dr.dot(offset, normal)
    return rd(source, dr.maximum(r2 - 2 * source.z_r * rise, 0) + dr.square(source.z_r), r2 + dr.square(source.z_v))


def _worth(frame: Any, picked: DipoleSources, offset: Any, normal: Any) -> Any:
    """What a hit contributes over its density, in one channel: for the choice among several hits."""
    density = _over_axes(frame, offset, normal, lambda r2: rd_flat(picked, r2))
    return rd_between(picked, offset, normal) / dr.maximum(density, 1e-30)


@dr.syntax
def find_entry(scene: Any, sampler: Any, body: LitPoint, law: Law, max_hits: int, active: Any) -> ProbeHit:
    """Probe the body once and keep one of the hits, chosen by its share of what they are worth together."""
    si = body.si
    ray, picked = _probe(sampler, body, law, active)
    step = _STEP * (size_of(si.p) + ray.maxt)
    own = si.bsdf()
    running = active & (ray.maxt > 0)
    hits = mi.UInt32(0)
    total = mi.Float(0)
    kept = mi.Float(1)
    kept_ray = mi.Ray3f(ray)
    kept_hit = dr.zeros(mi.PreliminaryIntersection3f)
    while running:
        hit = scene.ray_intersect_preliminary(ray, False, active=running)
        found = running & hit.is_valid()
        point = hit.compute_surface_interaction(ray, +mi.RayFlags.Minimal, found)
        mine = found & (point.bsdf() == own)
        worth = dr.select(mine, _worth(body.frame, picked, point.p - si.p, point.n * body.side), 0)
        total += worth
        take = mine & (sampler.next_1d(running) * total <= worth)
        kept = dr.select(take, worth, kept)
        kept_hit = dr.select(take, hit, kept_hit)
        kept_ray = dr.select(take, ray, kept_ray)
        hits += dr.select(mine, mi.UInt32(1), mi.UInt32(0))
        passed = hit.t + step
        ray.o = dr.select(found, ray.o + passed * ray.d, ray.o)
        ray.maxt = ray.maxt - passed
        running = found & (ray.maxt > 0) & (hits < max_hits)
    chosen = active & (hits > 0)
    entry = kept_hit.compute_surface_interaction(kept_ray, +mi.RayFlags.All, chosen)
    chosen &= entry.is_valid()
    density = entry_density(body, entry.p - si.p, entry.n * body.side, law)
    share = dr.select(total > 0, kept / total, 1)
    weight = dr.select(chosen, 1 / dr.maximum(share * density, 1e-30), 0)
    return ProbeHit(entry, weight, density, chosen)


def _probe(sampler: Any, body: LitPoint, law: Law, active: Any) -> tuple[Any, DipoleSources]:
    """A line through the ball of the dipole's reach, parallel to an axis, of no length where it misses; its channel."""
    u_axis, u_channel, u_disk = sampler.next_1d(active), sampler.next_1d(active), sampler.next_2d(active)
    frame = body.frame
    along_n = u_axis < AXIS_SHARES[0]
    along_s = u_axis < AXIS_SHARES[0] + AXIS_SHARES[1]
    axis = dr.select(along_n, frame.n, dr.select(along_s, frame.s, frame.t))
    first = dr.select(along_n, frame.s, dr.select(along_s, frame.t, frame.n))
    second = dr.select(along_n, frame.t, dr.select(along_s, frame.n, frame.s))
    picked = _pick(body.source, body.channel_shares, u_channel)
    if body.widest is not None:
        wide = _pick(body.widest, body.channel_shares, u_channel)
        picked = dr.select(sampler.next_1d(active) < 0.5, wide, picked)
    radius = sample_radius(picked, u_disk.x, law)
    sin_phi, cos_phi = dr.sincos(2 * math.pi * u_disk.y)
    farthest = body.reach()
    half = dr.sqrt(dr.maximum(farthest * farthest - radius * radius, 0))
    origin = body.si.p + radius * (first * cos_phi + second * sin_phi) + half * axis
    return mi.Ray3f(origin, -axis, 2 * half, body.si.time, body.si.wavelengths), picked


def _pick(source: DipoleSources, shares: Any, u: Any) -> DipoleSources:
    """The dipole of one channel, chosen by `u`."""
    return DipoleSources(
        pick_channel(source.albedo_p, shares, u),
        pick_channel(source.sigma_tr, shares, u),
        pick_channel(source.z_r, shares, u),
        pick_channel(source.z_v, shares, u),
    )
