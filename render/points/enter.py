"""The light that enters a body: a path from a point of each triangle, a few times over.

The points, the places on lamps and the directions of all triangles together form one sequence that fills space evenly.
Neighbours follow each other in it, so that what is then summed over a neighbourhood has little noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from bssrdf.render.interface import refract_in
from bssrdf.render.medium import Optics
from bssrdf.render.paths import MOST_LAMPS, Tracer
from bssrdf.render.points.record import BodySurface, Entered, Floats
from bssrdf.render.points.sequence import uniform

_CHUNK = 1 << 20
_LEAST_PATHS = 1 << 18
"""Into a body, though its triangles be few: the light that leaves then has a noise of some thousandths."""
_BLOCK = 256
"""Faces in a row, which lie together: what a path met by chance is spread over so many where it stands out…"""
_STANDS_OUT = 8.0
"""…by so many times the mean of the others, and of the nearest, for what neighbours share is a caustic. In a glass of
milk one path in 10⁵, from the table by the milk's mirror to the window, else shone in the shade as a bright dot."""
_BESIDE = 8


@dataclass(frozen=True)
class Arrived:
    """Flux at the corners of the triangles by their hat functions, over a third of the triangle: (m, 3, channels)."""

    table: Floats
    fresnel: Floats
    direction: Floats
    """Unit vector inside times the flux of all channels, (m, 3, 3)."""

    def __add__(self, other: Arrived) -> Arrived:
        return Arrived(self.table + other.table, self.fresnel + other.fresnel, self.direction + other.direction)

    def at_vertices(self, surface: BodySurface) -> Entered:
        """Means over the triangles round each vertex."""
        third = surface.triangle_areas() / 3
        fresnel = _collected(surface, self.fresnel, third)
        weight = _collected(surface, self.fresnel.sum(axis=2, keepdims=True), third)
        direction = _collected(surface, self.direction, third) / np.maximum(weight, 1e-300)
        return Entered(_collected(surface, self.table, third), fresnel, direction)


def _collected(surface: BodySurface, values: Floats, third: Floats) -> Floats:
    weight = np.bincount(surface.faces.ravel(), np.repeat(third, 3), len(surface.vertices))
    parts = [
        np.bincount(surface.faces.ravel(), (values[..., c] * third[:, None]).ravel(), len(surface.vertices))
        for c in range(values.shape[-1])
    ]
    return np.stack(parts, axis=1) / np.maximum(weight, 1e-300)[:, None]


