"""How long edges may be: a mean free path or a pixel in view, more out of sight, less where a narrow beam falls."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np

from bssrdf.render.points.blend import Viewer
from bssrdf.render.points.record import Floats, LightPlan
from bssrdf.render.points.spread import Target

OUT_OF_SIGHT = 4.0
"""Edges of a mean free path that are out of sight are so much longer."""
_PER_SPOT = 8.0
"""Edges along the radius of a beam's spot: its rim then holds a tenth of its light."""
_GRADE = 6.0
"""Edges grow by the distance from a spot over that: R_d falls as a power of it there…"""
_FAR = 6.0
"""…and within so many 1/σtr they are half as long as that: straight lines then hold its light to a percent."""
_BACK = -0.15
"""Cosine to the viewer of what is still taken to be in sight, for normals are smoothed."""
_GRID = 24


class InView(NamedTuple):
    """What a camera sees of places: how wide a pixel is there, and how far outside the frame they lie."""

    pixel: Floats
    outside: Floats
    facing: Floats


def target_edge(
    mean_free_path: float, fall: float, sensor: Any | None, spots: list[tuple[Floats, float]], plan: LightPlan
) -> Target:
    """Rule for a body of that 1/σt′, where light falls by 1/e over `fall`; `spots` are centres and radii of beams."""
    along = mean_free_path / plan.per_mean_free_path
    see = None if sensor is None else _camera(sensor)

    def target(places: Floats, normals: Floats) -> Floats:
        edge = np.full(len(places), along)
        if see is not None:
            sight = see(places, normals)
            fine = np.maximum(along, sight.pixel / plan.per_pixel)
            edge = np.where(sight.facing > _BACK, fine, np.maximum(fine, OUT_OF_SIGHT * along)) + sight.outside / 4
        for centre, radius in spots:
            beyond = np.maximum(np.linalg.norm(places - centre, axis=1) - 1.3 * radius, 0)
            rim = radius / _PER_SPOT
            near = np.where(beyond < _FAR * fall, max(fall / 2, rim), np.inf)
            edge = np.minimum(edge, np.minimum(rim + beyond / _GRADE, near))
        return edge

    return target


def _camera(sensor: Any) -> Callable[[Floats, Floats], InView] | None:
    """None for a sensor whose pixels are not known."""
    known = mi.traverse(sensor)
    if "to_world" not in known:
        return None
    matrix = _to_world(known)
    width, height = (int(side) for side in sensor.film().size())
    if "x_fov" in known:
        tangent = math.tan(math.radians(float(np.ravel(np.array(known["x_fov"]))[0])) / 2)
    elif sensor.class_name() == "OrthographicCamera":
        tangent = None
    else:
        return None
    back = np.linalg.inv(matrix)
    viewer = _viewer(matrix, tangent is None)
    scale = np.linalg.norm(matrix[:3, 0])

    def see(places: Floats, normals: Floats) -> InView:
        seen = places @ back[:3, :3].T + back[:3, 3]
        half = np.ones(len(places)) if tangent is None else np.maximum(seen[:, 2], 1e-6) * tangent
        beyond = np.maximum(np.abs(seen[:, 0]) - 1.05 * half, np.abs(seen[:, 1]) - 1.05 * half * height / width)
        outside = np.maximum(np.maximum(beyond, -seen[:, 2]), 0)
        return InView(2 * half * scale / width, outside * scale, np.einsum("ij,ij->i", viewer(places), normals))

    return see


def viewer_of(sensor: Any | None) -> Viewer | None:
    """The directions to a camera; None for a sensor that has none of its own."""
    if sensor is None or sensor.class_name() not in ("PerspectiveCamera", "ThinLensCamera", "OrthographicCamera"):
        return None
    return _viewer(_to_world(mi.traverse(sensor)), sensor.class_name() == "OrthographicCamera")


def _viewer(matrix: Floats, parallel: bool) -> Viewer:
    eye, ahead = matrix[:3, 3], matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])

    def towards(places: Floats) -> Floats:
        way = np.broadcast_to(-ahead, places.shape) if parallel else eye - places
        return np.asarray(way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12))

    return towards


def _to_world(known: Any) -> Floats:
    return np.array(known["to_world"].matrix, np.float64).reshape(4, 4)


def spots_on(scene: Any, bsdf: Any) -> list[tuple[Floats, float]]:
    """Centres and radii of what the scene's spot lights shine on of the body with that surface."""
    found = []
    for light in scene.emitters():
        if light.class_name() != "SpotLight":
            continue
        u = (np.arange(_GRID, dtype=np.float32) + 0.5) / _GRID
        first, second = (mi.Float(side.ravel()) for side in np.meshgrid(u, u))
        ray, _ = light.sample_ray(0.0, 0.5, mi.Point2f(first, second), mi.Point2f(first, second), True)
        si = scene.ray_intersect(ray)
        hit = np.array(si.is_valid() & (si.bsdf() == mi.BSDFPtr(bsdf)), bool) & np.ones(_GRID * _GRID, bool)
        places = np.array(si.p, np.float64).T[hit]
        if len(places):
            centre = places.mean(axis=0)
            found.append((centre, float(np.linalg.norm(places - centre, axis=1).max())))
    return found
