"""Light that goes from body to body, and between bodies that touch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import mitsuba as mi
from mitsuba_scenes import SKY, prepared, sampler

from bssrdf.render.material import find_medium
from bssrdf.render.picture import load_stage, render_pass
from bssrdf.render.plugins import RenderOptions
from bssrdf.render.points import prepare
from bssrdf.render.points.exchange import drawn_in
from bssrdf.render.points.spread import is_closed, surface_of
from bssrdf.render.scenes.figures import bust

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


def test_what_a_body_sees_of_itself_is_found_in_one_round_as_in_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bust sees a tenth of itself: lit as by a flat body it is too dark in a skin's red, which spreads far."""
    scene = bust(find_medium("Skin1"))
    scene = replace(scene, camera=replace(scene.camera, pixels=(32, 32)), furniture={})
    found = {}
    for rounds in ("none", "one", "many"):
        monkeypatch.setattr(prepare, "rounds_for", lambda *_, rounds=rounds: rounds)
        stage = load_stage(scene, RenderOptions("bssrdf", method="walks", walks=4, seed=1))
        found[rounds] = np.asarray(render_pass(stage, 16, 1)).mean(axis=(0, 1))
    np.testing.assert_allclose(found["one"], found["many"], rtol=0.004)
    assert found["none"][0] < 0.99 * found["many"][0]
