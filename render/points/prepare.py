"""All that is found before a picture is drawn: bodies refined, the light that enters them, the light that leaves."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from bssrdf.render.medium import Media
from bssrdf.render.mesh_file import mitsuba_mesh
from bssrdf.render.paths import EXITANCE, Settings, Tracer
from bssrdf.render.points.blend import Sampled, Viewer, mended, sampled
from bssrdf.render.points.enter import Arrived, arrive
from bssrdf.render.points.exchange import drawn_in, rounds_for, settle
from bssrdf.render.points.fineness import spots_on, target_edge, viewer_of
from bssrdf.render.points.gather import gather
from bssrdf.render.points.mirrored import mirrored
from bssrdf.render.points.record import BodySurface, Floats, LightPlan
from bssrdf.render.points.spread import is_closed, openings, parts_of, refine, surface_of
from bssrdf.render.points.walk import Inside
from bssrdf.render.surface_nets import body_size

Progress = Callable[[str, int, int], None]
_BYTES = 2000
"""Of memory per triangle: 800 were seen from 44,000 to 500,000 triangles; as much again for what runs beside."""
_FAR = 10.0
"""Size of a body over how far its light spreads, below which its own light counts: the face, of 18, gains 0.3 %."""


@dataclass(frozen=True)
class Prepared:
    """A scene whose bodies' vertices hold the light that leaves them."""

    given: Any
    """The scene that it was made of, so that no other takes its place in memory."""
    scene: Any
    tracer: Tracer