def arrive(tracer: Tracer, mesh: Any, surface: BodySurface, samples: int, seed: int) -> Arrived:
    """What arrives at a mesh of the tracer's scene, whose triangles are the surface's, by `samples` of each or more."""
    n, n_channels = len(surface.faces), dr.size_v(mi.Spectrum)
    samples = max(samples, -(-_LEAST_PATHS // n))
    found = np.empty((n, 3, 2 * n_channels + 3))
    areas = surface.triangle_areas()
    size = max(1, _CHUNK // samples // _BLOCK) * _BLOCK
    for low in range(0, n, size):
        count = min(size, n - low)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed * 7919 + low // size, count * samples)
        path = dr.opaque(mi.UInt32, low * samples) + dr.arange(mi.UInt32, count * samples)
        u = [uniform(path, axis, seed) for axis in range(6)]
        by_lamps, by_chance, corners = _sample(tracer, mesh, path // dr.opaque(mi.UInt32, samples), u, sampler)
        dr.eval(by_lamps, by_chance, corners)  # together, else each would trace the paths anew
        hats = np.array(corners, np.float32).reshape(3, count, samples)
        steady, rare = (
            3
            / samples
            * np.einsum("hns,vns->nhv", hats, np.array(values, np.float32).reshape(-1, count, samples), optimize=True)
            for values in (by_lamps, by_chance)
        )
        found[low : low + count] = steady + spread_rare(rare, areas[low : low + count])
    return Arrived(*np.split(found, [n_channels, 2 * n_channels], axis=2))


def spread_rare(light: Floats, areas: Floats) -> Floats:
    """Light per area (m, 3, values) of faces (m,), that of those that stand out alone spread over their block."""
    density = np.abs(light).sum(axis=(1, 2), dtype=np.float64)
    expected = np.maximum(_of_others(density, areas, _BLOCK), _of_others(density, areas, _BESIDE))
    most = np.minimum(_STANDS_OUT * expected, density)
    rows = np.flatnonzero(density > most)
    kept = (most[rows] / density[rows])[:, None, None]
    block = np.arange(len(light)) // _BLOCK
    spread = np.zeros((block[-1] + 1, *light.shape[1:]))
    np.add.at(spread, block[rows], (1 - kept) * light[rows] * areas[rows, None, None])
    spread /= np.bincount(block, areas)[:, None, None]
    found = light.copy()
    found[rows] *= kept
    return np.asarray(found + spread[block])


def _of_others(density: Floats, areas: Floats, size: int) -> Floats:
    """Mean density of the other faces in the block of that size that each lies in."""
    power = density * areas
    others = np.maximum(_summed(power, size) - power, 0)
    return np.asarray(others / np.maximum(_summed(areas, size) - areas, 1e-300))


def _summed(values: Floats, size: int) -> Floats:
    """Over the block of that size that each lies in."""
    sums = np.add.reduceat(values, np.arange(0, len(values), size))
    return np.asarray(sums[np.arange(len(values)) // size])


def _sample(tracer: Tracer, mesh: Any, face: Any, u: list[Any], sampler: Any) -> tuple[list[Any], list[Any], Any]:
    """Light at one point of each face, that of lamps and that met by chance: by the table, by Fresnel, and its
    direction; and the point.
    """
    b = mi.warp.square_to_uniform_triangle(mi.Point2f(u[0], u[1]))
    hit = dr.zeros(mi.PreliminaryIntersection3f, dr.width(face))
    hit.valid, hit.prim_uv, hit.prim_index, hit.shape = mi.Bool(True), b, face, mi.ShapePtr(mesh)
    si = hit.compute_surface_interaction(dr.zeros(mi.Ray3f, dr.width(face)), +mi.RayFlags.All, mi.Bool(True))
    row, _ = tracer.media.row(si, mi.Bool(True))
    optics, normal = tracer.media.optics(si, row, mi.Bool(True)), tracer.media.normal(si, row, mi.Bool(True))
    steady, rare = (_Point(tracer, si, optics, normal) for _ in range(2))
    lamps = min(len(tracer.scene.emitters()), MOST_LAMPS)
    for lamp in range(lamps):
        steady.by_lamp(mi.Point2f((u[2] + lamp) / lamps, u[3]), lamps)
    rare.by_bounce(mi.Point2f(u[4], u[5]), lamps, sampler)
    return steady.light(), rare.light(), mi.Vector3f(1 - b.x - b.y, b.x, b.y)


class _Point:
    """What has arrived so far at a point of a body."""

    def __init__(self, tracer: Tracer, si: Any, optics: Optics, normal: Any) -> None:
        self._tracer = tracer
        self._si = si
        self._optics = optics
        self._normal = mi.Normal3f(normal)
        self.table = mi.Spectrum(0)
        self.fresnel = mi.Spectrum(0)
        self.direction = mi.Vector3f(0)

    def light(self) -> list[Any]:
        """Each value, channel by channel."""
        return [*self.table, *self.fresnel, *self.direction]

    def by_lamp(self, u: Any, lamps: int) -> None:
        ds, light = self._tracer.scene.sample_emitter_direction(self._si, u, True)
        cos = dr.maximum(dr.dot(self._normal, ds.d), 0)
        lit = (cos > 0) & (dr.dot(self._si.n, ds.d) > 0) & (ds.pdf > 0)
        share = dr.select(ds.delta, 1 / lamps, ds.pdf / (lamps * ds.pdf + cos / dr.pi))
        self._add(ds.d, cos, dr.select(lit, light * cos * share, 0))

    def by_bounce(self, u: Any, lamps: int, sampler: Any) -> None:
        tracer = self._tracer
        local = mi.warp.square_to_cosine_hemisphere(u)
        direction = mi.Frame3f(self._normal).to_world(local)
        path = tracer.start(self._si.spawn_ray(direction), dr.dot(direction, self._si.n) > 0)
        path.last, path.last_pdf, path.last_delta = mi.Interaction3f(self._si), local.z / dr.pi / lamps, mi.Bool(False)
        path, _ = dr.while_loop(
            (path, sampler),
            lambda path, _: path.active,
            lambda path, sampler: (tracer.step(path, sampler), sampler),
            label="arriving light",
        )
        self._add(direction, local.z, dr.pi * path.radiance)

    def _add(self, direction: Any, cos: Any, light: Any) -> None:
        media = self._tracer.media
        fresnel = light * media.transmittance(self._optics, cos)
        inside = -refract_in(direction, self._normal, self._optics.eta)
        self.table += light * media.entering(self._optics, cos)
        self.fresnel += fresnel
        self.direction += inside * dr.sum(fresnel)
