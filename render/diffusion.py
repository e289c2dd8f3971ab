"""Light that diffused to where it leaves, eq. 5: from another point of the body, or from the same one."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from bssrdf.render.lobes import Bounce, LobeSample, Vertex
from bssrdf.render.medium import Media, Optics
from bssrdf.render.probes import LitPoint, channel_shares, entry_density, find_entry, rd_between
from bssrdf.render.sampling import Law
from bssrdf.render.spots import Spots


class LocalDiffusion:
    """The Lambertian F R/π of section 2.4."""

    def __init__(self, media: Media, vertex: Vertex, active: Any) -> None:
        self.active = active
        self.ref = vertex.si
        self._entry = _Lambertian(media, vertex.normal, vertex.optics)
        self._weight = vertex.optics.dipole().total()

    def light(self, ds: Any) -> LobeSample:
        return self._entry.light(ds, self._weight, self.ref)

    def bounce(self, sampler: Any) -> Bounce:
        return self._entry.bounce(sampler, self._weight, self.ref, self.active)

    def beam(self, sampler: Any) -> Any:
        return 0


class Diffusion:
    """R_d between the point seen and one where light entered, found by a probe or by a spot light's ray."""

    def __init__(
        self,
        scene: Any,
        sampler: Any,
        media: Media,
        spots: Spots,
        vertex: Vertex,
        law: Law,
        max_hits: int,
        active: Any,
    ) -> None:
        source, side = vertex.optics.dipole(), vertex.side
        frame = mi.Frame3f(mi.Normal3f(vertex.si.n * side))
        shares = channel_shares(vertex.throughput * source.total())
        self._body = LitPoint(vertex.si, frame, side, source, shares, media.widest(vertex.optics, active))
        found = find_entry(scene, sampler, self._body, law, max_hits, active)
        self._asked = active
        self.active = found.found
        self.ref = found.si
        self._scene, self._media, self._spots, self._vertex, self._law = scene, media, spots, vertex, law
        self._density = found.density
        self._entry, profile = self._entered(found.si, found.found)
        self._weight = profile * found.weight

    def light(self, ds: Any) -> LobeSample:
        light = self._entry.light(ds, self._weight, self.ref)
        if self._spots.any:
            by_probe = self._density * ds.pdf
            cos_g = dr.abs(dr.dot(self.ref.n, ds.d))
            by_spot = self._spots.density(ds.emitter, self.active) * cos_g / dr.square(ds.dist)
            light.value *= dr.select(self.active, by_probe / dr.maximum(by_probe + by_spot, 1e-30), 0)
        return light

    def bounce(self, sampler: Any) -> Bounce:
        return self._entry.bounce(sampler, self._weight, self.ref, self.active)

    def beam(self, sampler: Any) -> Any:
        if not self._spots.any:
            return 0
        vertex = self._vertex
        shot = self._spots.shoot(vertex.si.time, sampler, self._asked)
        si = self._scene.ray_intersect(shot.ray, +mi.RayFlags.All, False, self._asked)
        hit = self._asked & si.is_valid() & (si.bsdf() == vertex.si.bsdf())
        entry, profile = self._entered(si, hit)
        cos_g = -dr.dot(si.n, shot.ray.d) * vertex.side
        hit &= cos_g > 0
        distance2 = dr.square(si.t)
        by_spot = shot.density * cos_g / distance2
        by_probe = entry_density(self._body, si.p - vertex.si.p, si.n, self._law) * shot.chance
        within = dr.squared_norm(si.p - vertex.si.p) < dr.square(self._body.reach())
        by_probe = dr.select(within, by_probe, 0)
        value = profile * entry.received(-shot.ray.d) * shot.intensity / distance2
        return dr.select(hit, value / dr.maximum(by_spot + by_probe, 1e-30), 0)

    def _entered(self, si: Any, active: Any) -> tuple[_Lambertian, Any]:
        """What receives light at a point of the body, and R_d from there, with the coefficients there."""
        vertex = self._vertex
        optics = self._media.optics_at(si, vertex.optics, active)
        outward = mi.Normal3f(si.sh_frame.n * vertex.side)
        profile = rd_between(optics.dipole(), si.p - vertex.si.p, outward)
        normal = self._media.normal(si, vertex.optics.row, active) * vertex.side
        return _Lambertian(self._media, normal, optics), profile


class _Lambertian:
    """Entry of light: T cos θ/π from every outside direction."""

    def __init__(self, media: Media, normal: Any, optics: Optics) -> None:
        self._media = media
        self._normal = mi.Normal3f(normal)
        self._optics = optics

    def received(self, direction: Any) -> Any:
        cos_i = dr.maximum(dr.dot(self._normal, direction), 0)
        return self._media.transmittance(self._optics, cos_i) * cos_i / math.pi

    def light(self, ds: Any, weight: Any, origin: Any) -> LobeSample:
        pdf = dr.maximum(dr.dot(self._normal, ds.d), 0) / math.pi
        return LobeSample(weight * self.received(ds.d), pdf, origin)

    def bounce(self, sampler: Any, weight: Any, origin: Any, active: Any) -> Bounce:
        local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
        direction = mi.Frame3f(self._normal).to_world(local)
        weight = weight * self._media.transmittance(self._optics, local.z)
        return Bounce(direction, weight, local.z / math.pi, mi.Bool(False), origin)
