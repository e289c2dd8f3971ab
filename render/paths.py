"""The steps of a path: what is met, which lobe goes on, the light that reaches it, and the next ray.

At a translucent surface the light that leaves it is read from its vertices where it is stored there. Of the rest, one
term is drawn in proportion to what it brings. Each takes light by light sampling and by its own direction, weighed by
the balance heuristic.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from bssrdf.render.kernel import Kernel
from bssrdf.render.lobes import Bounce, Lobe, Ordinary, Scattered, Specular, Vertex
from bssrdf.render.medium import Media, Optics
from bssrdf.render.single import LocalSingle, Single, single_share

TERMS = ("diffusion", "single", "specular")
"""The last two, and the dipole; with the table's kernel the first holds all that is scattered."""
EXITANCE = "vertex_exitance"
"""Attribute of a mesh: the radiant exitance over R."""
MIRRORS = 4
"""Of bodies in a row by which lamps are followed; light of more is left to chance."""
MOST_LAMPS = 6
"""That a point looks at, all in turn where there are no more: a choice among them would be noise."""
_SMALLEST = 1e-4
"""Mean free path, over the size of a coordinate, below which single precision cannot tell two points apart."""
_LEAST_SURVIVAL = 0.2
"""Of a path at each surface: rare light that is found later is no more than five times as bright for it."""
_LEAST_COSINE = 0.02
"""Of a bumped normal to the viewer; where it turns farther away, the surface's own stands in."""


@dataclass(frozen=True)
class Settings:
    """What the integrator was asked for."""

    terms: tuple[str, ...] = TERMS
    kernel: Kernel = "table"
    local: bool = False
    """The BRDF of section 2.4: light leaves where it entered."""
    paper: bool = False
    """As printed: no 1/C in the exit lobe, no 1/η² in the local single scattering."""
    max_depth: int = 1 << 24
    rr_depth: int = 2
    """Surfaces from which on Russian roulette ends paths: on the bust 2 takes two thirds of the time that 5 takes."""
    hide_emitters: bool = False
    mirrors_apart: bool = False
    """Leave out lamps that polished bodies mirror first of all: `points.mirrored` follows them."""

    def drawn(self) -> tuple[str, ...]:
        """The terms that paths go on by."""
        apart = () if self.kernel == "dipole" else ("single",)
        return tuple(term for term in self.terms if term not in apart and (self.local or term != "diffusion"))


@dataclass
class Path:
    """A path so far, and the ray that continues it."""

    ray: Any
    radiance: Any
    throughput: Any
    depth: Any
    last: Any
    """The point that the ray comes from, as light sampling saw it."""
    last_pdf: Any
    last_delta: Any
    mirrored: Any
    """Have all surfaces so far been mirrors of bodies, and no more than MIRRORS?"""
    seen: Any
    """Did the camera's ray meet a surface?"""
    active: Any


