"""Where the diffused light entered: three-axis probes through a body, several hits, channels and axes weighed together.

After King et al. 2013, with the dipole's own radius. Lengths in scene units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from bssrdf.render.sampling import Dipole, Law, radius_density, rd, reach, sample_radius

AXIS_SHARES = (0.7, 0.15, 0.15)
"""Of the probes along the normal and along the two tangents."""
SMALLEST = 1e-4
"""Reach, over the size of a coordinate, below which single precision cannot tell two points of a surface apart."""
_STEP = 2e-6
"""How far beyond a hit the probe goes on, over the size of a coordinate."""


@dataclass
class Body:
    """A lit point and the body about it."""

    si: Any
    frame: Any
    """Of the geometric normal, outward."""
    side: Any
    """+1 where the shape's own normals point outward, −1 elsewhere."""
    source: Dipole
    channel_shares: Any
    """Chance of each channel to choose the radius; they add up to 1."""

    def reach(self) -> Any:
        """How far away an entry may be found."""
        return dr.max(reach(self.source))


@dataclass
class Entry:
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


def entry_density(body: Body, offset: Any, normal: Any, law: Law) -> Any:
    """Density over the surface at `offset` from the lit point of all probes' hits together."""
    local, tilt = body.frame.to_local(offset), dr.abs(body.frame.to_local(normal))
    square = local * local
    total = mi.Float(0)
    for share, radius2, cosine in (
        (AXIS_SHARES[0], square.x + square.y, tilt.z),
        (AXIS_SHARES[1], square.y + square.z, tilt.x),
        (AXIS_SHARES[2], square.x + square.z, tilt.y),
    ):
        density = radius_density(body.source, mi.Spectrum(dr.sqrt(radius2)), law)
        total += share * cosine * dr.sum(body.channel_shares * density)
    return total


def rd_between(source: Dipole, offset: Any, normal: Any) -> Any:
    """R_d for light that enters at `offset` from where it leaves, on a surface of any form.

    The paper's rule: the sources stay on the normal at the entry, and no distance counts less than 1/σt′.
    """
    r2, rise = dr.squared_norm(offset), dr.dot(offset, normal)

    def distance(z: Any, height: Any) -> Any:
        return dr.sqrt(dr.maximum(r2 + z * z + 2 * height * rise, source.z_r * source.z_r))

    return rd(source, distance(source.z_r, -source.z_r), distance(source.z_v, source.z_v))


@dr.syntax
def find_entry(scene: Any, sampler: Any, body: Body, law: Law, max_hits: int, active: Any) -> Entry:
    """Probe the body once and keep one of the hits, chosen by its share of what they contribute together."""
    si = body.si
    ray = _probe(sampler, body, law, active)
    step = _STEP * size_of(si.p)
    own = si.bsdf()
    running = active & (ray.maxt > 0)
    hits = mi.UInt32(0)
    total = mi.Float(0)
    kept = mi.Float(0)
    kept_ray = mi.Ray3f(ray)
    kept_hit = dr.zeros(mi.PreliminaryIntersection3f)
    while running:
        hit = scene.ray_intersect_preliminary(ray, False, active=running)
        found = running & hit.is_valid()
        point = hit.compute_surface_interaction(ray, +mi.RayFlags.Minimal, found)
        mine = found & (point.bsdf() == own)
        offset, normal = point.p - si.p, point.n * body.side
        value = dr.sum(body.channel_shares * rd_between(body.source, offset, normal))
        value = dr.select(mine, value / dr.maximum(entry_density(body, offset, normal, law), 1e-30), 0)
        total += value
        take = mine & (sampler.next_1d(running) * total < value)
        kept = dr.select(take, value, kept)
        kept_hit = dr.select(take, hit, kept_hit)
        kept_ray = dr.select(take, ray, kept_ray)
        hits += dr.select(mine, mi.UInt32(1), mi.UInt32(0))
        passed = hit.t + step
        ray.o = dr.select(found, ray.o + passed * ray.d, ray.o)
        ray.maxt = ray.maxt - passed
        running = found & (ray.maxt > 0) & (hits < max_hits)
    chosen = active & (kept > 0)
    entry = kept_hit.compute_surface_interaction(kept_ray, +mi.RayFlags.All, chosen)
    chosen &= entry.is_valid()
    density = entry_density(body, entry.p - si.p, entry.n * body.side, law)
    weight = dr.select(chosen, total / dr.maximum(kept * density, 1e-30), 0)
    return Entry(entry, weight, density, chosen)


def _probe(sampler: Any, body: Body, law: Law, active: Any) -> Any:
    """A line through the ball of the dipole's reach, parallel to one of the axes; of no length where it misses."""
    u_axis, u_channel, u_disk = sampler.next_1d(active), sampler.next_1d(active), sampler.next_2d(active)
    frame = body.frame
    along_n = u_axis < AXIS_SHARES[0]
    along_s = u_axis < AXIS_SHARES[0] + AXIS_SHARES[1]
    axis = dr.select(along_n, frame.n, dr.select(along_s, frame.s, frame.t))
    first = dr.select(along_n, frame.s, dr.select(along_s, frame.t, frame.n))
    second = dr.select(along_n, frame.t, dr.select(along_s, frame.n, frame.s))
    source = body.source
    albedo_p, sigma_tr, z_r, z_v = (
        pick_channel(value, body.channel_shares, u_channel)
        for value in (source.albedo_p, source.sigma_tr, source.z_r, source.z_v)
    )
    radius = sample_radius(Dipole(albedo_p, sigma_tr, z_r, z_v), u_disk.x, law)
    sin_phi, cos_phi = dr.sincos(2 * math.pi * u_disk.y)
    farthest = body.reach()
    half = dr.sqrt(dr.maximum(farthest * farthest - radius * radius, 0))
    origin = body.si.p + radius * (first * cos_phi + second * sin_phi) + half * axis
    return mi.Ray3f(origin, -axis, 2 * half, body.si.time, body.si.wavelengths)
