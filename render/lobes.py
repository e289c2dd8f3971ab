"""What a path may do at a surface: each lobe says what light it takes from a direction, and draws one itself.

All are masked lanes of one wavefront. Directions point away from the surface; densities are per outside solid angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from bssrdf.render.medium import Media, Optics


@dataclass
class Vertex:
    """A surface that a path met, seen from outside the body."""

    si: Any
    outgoing: Any
    """Back along the path."""
    normal: Any
    """Shading normal on the side of `outgoing`."""
    side: Any
    """+1 where the shape's own normals are on that side, −1 elsewhere."""
    optics: Optics
    throughput: Any


@dataclass
class LobeSample:
    """What a lobe takes from one direction."""

    value: Any
    """Factor between the light's radiance, times the solid angle, and that of the path."""
    pdf: Any
    """Density with which `bounce` would draw the direction."""
    origin: Any
    """Where a shadow ray starts."""


@dataclass
class Bounce:
    """A direction that a lobe drew."""

    direction: Any
    weight: Any
    """`Light.value` over `pdf`."""
    pdf: Any
    delta: Any
    origin: Any


class Lobe(Protocol):
    """A way to go on."""

    active: Any
    ref: Any
    """The point, and its geometric normal, from which light is sampled."""

    def light(self, ds: Any) -> LobeSample:
        """What comes from a sampled direction towards a light."""

    def bounce(self, sampler: Any) -> Bounce:
        """The path's next direction."""


class Ordinary:
    """Any other BSDF of Mitsuba's."""

    def __init__(self, si: Any, ray: Any, active: Any) -> None:
        self.active = active
        self.ref = si
        self._bsdf = si.bsdf(ray)
        self._context = mi.BSDFContext()

    def light(self, ds: Any) -> LobeSample:
        si = self.ref
        smooth = self.active & mi.has_flag(self._bsdf.flags(), mi.BSDFFlags.Smooth)
        value, pdf = self._bsdf.eval_pdf(self._context, si, si.to_local(ds.d), smooth)
        return LobeSample(dr.select(smooth, value, 0), pdf, si)

    def bounce(self, sampler: Any) -> Bounce:
        si = self.ref
        drawn, weight = self._bsdf.sample(
            self._context, si, sampler.next_1d(self.active), sampler.next_2d(self.active), self.active
        )
        delta = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        return Bounce(si.to_world(drawn.wo), weight, drawn.pdf, delta, si)


class Specular:
    """Reflection at the boundary, a mirror's or that of GGX slopes."""

    def __init__(self, media: Media, vertex: Vertex, active: Any) -> None:
        self.active = active
        self.ref = vertex.si
        self._vertex = vertex
        self._rough = media.rough
        self._frame = mi.Frame3f(vertex.normal)
        self._local = self._frame.to_local(vertex.outgoing)
        alpha = dr.maximum(vertex.optics.alpha, 1e-3)
        self._slopes = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
        self._is_rough = vertex.optics.alpha > 0

    def light(self, ds: Any) -> LobeSample:
        if not self._rough:
            return LobeSample(mi.Spectrum(0), mi.Float(0), self.ref)
        toward = self._frame.to_local(ds.d)
        half = mi.Normal3f(dr.normalize(toward + self._local))
        alive = self._is_rough & (toward.z > 0)
        reflected = mi.fresnel(dr.dot(self._local, half), self._vertex.optics.eta)[0]
        value = reflected * self._slopes.eval(half) * self._slopes.G(self._local, toward, half) / (4 * self._local.z)
        pdf = self._slopes.pdf(self._local, half) / (4 * dr.maximum(dr.dot(self._local, half), 1e-6))
        return LobeSample(mi.Spectrum(dr.select(alive, value, 0)), dr.select(alive, pdf, 0), self.ref)

    def bounce(self, sampler: Any) -> Bounce:
        eta = self._vertex.optics.eta
        mirrored = mi.Vector3f(-self._local.x, -self._local.y, self._local.z)
        weight = mi.fresnel(self._local.z, eta)[0]
        if not self._rough:
            return Bounce(self._frame.to_world(mirrored), mi.Spectrum(weight), mi.Float(1), mi.Bool(True), self.ref)
        half, pdf = self._slopes.sample(self._local, sampler.next_2d(self.active))
        cos_half = dr.dot(self._local, half)
        toward = 2 * cos_half * mi.Vector3f(half) - self._local
        tilted = mi.fresnel(cos_half, eta)[0] * self._slopes.smith_g1(toward, half)
        direction = self._frame.to_world(dr.select(self._is_rough, toward, mirrored))
        weight = dr.select(self._is_rough, dr.select(toward.z > 0, tilted, 0), weight)
        pdf = dr.select(self._is_rough, pdf / (4 * dr.maximum(cos_half, 1e-6)), 1)
        return Bounce(direction, mi.Spectrum(weight), pdf, ~self._is_rough, self.ref)


class Scattered:
    """All light that is scattered inside, leaving where it entered: R_d in the limit of a short mean free path."""

    def __init__(self, media: Media, vertex: Vertex, active: Any) -> None:
        self.active = active
        self.ref = vertex.si
        self._media = media
        self._vertex = vertex
        self._total = media.total(vertex.optics)

    def light(self, ds: Any) -> LobeSample:
        cos_i = dr.maximum(dr.dot(self._vertex.normal, ds.d), 0)
        entering = self._media.entering(self._vertex.optics, cos_i)
        return LobeSample(self._total * entering * cos_i / dr.pi, cos_i / dr.pi, self.ref)

    def bounce(self, sampler: Any) -> Bounce:
        local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(self.active))
        direction = mi.Frame3f(self._vertex.normal).to_world(local)
        weight = self._total * self._media.entering(self._vertex.optics, local.z)
        return Bounce(direction, weight, local.z / dr.pi, mi.Bool(False), self.ref)
