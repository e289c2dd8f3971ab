"""Light that leaves a closed body of any form: walks from places on it back to the light that entered, stored there.

A walk starts along the refraction of a direction outside, and scatters inside the body. At every meeting with the
surface it takes the light that entered there and goes on, reflected: no lamp has to be found through the boundary, and
no form of the body is assumed. Light that runs along a beam inside is looked for from every scattering too, and what
both ways find is weighed by the balance heuristic. Coefficients in 1/scene unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from bssrdf.render.interface import phase, refract_in, sample_phase, transmittance_table
from bssrdf.render.points.entry import CONCENTRATION, EntryLight, as_floats, as_vector, even_norm
from bssrdf.render.points.leap import DRAWS, FIELDS, RADII, room_grid, stored_leaps
from bssrdf.render.points.record import BodySurface, Entered, Floats, Integers

LEAST = 0.1
"""Throughput below which Russian roulette decides whether a walk goes on."""
_LOOKS = 0.3
"""Throughput down to which scatterings look for a beam: those after it bring little, and looking is half their time."""
_GAP = 1e-5
"""Of the body's size: how far inside the surface a ray starts, in single precision."""
_LANES = 1 << 16
"""Walks at a time, so that long ones do not keep lanes waiting."""


@dataclass(frozen=True)
class Inside:
    """What light meets in a body: one value per channel, and the boundary."""

    sigma_a: Floats
    """(channels,)."""
    sigma_sp: Floats
    """(channels,)."""
    eta: float
    g: float = 0.0
    alpha: float = 0.0
    """Roughness of the boundary."""


@dataclass(frozen=True)
class Walked:
    """Radiant exitance at each place, and the variance of that estimate, (k, channels)."""

    mean: Floats
    variance: Floats


def walked(
    surface: BodySurface,
    entered: Entered,
    inside: Inside,
    places: Floats,
    normals: Floats,
    *,
    towards: Floats | None = None,
    walks: int | Integers,
    seed: int = 0,
) -> Walked:
    """Radiant exitance at places (k, 3) with outward normals (k, 3), by `walks` walks per channel from each.

    Args: towards: unit vectors (k, 3) out of the surface, along which π times the radiance is found instead, or 0;
    walks: one number, or (k,). The places lie within triangles, not on edges, where half of the directions would leave
    the body.
    """
    body = _Body(surface, entered, inside)
    starts = [places, normals, np.zeros_like(places) if towards is None else towards]
    numbers = np.broadcast_to(walks, len(places))
    mean, variance = np.empty((2, len(places), len(inside.sigma_a)))
    for number in np.unique(numbers):
        rows = numbers == number
        mean[rows], variance[rows] = _moments(body, [part[rows] for part in starts], int(number), seed)
    return Walked(mean, variance)


