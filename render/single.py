"""Light scattered once, along the refracted outgoing ray: Jensen et al. 2001, eq. 6 with the mended estimate.

Lengths in scene units. Directions point away from the point they belong to; `inward` runs into the body.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from bssrdf.render.interface import phase, refract_in, refract_out, refracted_cosine, sample_phase
from bssrdf.render.lobes import Bounce, LobeSample, Vertex
from bssrdf.render.medium import Media, Optics


class Single:
    """Scattering at a distance s_o′ along the refracted ray, drawn in one of the channels."""

    def __init__(self, scene: Any, sampler: Any, media: Media, vertex: Vertex, active: Any) -> None:
        si, optics = vertex.si, vertex.optics
        facet, transmitted = _facet(sampler, media, vertex, active)
        self._inward = -refract_in(vertex.outgoing, facet, optics.eta)
        active = active & (dr.dot(self._inward, vertex.normal) < 0)
        shares = channel_shares(vertex.throughput * optics.sigma_s() / optics.sigma_t())
        rate = pick_channel(optics.sigma_t(), shares, sampler.next_1d(active))
        s_o = -dr.log(dr.maximum(1 - sampler.next_1d(active), 2.0**-24)) / rate
        attenuation = dr.exp(-optics.sigma_t() * s_o)
        density = dr.sum(shares * optics.sigma_t() * attenuation)
        self._weight = optics.sigma_s() * attenuation * transmitted / dr.maximum(density, 1e-30)
        ray = si.spawn_ray(self._inward)
        ray.maxt = s_o
        self.active = active & ~scene.ray_test(ray, active)
        self.ref = mi.Interaction3f(si.t, si.time, si.wavelengths, si.p + s_o * self._inward, -self._inward)
        self._scene = scene
        self._media = media
        self._vertex = vertex

    def light(self, ds: Any) -> LobeSample:
        """Straight on to the light; the way inside counts as long as it would be if the ray were refracted."""
        optics = self._vertex.optics
        si, normal, there, alive = self._surface(ds.d, ds.dist * (1 - 1e-4))
        cos_i = dr.dot(ds.d, normal)
        alive &= cos_i > 0
        inside = refracted_cosine(cos_i, optics.eta)
        s_i = si.t * cos_i / dr.maximum(inside, 1e-6)
        pdf = self._density(refract_in(ds.d, normal, optics.eta), cos_i, inside)
        value = self._weight * dr.exp(-there.sigma_t() * s_i) * self._media.transmittance(there, cos_i) * pdf
        return LobeSample(dr.select(alive, value, 0), pdf, si)

    def bounce(self, sampler: Any) -> Bounce:
        """A direction from the phase function, out of the body with exact refraction."""
        optics = self._vertex.optics
        direction = sample_phase(optics.g, self._inward, sampler.next_2d(self.active))
        si, normal, there, alive = self._surface(direction, dr.largest(mi.Float))
        outside, cos_i = refract_out(direction, normal, optics.eta)
        inside = dr.dot(direction, normal)
        alive &= (inside > 0) & (cos_i > 0)
        value = self._weight * dr.exp(-there.sigma_t() * si.t) * self._media.transmittance(there, cos_i)
        return Bounce(outside, dr.select(alive, value, 0), self._density(direction, cos_i, inside), mi.Bool(False), si)

    def _density(self, direction: Any, cos_i: Any, inside: Any) -> Any:
        """The phase function, over the outside solid angle, for light from `direction` inside."""
        optics = self._vertex.optics
        squeeze = cos_i / (optics.eta * optics.eta * dr.maximum(inside, 1e-6))
        return phase(optics.g, dr.dot(direction, self._inward)) * squeeze

    def _surface(self, direction: Any, farthest: Any) -> tuple[Any, Any, Optics, Any]:
        """Where a ray meets the body from within: the hit, its outward normal, the medium there."""
        vertex = self._vertex
        ray = mi.Ray3f(self.ref.p, direction, farthest, self.ref.time, self.ref.wavelengths)
        si = self._scene.ray_intersect(ray, +mi.RayFlags.All, False, self.active)
        alive = self.active & si.is_valid() & (si.bsdf() == vertex.si.bsdf())
        normal = self._media.normal(si, vertex.optics.row, alive) * vertex.side
        return si, normal, self._media.optics_at(si, vertex.optics, alive), alive


class LocalSingle:
    """Single scattering of section 2.4, f_r⁽¹⁾: in and out at one point; `paper` omits its 1/η², as printed."""

    def __init__(self, media: Media, vertex: Vertex, paper: bool, active: Any) -> None:
        self.active = active
        self.ref = vertex.si
        self._media = media
        self._vertex = vertex
        self._paper = paper
        self._inward = -refract_in(vertex.outgoing, vertex.normal, vertex.optics.eta)

    def light(self, ds: Any) -> LobeSample:
        cos_i = dr.maximum(dr.dot(self._vertex.normal, ds.d), 0)
        return LobeSample(self._reflectance(ds.d) * cos_i, cos_i / math.pi, self.ref)

    def bounce(self, sampler: Any) -> Bounce:
        local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(self.active))
        direction = mi.Frame3f(self._vertex.normal).to_world(local)
        weight = self._reflectance(direction) * math.pi
        return Bounce(direction, weight, local.z / math.pi, mi.Bool(False), self.ref)

    def _reflectance(self, incoming: Any) -> Any:
        normal, optics = self._vertex.normal, self._vertex.optics
        cos_i = dr.dot(normal, incoming)
        toward = refract_in(incoming, normal, optics.eta)
        cosines = dr.dot(toward, normal) - dr.dot(self._inward, normal)
        transmitted = self._media.transmittance(optics, cos_i)
        transmitted *= self._media.transmittance(optics, dr.dot(normal, self._vertex.outgoing))
        scattered = transmitted * phase(optics.g, dr.dot(toward, self._inward))
        if not self._paper:
            scattered /= optics.eta * optics.eta
        return optics.sigma_s() / optics.sigma_t() * scattered / dr.maximum(cosines, 1e-6)


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


def single_share(optics: Optics) -> Any:
    """Roughly what part of the entering light leaves after one scattering; it only steers the sampling."""
    backward = (1 - optics.g) / dr.square(1 + optics.g)
    return optics.sigma_s() / optics.sigma_t() * dr.clip(0.08 * backward, 0.02, 0.3)


def _facet(sampler: Any, media: Media, vertex: Vertex, active: Any) -> tuple[Any, Any]:
    """The slope of the surface that the viewer looks through, and what it transmits."""
    normal, eta = vertex.normal, vertex.optics.eta
    smooth = 1 - mi.fresnel(dr.dot(normal, vertex.outgoing), eta)[0]
    if not media.rough:
        return normal, smooth
    frame = mi.Frame3f(normal)
    local = frame.to_local(vertex.outgoing)
    slopes = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, dr.maximum(vertex.optics.alpha, 1e-3), True)
    facet, _ = slopes.sample(local, sampler.next_2d(active))
    transmitted = 1 - mi.fresnel(dr.dot(local, facet), eta)[0]
    transmitted *= slopes.smith_g1(-refract_in(local, mi.Vector3f(facet), eta), facet)
    rough = vertex.optics.alpha > 0
    return dr.select(rough, mi.Normal3f(frame.to_world(facet)), normal), dr.select(rough, transmitted, smooth)