class Tracer:
    """What one scene and one set of settings have in common for all steps."""

    def __init__(self, scene: Any, settings: Settings) -> None:
        self.scene = scene
        self.settings = settings
        self.media = Media(scene, settings.kernel)
        delta = [bool(int(emitter.flags()) & int(mi.EmitterFlags.Delta)) for emitter in scene.emitters()]
        self._has_local = settings.local or self.media.shortest_mean_free_path() < 2 * _SMALLEST * _size(scene)
        choose = settings.mirrors_apart or not self.media.rough  # else it was two thirds of the face's noise
        self._lamps = 1 if choose else min(len(delta), MOST_LAMPS)
        self._lit = bool(delta)
        self._hittable = not all(delta)
        """Is there light that a ray can meet by chance?"""

    def start(self, ray: Any, active: Any) -> Path:
        """Paths before their first surface."""
        return Path(
            ray=mi.Ray3f(ray),
            radiance=mi.Spectrum(0),
            throughput=mi.Spectrum(1),
            depth=mi.UInt32(0),
            last=dr.zeros(mi.Interaction3f),
            last_pdf=mi.Float(1),
            last_delta=mi.Bool(True),
            mirrored=mi.Bool(False),
            seen=mi.Bool(False),
            active=mi.Bool(active),
        )

    def step(self, path: Path, sampler: Any) -> Path:
        """Go to the next surface, add its light, and draw the ray after it."""
        si = self.scene.ray_intersect(path.ray, +mi.RayFlags.All, path.depth == 0, path.active)
        radiance = path.radiance
        if self._hittable:
            radiance = radiance + self._emitted(path, si)
        path.radiance = radiance
        path.seen |= (path.depth == 0) & si.is_valid()
        path.active &= si.is_valid() & (path.depth + 1 < self.settings.max_depth)
        path, sampler = dr.if_stmt(
            (path, si, sampler),
            path.active,
            self._shade,
            lambda path, si, sampler: (path, sampler),
            mode="symbolic",
        )
        return path

    def _shade(self, path: Path, si: Any, sampler: Any) -> tuple[Path, Any]:
        """Add the light that reaches the surface, and draw the ray after it."""
        lobes, throughput, radiance = self._lobes(path, si, sampler, path.active)
        if self._lit:
            radiance = radiance + throughput * self._direct(lobes, sampler)
        return self._continued(path, radiance, throughput, lobes, path.seen, sampler), sampler

    def _emitted(self, path: Path, si: Any) -> Any:
        """Light of a surface or surrounding that the ray met, weighed against light sampling."""
        ds = mi.DirectionSample3f(self.scene, si, path.last)
        active = path.active & (path.depth > 0) if self.settings.hide_emitters else path.active
        if self.settings.mirrors_apart:
            active = active & ~(path.mirrored & si.is_valid())
        pdf = self._light_pdf(path.last, ds, active & ~path.last_delta)
        share = dr.select(path.last_delta, 1, path.last_pdf / dr.maximum(path.last_pdf + pdf, 1e-30))
        return dr.select(active, path.throughput * share * ds.emitter.eval(si, active), 0)

    def _light_pdf(self, ref: Any, ds: Any, active: Any) -> Any:
        """Density with which light sampling would have found the light that a path met."""
        return self._lamps * self.scene.pdf_emitter_direction(ref, ds, active)

    def _lobes(self, path: Path, si: Any, sampler: Any, active: Any) -> tuple[list[Lobe], Any, Any]:
        """The lobes of all surfaces met, one active in a lane; throughput with their chance; radiance so far."""
        if not self.media.surfaces:
            return [Ordinary(si, path.ray, active)], path.throughput, path.radiance
        row, translucent = self.media.row(si, active)
        vertex = self._vertex(path, si, row, translucent)
        lobes: list[Lobe] = [Ordinary(si, path.ray, active & ~translucent)] if self.media.others else []
        cos_o = dr.dot(vertex.normal, vertex.outgoing)
        translucent &= cos_o > 0
        radiance = path.radiance
        if "diffusion" in self.settings.terms and not self.settings.local:
            radiance = radiance + dr.select(translucent, path.throughput * self._stored(vertex, translucent), 0)
        chances = self._chances(vertex, self.media.transmittance(vertex.optics, cos_o))
        u = sampler.next_1d(translucent)
        throughput = mi.Spectrum(path.throughput)
        below = mi.Float(0)
        for term, chance in chances.items():
            chosen = translucent & (u >= below) & (u < below + chance)
            below += chance
            factor = self._out_of(term, vertex, cos_o) / dr.maximum(chance, 1e-12)
            throughput = dr.select(chosen, throughput * factor, throughput)
            lobes += self._of_term(term, vertex, sampler, chosen)
        return lobes, throughput, radiance

    def _vertex(self, path: Path, si: Any, row: Any, active: Any) -> Vertex:
        outgoing = -path.ray.d
        side = dr.select(dr.dot(si.n, outgoing) < 0, mi.Float(-1), mi.Float(1))
        normal = self.media.normal(si, row, active) * side
        tilted = dr.dot(normal, outgoing) > _LEAST_COSINE
        normal = dr.select(tilted, normal, mi.Normal3f(si.n * side))
        return Vertex(si, outgoing, normal, side, self.media.optics(si, row, active), path.throughput)

    def _stored(self, vertex: Vertex, active: Any) -> Any:
        """Radiance of the light that the surface's vertices hold."""
        colour = dr.size_v(mi.Spectrum) > 1
        read = vertex.si.shape.eval_attribute_3 if colour else vertex.si.shape.eval_attribute_1
        exitance = mi.Spectrum(read(EXITANCE, vertex.si, active)) * self.media.total(vertex.optics)
        return exitance * self._out_of("diffusion", vertex, dr.dot(vertex.normal, vertex.outgoing)) / dr.pi

    def _out_of(self, term: str, vertex: Vertex, cos_o: Any) -> Any:
        """The exit lobe that a term does not hold itself."""
        if term != "diffusion":
            return 1
        if self.settings.paper:
            return self.media.transmittance(vertex.optics, cos_o)
        return self.media.leaving(vertex.optics, cos_o)

    def _chances(self, vertex: Vertex, transmitted: Any) -> dict[str, Any]:
        """How the terms that are drawn share the paths: in proportion to what each brings under even light."""
        optics, throughput = vertex.optics, vertex.throughput
        brings = {
            "diffusion": transmitted * dr.max(throughput * self.media.total(optics)),
            "single": transmitted * dr.max(throughput * single_share(optics)),
            "specular": (1 - transmitted) * dr.max(throughput),
        }
        asked = {term: brings[term] for term in self.settings.drawn()}
        total = dr.maximum(sum(asked.values()), 1e-30)
        return {term: value / total for term, value in asked.items()}

    def _of_term(self, term: str, vertex: Vertex, sampler: Any, active: Any) -> list[Lobe]:
        if term == "specular":
            return [Specular(self.media, vertex, active)]
        if term == "diffusion":
            return [Scattered(self.media, vertex, active)]
        far, local = self._apart(vertex.optics, vertex.si.p, active)
        lobes: list[Lobe] = []
        if not self.settings.local:
            lobes.append(Single(self.scene, sampler, self.media, vertex, far))
        if self._has_local:
            lobes.append(LocalSingle(self.media, vertex, self.settings.paper, local))
        return lobes

    def _apart(self, optics: Optics, place: Any, active: Any) -> tuple[Any, Any]:
        """Where single precision can tell entry from exit, and where not."""
        if self.settings.local:
            return mi.Bool(False), active
        if not self._has_local:
            return active, mi.Bool(False)
        far = 1 / dr.min(optics.sigma_t()) >= _SMALLEST * (1 + dr.max(dr.abs(place)))
        return active & far, active & ~far

    def _direct(self, lobes: list[Lobe], sampler: Any) -> Any:
        """Light sampling, from each lane's own lobe."""
        active, ref = mi.Bool(False), dr.zeros(mi.Interaction3f)
        for lobe in lobes:
            active |= lobe.active
            ref = dr.select(lobe.active, interaction(lobe.ref), ref)
        u, light = sampler.next_2d(active), mi.Spectrum(0)
        for lamp in range(self._lamps):
            light += self._by_lamp(lobes, ref, mi.Point2f((u.x + lamp) / self._lamps, u.y), active)
        return light

    def _by_lamp(self, lobes: list[Lobe], ref: Any, u: Any, active: Any) -> Any:
        ds, arriving = self.scene.sample_emitter_direction(ref, u, False, active)
        active = active & (ds.pdf > 0)
        value, pdf, origin = mi.Spectrum(0), mi.Float(0), ref
        for lobe in lobes:
            light = lobe.light(ds)
            value = dr.select(lobe.active, light.value, value)
            pdf = dr.select(lobe.active, light.pdf, pdf)
            origin = dr.select(lobe.active, interaction(light.origin), origin)
        active &= dr.max(value) > 0
        active &= ~self.scene.ray_test(origin.spawn_ray_to(ds.p), active)
        share = dr.select(ds.delta, 1 / self._lamps, ds.pdf / (self._lamps * ds.pdf + pdf))
        return dr.select(active, value * arriving * share, 0)

    def _continued(
        self, path: Path, radiance: Any, throughput: Any, lobes: list[Lobe], seen: Any, sampler: Any
    ) -> Path:
        """The path with its next ray, ended by Russian roulette where it brings little."""
        active = mi.Bool(False)
        drawn = Bounce(mi.Vector3f(0, 0, 1), mi.Spectrum(0), mi.Float(1), mi.Bool(False), dr.zeros(mi.Interaction3f))
        last = dr.zeros(mi.Interaction3f)
        for lobe in lobes:
            active |= lobe.active
            bounce = lobe.bounce(sampler)
            bounce.origin, bounce.direction = interaction(bounce.origin), mi.Vector3f(bounce.direction)
            drawn = dr.select(lobe.active, bounce, drawn)
            last = dr.select(lobe.active, interaction(lobe.ref), last)
        throughput = throughput * drawn.weight
        depth = path.depth + 1
        largest = dr.max(throughput)
        active &= largest > 0
        if not self._hittable:
            active &= depth + 1 < self.settings.max_depth
        ends = (depth >= self.settings.rr_depth) & ~drawn.delta  # a lamp in a mirror would be too bright a survivor
        survival = dr.select(ends, dr.clip(largest, _LEAST_SURVIVAL, 0.95), 1)
        active &= sampler.next_1d(active) < survival
        throughput = throughput / dr.maximum(survival, 1e-12)
        mirrored = mi.Bool(False)
        for lobe in lobes if self.settings.mirrors_apart else ():
            if isinstance(lobe, Specular):
                so_far = (path.depth == 0) | (path.mirrored & (path.depth < MIRRORS))
                mirrored |= lobe.active & drawn.delta & so_far
        ray = drawn.origin.spawn_ray(drawn.direction)
        return Path(ray, radiance, throughput, depth, last, drawn.pdf, drawn.delta, mirrored, seen, active)


def interaction(si: Any) -> Any:
    """The point of a surface interaction alone."""
    return mi.Interaction3f(si.t, si.time, si.wavelengths, si.p, si.n)


def _size(scene: Any) -> float:
    """The largest coordinate, and one."""
    box = scene.bbox()
    return 1 + max(float(dr.max(dr.abs(dr.ravel(corner)))[0]) for corner in (mi.Point3f(box.min), mi.Point3f(box.max)))
