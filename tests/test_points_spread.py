"""A body's surface: parts of one mesh, and edges without a second face."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import mitsuba as mi
from mitsuba_scenes import MARBLE, prepared, sampler

from bssrdf.render.mesh_file import mitsuba_mesh
from bssrdf.render.points.record import BodySurface
from bssrdf.render.points.spread import is_closed, openings, parts_of, surface_of

pytestmark = pytest.mark.usefixtures("mitsuba_mono")


def cube(x: float, half: float) -> BodySurface:
    place = mi.ScalarTransform4f().translate([x, 0, 0]).scale(half)
    return surface_of(mi.load_dict({"type": "cube", "to_world": place}))


def turned(surface: BodySurface) -> BodySurface:
    return replace(surface, faces=surface.faces[:, ::-1], normals=-surface.normals)


def joined(*parts: BodySurface) -> BodySurface:
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, first, strict=False)]
    fields = ([part.vertices for part in parts], [part.normals for part in parts], [part.uv for part in parts], faces)
    return BodySurface(*(np.concatenate(field) for field in fields))


def test_closed_parts_that_lie_apart_are_bodies_of_their_own() -> None:
    left, right = parts_of(joined(cube(-2.0, 1.0), cube(1.0, 1.5)))
    assert is_closed(left)
    assert is_closed(right)
    assert left.areas().sum() == pytest.approx(24)
    assert right.areas().sum() == pytest.approx(54)


@pytest.mark.parametrize(
    "pair", [(0.0, 1.0, 1.5), (0.0, 2.0, 0.5)], ids=["that run through each other", "one a cavity of the other"]
)
def test_parts_stay_one_body(pair: tuple[float, float, float]) -> None:
    x, half, other = pair
    assert len(parts_of(joined(cube(x, half), turned(cube(1.0, other))))) == 1


def test_parts_of_an_open_mesh_stay_one_body() -> None:
    both = joined(cube(-2.0, 1.0), cube(2.0, 1.0))
    assert len(parts_of(replace(both, faces=both.faces[1:]))) == 1


def seen_on_the_right(*parts: BodySurface) -> float:
    """Mean radiance of what lies right of 0, lit from the left."""
    surface = mi.load_dict({"type": "bssrdf_medium", **MARBLE})
    properties = mi.Properties()
    properties["bsdf"] = surface
    bodies = {f"body{i}": mitsuba_mesh(f"body{i}", part, properties) for i, part in enumerate(parts)}
    lamp = {"type": "directional", "direction": [1, 0.2, -0.1]}
    scene = mi.load_dict({"type": "scene", "lamp": lamp, **bodies}, optimize=False)
    integrator, n = prepared(scene, view=16.0, light_samples=16), 1 << 12
    place = sampler(n, 0).next_2d()
    ray = mi.Ray3f(mi.Point3f(0.2 + 2.6 * place.x, -9.0, 2.6 * place.y - 1.3), mi.Vector3f(0, 1, 0))
    return float(np.mean(np.array(integrator.sample(scene, sampler(n, 1), ray)[0])))


def test_light_does_not_leap_from_part_to_part_inside() -> None:
    left, right = cube(-1.55, 1.5), cube(1.55, 1.5)
    assert seen_on_the_right(joined(left, right)) == pytest.approx(seen_on_the_right(left, right), rel=5e-3)


@pytest.mark.parametrize(("apart", "told"), [(1e-9, 0), (0.01, 1)])
def test_corners_closer_than_a_hair_leave_no_opening(apart: float, told: int) -> None:
    surface = cube(0.0, 1.0)
    moved = surface.vertices.copy()
    moved[0] += apart
    assert is_closed(replace(surface, vertices=moved)) == (not told)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "bssrdf_medium", **MARBLE})
    assert len(openings([mitsuba_mesh("a", replace(surface, vertices=moved), properties)])) == told
