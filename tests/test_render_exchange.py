"""Light that goes from body to body, and between bodies that touch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import mitsuba as mi
from mitsuba_scenes import SKY, prepared, sampler

from bssrdf.render.points.exchange import drawn_in
from bssrdf.render.points.spread import is_closed, surface_of

pytestmark = pytest.mark.usefixtures("mitsuba_mono")

WHITE = {"type": "bssrdf_medium", "sigma_a": 0.0, "sigma_sp": 1.0, "eta": 1.4}


def cube(x: float, half: float, surface: Any) -> dict[str, Any]:
    return {"type": "cube", "to_world": mi.ScalarTransform4f().translate([x, 0, 0]).scale(half), "bsdf": surface}


def seen_from_around(scene: Any, **options: Any) -> float:
    """Mean radiance along rays that meet the bodies, over four directions."""
    integrator, n = prepared(scene, view=16.0, **options), 1 << 14
    found = []
    for number, towards in enumerate(([1, 2, -1.5], [-1, 0.5, -1], [0.3, -2, -1], [-2, 1, 2])):
        away = mi.Vector3f(*(-np.array(towards) / np.linalg.norm(towards)).tolist())
        place = 12 * sampler(n, number).next_2d() - 6
        ray = mi.Ray3f(mi.Point3f(mi.Frame3f(away).to_world(mi.Vector3f(place.x, place.y, 30))), -away)
        met = np.array(scene.ray_test(ray), bool)
        found.append(np.array(integrator.sample(scene, sampler(n, 9 + number), ray)[0])[0, met])
    return float(np.concatenate(found).mean())


@pytest.mark.parametrize("shared", [False, True], ids=["of two materials", "of one"])
def test_white_bodies_that_touch_lose_no_light(shared: bool) -> None:
    """Under an even sky a white body, alone or not, sends all light back; a surface in common makes no one body."""
    surface = mi.load_dict(WHITE) if shared else WHITE
    left, right = cube(-1.5, 1.5, surface), cube(1.5, 1.5, surface)
    alone = mi.load_dict({"type": "scene", "sky": SKY, "left": left})
    both = mi.load_dict({"type": "scene", "sky": SKY, "left": left, "right": right}, optimize=False)
    one, two = (seen_from_around(scene, method="walks", walks=4, seed=1) for scene in (alone, both))
    assert one == pytest.approx(1, abs=5e-3)
    assert two == pytest.approx(one, abs=3e-3)


def test_a_body_drawn_in_stays_closed_and_lies_inside() -> None:
    surface = surface_of(mi.load_dict({"type": "cube", "bsdf": WHITE}))
    inner = drawn_in(surface)
    assert is_closed(inner)
    assert np.all(np.abs(inner.vertices) < 1)
    np.testing.assert_allclose(inner.vertices, surface.vertices, atol=2e-3)
    np.testing.assert_allclose(np.abs(inner.vertices), np.abs(inner.vertices[0, 0]), rtol=1e-9)