def prepare(scene: Any, sensor: Any | None, settings: Settings, plan: LightPlan, progress: Progress | None) -> Prepared:
    """Find the light under all surfaces of a scene as the sensor will look at them."""
    media = Media(scene, settings.kernel)
    for line in openings(media.shapes) + media.remarks():
        warnings.warn(line, stacklevel=2)
    refined = [(shape, _refined(scene, shape, media, sensor, plan)) for shape in media.shapes]
    parts = [(shape, part) for shape, surface in refined for part in parts_of(surface)]
    surfaces = [surface for _, surface in parts]
    meshes = [_mesh(shape, surface) for shape, surface in parts]
    finer = _rebuilt(scene, media.shapes, meshes)
    inner = replace(settings, local=True, max_depth=Settings.max_depth, hide_emitters=False, mirrors_apart=True)
    first = Tracer(finer, inner)
    by_mirror = mirrored(first, meshes, surfaces, plan.seed)

    def lit(tracer: Tracer, what: str, by: LightPlan) -> list[_LitBody]:
        found = []
        for number, ((shape, surface), mesh) in enumerate(zip(parts, meshes, strict=True)):
            if progress is not None:
                progress(f"light into {shape.id()}{what}", number, len(meshes))
            arrived = arrive(tracer, mesh, surface, plan.light_samples, plan.seed) + by_mirror[number]
            found.append(_LitBody(shape.id(), mesh, surface, arrived))
        for body in found:
            _leave(tracer.media, body, found, viewer_of(sensor), by)
        return found

    rounds = rounds_for(first, meshes) if settings.kernel == "table" else "none"
    again = Tracer(finer, replace(inner, local=False))
    far = rounds == "one" and any(_spreads_far(_optics(media, shape, surface), surface) for shape, surface in parts)
    if far and plan.method == "walks":
        lit(first, "", replace(plan, walks=max(plan.walks // 8, 2), opening=2 * plan.opening))
        lit(again, ", from itself", plan)
    else:
        bodies = lit(first, "", plan)
        if rounds == "many":
            settle(bodies, lambda number: lit(again, f", from bodies, {number}", plan))
    return Prepared(scene, finer, Tracer(finer, settings))


@dataclass(frozen=True)
class _LitBody:
    name: str
    mesh: Any
    surface: BodySurface
    arrived: Arrived


def _refined(scene: Any, shape: Any, media: Media, sensor: Any | None, plan: LightPlan) -> BodySurface:
    surface = surface_of(shape)
    optics = _optics(media, shape, surface)
    lengths = 1 / np.maximum(optics.sigma_tp.mean(axis=0), 1e-30)
    path = float(np.sqrt(lengths.min() * lengths.mean()))
    fall = float(1 / np.maximum(optics.decay().mean(), 1e-30))
    target = target_edge(path, fall, sensor, spots_on(scene, shape.bsdf()), plan)
    surface = _ordered(refine(surface, target, min(plan.most, _free_bytes() // _BYTES), shape.id()))
    return drawn_in(surface) if is_closed(surface) else surface


def _spreads_far(optics: _Coefficients, surface: BodySurface) -> bool:
    return float(optics.decay().min()) * body_size(surface.vertices, surface.faces) < _FAR


def _free_bytes() -> int:
    """Memory that can be had; as good as endless where the system does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return 1 << 62
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))


def _ordered(surface: BodySurface) -> BodySurface:
    """Faces so that neighbours follow each other."""
    from bssrdf.render.points.tree import order

    return replace(surface, faces=surface.faces[order(surface.vertices[surface.faces].mean(axis=1))])


@dataclass(frozen=True)
class _Coefficients:
    """Of the medium under each vertex, (n, channels)."""

    albedo: Floats
    sigma_tp: Floats
    total: Floats

    def decay(self) -> Floats:
        """σtr."""
        return np.asarray(np.sqrt(3 * (1 - self.albedo)) * self.sigma_tp)


def _optics(media: Media, shape: Any, surface: BodySurface) -> _Coefficients:
    n, n_channels = len(surface.vertices), dr.size_v(mi.Spectrum)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.shape, si.uv = mi.ShapePtr(shape), mi.Point2f(surface.uv.T.astype(np.float32))
    row, _ = media.row(si, mi.Bool(True))
    optics = media.optics(si, row, mi.Bool(True))
    parts = (optics.sigma_a, optics.sigma_sp, media.total(optics))
    sigma_a, sigma_sp, total = (
        np.broadcast_to(np.array(part, np.float64).reshape(n_channels, -1).T, (n, n_channels)) for part in parts
    )
    sigma_tp = sigma_a + sigma_sp
    return _Coefficients(sigma_sp / np.maximum(sigma_tp, 1e-30), sigma_tp, total)


def _mesh(shape: Any, surface: BodySurface) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = shape.bsdf()
    return mitsuba_mesh(shape.id(), surface, properties)


def _rebuilt(scene: Any, shapes: list[Any], meshes: list[Any]) -> Any:
    """The scene with these meshes in the place of the shapes."""
    bodies = {id(shape) for shape in shapes}
    kept = [shape for shape in scene.shapes() if id(shape) not in bodies]
    lights = [light for light in scene.emitters() if light.get_shape() is None]
    things = {f"thing{i}": thing for i, thing in enumerate([*meshes, *kept, *lights])}
    return mi.load_dict({"type": "scene", **things}, optimize=False)


def _leave(media: Media, body: _LitBody, bodies: list[_LitBody], viewer: Viewer | None, plan: LightPlan) -> None:
    """Sum the light of all shapes that are one body with it, and put what leaves on its vertices."""
    same = _of_one_body(body, bodies)
    optics = _optics(media, body.mesh, body.surface)
    with ThreadPoolExecutor(1) as beside:  # of either, what runs on one core leaves the other to the other
        points = beside.submit(_by_points, media, body, same, optics, plan)
        walks = _by_walks(media, body, optics, viewer, plan) if plan.method == "walks" else None
        exitance = points.result()
    if walks is not None:
        exitance = mended(body.surface, walks, exitance)
    over = _between_vertices(body.surface, exitance / np.maximum(optics.total, 1e-30)).astype(np.float32)
    if body.mesh.has_attribute(EXITANCE):
        body.mesh.remove_attribute(EXITANCE)
    body.mesh.add_attribute(EXITANCE, over.shape[1], mi.Float(over.ravel()))


def _of_one_body(body: _LitBody, bodies: list[_LitBody]) -> list[_LitBody]:
    """A closed shape is a body by itself, open ones that share a surface are one: the sides of a box, say."""
    if is_closed(body.surface):
        return [body]
    alike = [other for other in bodies if other.mesh.bsdf() == body.mesh.bsdf()]
    return [other for other in alike if not is_closed(other.surface)]


def _between_vertices(surface: BodySurface, values: Floats) -> Floats:
    """Values at vertices, (n, channels), between which straight lines hold the light of the curve through `values`.

    A straight line lies above a light that falls exponentially. In the mean over triangles it does so by half of what
    values rise when they are averaged by hat functions; none leaves the range of its neighbours.
    """
    first, place = surface.places()
    of_place, corners = values[first], place[surface.faces]
    third = surface.triangle_areas() / 3
    around = np.maximum(np.bincount(corners.ravel(), np.repeat(third, 3), len(first)), 1e-300)
    changed = np.empty_like(of_place)
    for channel, value in enumerate(of_place.T):
        at = value[corners]
        rise = (at.sum(axis=1, keepdims=True) - 3 * at) / 4
        mean = np.bincount(corners.ravel(), (rise * third[:, None]).ravel(), len(first)) / around
        least, most = value.copy(), value.copy()
        np.minimum.at(least, corners.ravel(), np.repeat(at.min(axis=1), 3))
        np.maximum.at(most, corners.ravel(), np.repeat(at.max(axis=1), 3))
        changed[:, channel] = np.clip(value - mean / 2, least, most) - value
    return np.maximum(values + changed[place], 0)


def _by_points(media: Media, body: _LitBody, same: list[_LitBody], optics: _Coefficients, plan: LightPlan) -> Floats:
    first, place = body.surface.places()
    return gather(
        np.concatenate([other.surface.vertices[other.surface.faces] for other in same]),
        np.concatenate([other.arrived.table for other in same]),
        body.surface.vertices[first],
        media.tables[_row(media, body)],
        optics.albedo[first],
        optics.sigma_tp[first],
        plan.opening,
    )[place]


def _row(media: Media, body: _LitBody) -> int:
    return next(i for i, surface in enumerate(media.surfaces) if surface is body.mesh.bsdf().surface)


def _by_walks(
    media: Media, body: _LitBody, optics: _Coefficients, viewer: Viewer | None, plan: LightPlan
) -> Sampled | None:
    """What mends the light of points; None where a body is open or its coefficients vary, and it stays as it is."""
    surface = media.surfaces[_row(media, body)]
    if surface.textured or not is_closed(body.surface):
        what = "varies over its surface" if surface.textured else "is open"
        warnings.warn(f'shape "{body.name}" {what}: its light is that of points on a half space', stacklevel=2)
        return None
    sigma_tp = optics.sigma_tp[0]
    sigma_sp = optics.albedo[0] * sigma_tp
    inside = Inside(sigma_tp - sigma_sp, sigma_sp, surface.eta, surface.g, surface.alpha)
    return sampled(
        body.surface,
        body.arrived.at_vertices(body.surface),
        inside,
        viewer,
        media.leaving_of(_row(media, body)),
        walks=plan.walks,
        seed=plan.seed,
    )