def _moments(body: _Body, starts: list[Floats], walks: int, seed: int) -> tuple[Floats, Floats]:
    """Means over `walks` walks from each place, and their variances, (k, channels)."""
    places, channels = len(starts[0]), body.channels
    split = max(1, min(walks // 4, _LANES // places))
    each = -(-walks // split)
    total, squares = np.zeros((2, places, channels))
    size = max(1, _LANES // split)
    for low in range(0, places, size):
        rows = slice(low, low + size)
        lanes = [np.repeat(part[rows], split, axis=0) for part in starts]
        for channel in range(channels):  # of the same random numbers: noise has little colour then
            sums = _lanes(body, channel, lanes, each, seed + 7919 * low)
            total[rows, channel], squares[rows, channel] = (part.reshape(-1, split).sum(axis=1) for part in sums)
    n = each * split
    mean = total / n
    return mean, np.maximum(squares / n - mean**2, 0) / max(n - 1, 1)


@dataclass
class _Walk:
    """Where each lane is, and what it has seen; a lane goes on with its next walk when one has ended."""

    o: Any
    d: Any
    throughput: Any
    radiance: Any
    """Of the walk that goes on."""
    total: Any
    squares: Any
    left: Any
    share: Any
    """Of a beam met next, for it may have been looked for as well."""
    active: Any


def _lanes(body: _Body, channel: int, starts: list[Floats], walks: int, seed: int) -> tuple[Floats, Floats]:
    """Sums over the walks of each lane of what they found, and of its square."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(starts[0]))
    p, n, towards = (mi.Vector3f(part.T.astype(np.float32)) for part in starts)
    optics = body.optics(channel)
    o, d, throughput = body.start(p, n, towards, sampler)
    nothing = mi.Float(0)
    left = dr.opaque(mi.UInt32, walks - 1)
    walk = _Walk(o, d, throughput, nothing, mi.Float(0), mi.Float(0), left, mi.Float(1), mi.Bool(True))

    def step(walk: _Walk, sampler: Any) -> tuple[_Walk, Any]:
        walk = body.step(walk, optics, sampler)
        done = ~walk.active
        walk.total += dr.select(done, walk.radiance, 0)
        walk.squares += dr.select(done, dr.square(walk.radiance), 0)
        again = done & (walk.left > 0)
        o, d, throughput = body.start(p, n, towards, sampler)
        walk.o, walk.d = dr.select(again, o, walk.o), dr.select(again, d, walk.d)
        walk.throughput = dr.select(again, throughput, walk.throughput)
        walk.radiance = dr.select(done, 0, walk.radiance)
        walk.share = dr.select(done, 1, walk.share)
        walk.left -= dr.select(again, mi.UInt32(1), mi.UInt32(0))
        walk.active |= again
        return walk, sampler

    walk, _ = dr.while_loop((walk, sampler), lambda walk, _: walk.active, step, label="walks")
    return np.array(walk.total, np.float64), np.array(walk.squares, np.float64)


class _Optics(NamedTuple):
    """Of a channel; arrays of one value, so that one kernel serves all media."""

    channel: Any
    sigma_t: Any
    albedo: Any


class _Body:
    """A closed surface with stored light, as Dr.Jit arrays and as a scene of its own."""

    def __init__(self, surface: BodySurface, entered: Entered, inside: Inside) -> None:
        self.channels = len(inside.sigma_a)
        self._scene = mi.load_dict({"type": "scene", "body": _mesh(surface)})
        self._gap = _GAP * float(np.ptp(surface.vertices, axis=0).max())
        self._faces = mi.UInt32(surface.faces.astype(np.uint32).ravel())
        corners = surface.vertices[surface.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
        self._face_normals = as_floats(across)
        self._normals = as_floats(surface.normals)
        sigma_s = inside.sigma_sp / (1 - inside.g)
        self._sigma_t = inside.sigma_a + sigma_s
        self._albedo = sigma_s / self._sigma_t
        self._eta, self._g = inside.eta, inside.g
        enters = transmittance_table(inside.eta, inside.alpha)
        self._norm = even_norm(enters)
        self._slopes = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, inside.alpha, True) if inside.alpha else None
        self._leaps = as_floats(stored_leaps(inside.g))
        self._room = room_grid(surface)
        self._rooms = as_floats(self._room.room)
        self._entry = EntryLight(surface, entered, inside.eta, enters, self._room)

    def optics(self, channel: int) -> _Optics:
        sigma_t, albedo = float(self._sigma_t[channel]), float(self._albedo[channel])
        return _Optics(dr.opaque(mi.UInt32, channel), dr.opaque(mi.Float, sigma_t), dr.opaque(mi.Float, albedo))

    def start(self, p: Any, n: Any, towards: Any, sampler: Any) -> tuple[Any, Any, Any]:
        """Rays into the body; the weight is the transmittance over its mean C."""
        given = mi.Frame3f(n).to_local(towards)
        out = dr.select(given.z > 0, given, mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
        facet = self._facet(out, sampler)
        cos = dr.dot(out, facet)
        mirrored = 2 * cos * facet - out
        reflected = mi.fresnel(cos, self._eta)[0]
        if self._slopes is not None:
            reflected = dr.select(mirrored.z > 0, reflected * self._slopes.smith_g1(mirrored, mi.Normal3f(facet)), 0)
        into = -refract_in(out, facet, self._eta)
        into.z = -dr.abs(into.z)
        return mi.Point3f(p - self._gap * n), mi.Vector3f(mi.Frame3f(n).to_world(into)), (1 - reflected) / self._norm

    def _facet(self, direction: Any, sampler: Any) -> Any:
        """The normal that light on its way across the surface finds, in coordinates about the surface's own."""
        if self._slopes is None:
            return mi.Vector3f(0, 0, 1)
        return mi.Vector3f(self._slopes.sample(direction, sampler.next_2d())[0])

    def step(self, walk: _Walk, optics: _Optics, sampler: Any) -> _Walk:
        """To the next scattering or meeting with the surface, or out of an empty sphere."""
        level = self._level(walk.o, optics, walk.active)
        leaps = walk.active & (level >= 0)
        t = -dr.log(1 - sampler.next_1d(walk.active)) / optics.sigma_t
        ray = mi.Ray3f(walk.o, walk.d, t, 0.0, [])
        flies = walk.active & ~leaps
        met = self._scene.ray_intersect_preliminary(ray, False, flies)
        hit = flies & met.is_valid()
        u, v = sampler.next_2d(walk.active), sampler.next_1d(walk.active)
        distance = dr.select(hit, met.t, t)
        place, turned, orders = self._leap(walk, level, optics, u, v, leaps)
        ahead = sample_phase(self._g, walk.d, u)
        walk.o = mi.Point3f(dr.select(leaps, place, walk.o + distance * walk.d))
        lost = dr.select(leaps, dr.power(optics.albedo, orders), dr.select(hit, 1, optics.albedo))
        walk.throughput = walk.throughput * lost
        share = self._look_for_beam(walk, optics, ahead, flies & ~hit, sampler)
        walk = self._at_surface(walk, optics, met, hit, dr.select(leaps, turned, ahead), sampler)
        unscattered = leaps & (orders == 0)  # the surface may still be met along the way that was looked along
        walk.share = dr.select(flies & ~hit, share, dr.select(unscattered, walk.share, 1))
        survival = dr.minimum(walk.throughput / LEAST, 1)
        walk.active &= sampler.next_1d(walk.active) < survival
        walk.throughput = walk.throughput / dr.maximum(survival, 1e-9)
        return walk

    def _cell(self, o: Any, active: Any) -> tuple[Any, Any, Any]:
        """The cell of the room that a place lies in, whether there is one, and the way to its middle."""
        at = (o - mi.Point3f(*self._room.low.tolist())) / self._room.cell
        cell = mi.Vector3i(at)
        size = self._room.room.shape
        known = active & dr.all((cell >= 0) & (cell < mi.Vector3i(*size)))
        index = mi.UInt32((cell.x * size[1] + cell.y) * size[2] + cell.z)
        return index, known, self._room.cell * dr.norm(at - mi.Vector3f(cell) - 0.5)

    def _level(self, o: Any, optics: _Optics, active: Any) -> Any:
        """Which of RADII fits between a place and the surface, −1 for none."""
        index, known, off = self._cell(o, active)
        room = dr.gather(mi.Float, self._rooms, index, known) - off
        depth = dr.maximum(room * optics.sigma_t / float(RADII[0]), 1e-3)
        level = dr.minimum(mi.Int32(dr.floor(2 * dr.log2(depth))), len(RADII) - 1)
        return dr.select(known, level, -1)

    def _look_for_beam(self, walk: _Walk, optics: _Optics, ahead: Any, active: Any, sampler: Any) -> Any:
        """Take the light that arrives unscattered by a beam, and tell the share of one met along `ahead`."""
        index, known, _ = self._cell(walk.o, active)
        guide = self._entry.towards(index, known)
        known &= (dr.squared_norm(guide) > 0) & (walk.throughput > _LOOKS)
        frame = mi.Frame3f(guide)
        local = mi.warp.square_to_von_mises_fisher(sampler.next_2d(active), CONCENTRATION)
        toward = mi.Vector3f(frame.to_world(local))
        met = self._scene.ray_intersect_preliminary(mi.Ray3f(walk.o, toward), False, known)
        corners, weights, n, across = self._met(met, known & met.is_valid())
        hit = known & met.is_valid() & (dr.dot(across, toward) > 0)
        beam = self._entry.beam(corners, weights, optics.channel, toward, n, hit)
        scattered = phase(self._g, dr.dot(walk.d, toward))
        density = mi.warp.square_to_von_mises_fisher_pdf(local, CONCENTRATION)
        arrives = beam * dr.exp(-optics.sigma_t * met.t) * scattered / (scattered + density)
        walk.radiance += dr.select(hit, walk.throughput * arrives, 0)
        by_phase = phase(self._g, dr.dot(walk.d, ahead))
        by_guide = mi.warp.square_to_von_mises_fisher_pdf(mi.Vector3f(frame.to_local(ahead)), CONCENTRATION)
        return dr.select(known, by_phase / (by_phase + by_guide), 1)

    def _met(self, met: Any, hit: Any) -> tuple[list[Any], tuple[Any, ...], Any, Any]:
        """Corners of the triangle and their weights, the shading normal, and the triangle's own."""
        corners = [dr.gather(mi.UInt32, self._faces, 3 * met.prim_index + i, hit) for i in range(3)]
        b = met.prim_uv
        weights = (1 - b.x - b.y, b.x, b.y)
        first, second, third = (
            weight * as_vector(self._normals, corner, hit) for weight, corner in zip(weights, corners, strict=True)
        )
        across = as_vector(self._face_normals, met.prim_index, hit)
        return corners, weights, dr.normalize(first + second + third), across

    def _leap(self, walk: _Walk, level: Any, optics: _Optics, u: Any, v: Any, leaps: Any) -> tuple[Any, Any, Any]:
        """Place and direction on the sphere, and the scatterings before."""
        drawn = dr.minimum(mi.UInt32(v * DRAWS), DRAWS - 1)
        row = (mi.UInt32(dr.maximum(level, 0)) * DRAWS + drawn) * FIELDS
        x, y, z, a, b, c, orders = (dr.gather(mi.Float, self._leaps, row + i, leaps) for i in range(FIELDS))
        sin, cos = dr.sincos(2 * dr.pi * u.x)
        frame = mi.Frame3f(walk.d)
        radius = dr.exp2(mi.Float(level) / 2) * float(RADII[0]) / optics.sigma_t
        place = walk.o + radius * frame.to_world(mi.Vector3f(cos * x - sin * y, sin * x + cos * y, z))
        return place, frame.to_world(mi.Vector3f(cos * a - sin * b, sin * a + cos * b, c)), orders

    def _at_surface(self, walk: _Walk, optics: _Optics, met: Any, hit: Any, elsewhere: Any, sampler: Any) -> _Walk:
        """Take the light that entered, and go on reflected; elsewhere along the direction given."""
        corners, weights, n, across = self._met(met, hit)
        even = self._entry.even(corners, weights, optics.channel, hit)
        beam = walk.share * self._entry.beam(corners, weights, optics.channel, walk.d, n, hit)
        if self._slopes is not None:
            frame = mi.Frame3f(n)
            local = frame.to_local(walk.d)
            local.z = dr.maximum(local.z, 1e-3)
            n = frame.to_world(self._facet(dr.normalize(local), sampler))
        reflected = mi.fresnel(-dr.clip(dr.dot(n, walk.d), 1e-4, 1), self._eta)[0]
        walk.radiance += dr.select(hit, walk.throughput * ((1 - reflected) * even + beam), 0)
        walk.throughput = dr.select(hit, walk.throughput * reflected, walk.throughput)
        walk.active &= ~(hit & (dr.dot(across, walk.d) <= 0))  # it came through a crack
        mirrored = walk.d - 2 * dr.dot(walk.d, n) * n
        flat = walk.d - 2 * dr.dot(walk.d, across) * across
        mirrored = dr.select(dr.dot(mirrored, across) < 0, mirrored, flat)
        walk.o = mi.Point3f(dr.select(hit, walk.o - self._gap * across, walk.o))
        walk.d = mi.Vector3f(dr.normalize(dr.select(hit, mirrored, elsewhere)))
        return walk


def _mesh(surface: BodySurface) -> Any:
    built = mi.Mesh("body", len(surface.vertices), len(surface.faces))
    held = mi.traverse(built)
    held["vertex_positions"] = as_floats(surface.vertices)
    held["faces"] = mi.UInt32(surface.faces.astype(np.uint32).ravel())
    held.update()
    return built
