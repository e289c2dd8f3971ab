"""Lamps that polished bodies mirror onto bodies."""

from typing import Any

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")


@pytest.fixture(scope="module")
def corner() -> Any:
    """A polished wall that mirrors a lamp onto a polished floor, one body: the scene, its mesh and surface."""
    from bssrdf.render.integrator import register
    from bssrdf.render.medium import Media
    from bssrdf.render.points.prepare import _mesh, _rebuilt, _refined
    from bssrdf.render.points.record import LightPlan
    from bssrdf.render.scenes.place import box, panel
    from bssrdf.render.variant import use_variant

    use_variant()
    register()
    from bssrdf.render.plugins import _plain

    surface = {
        "type": "bssrdf_medium",
        "sigma_a": {"type": "rgb", "value": [0.01] * 3},
        "sigma_sp": {"type": "rgb", "value": [1.0] * 3},
        "eta": 1.5,
    }
    floor, wall = box((-10.0, -10.0, -1.0), (20.0, 20.0, 2.0)), box((-12.0, -10.0, -1.0), (2.0, 20.0, 18.0))
    lamp = panel((30.0, 0.0, 40.0), (0.0, 0.0, 0.0), (8.0, 8.0), 10.0)
    bodies = {name: _plain(shape) | {"bsdf": surface} for name, shape in (("floor", floor), ("wall", wall))}
    scene = mi.load_dict({"type": "scene", **bodies, "lamp": _plain(lamp)})
    media = Media(scene)
    surfaces = [_refined(scene, shape, media, None, LightPlan()) for shape in media.shapes]
    meshes = [_mesh(*pair) for pair in zip(media.shapes, surfaces, strict=True)]
    return _rebuilt(scene, media.shapes, meshes), meshes, surfaces


def test_lamps_followed_to_a_mirror_bring_what_paths_would_find_there_by_chance(corner: Any) -> None:
    from bssrdf.render.paths import Settings, Tracer
    from bssrdf.render.points.enter import Arrived, arrive
    from bssrdf.render.points.mirrored import mirrored

    scene, meshes, surfaces = corner
    by_chance, apart = Tracer(scene, Settings(local=True)), Tracer(scene, Settings(local=True, mirrors_apart=True))

    def total(each: list[Arrived]) -> Any:
        return sum(
            (surface.triangle_areas()[:, None, None] * arrived.fresnel).sum()
            for surface, arrived in zip(surfaces, each, strict=True)
        )

    def found(tracer: Any) -> Any:
        pairs = list(zip(meshes, surfaces, strict=True))
        return np.mean([total([arrive(tracer, *pair, 64, seed) for pair in pairs]) for seed in range(3)])

    known = found(by_chance)
    left_out = known - found(apart)
    assert left_out > 0.015 * known
    assert total(mirrored(apart, meshes, surfaces, 0)) == pytest.approx(left_out, rel=0.04)
