"""Media as a scene gives them: textures, seams, open shapes, and wrong properties named."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import mitsuba as mi
from mitsuba_scenes import MARBLE, SKY, around, radiance, scene_of, towards_origin

from bssrdf.render.points import prepare
from bssrdf.render.points.record import BodySurface
from bssrdf.render.surface import coefficients
from bssrdf.transport import dipole, scoped_x64, table_model

Floats = NDArray[np.float64]


pytestmark = pytest.mark.usefixtures("mitsuba_mono")


def test_a_flat_texture_is_the_number_in_it() -> None:
    def grey(value: float) -> dict[str, Any]:
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.full((2, 2, 1), value, np.float32)), "raw": True}

    n = 1 << 16
    ball_light = {"shape": {"type": "sphere", "radius": 4.0}, "sky": SKY}
    textured = {"sigma_a": grey(0.01), "sigma_sp": grey(1.0), "eta": 1.3}
    total = float(scoped_x64(table_model(1.3, 0.0).total)(dipole.Medium(0.01, 1.0, 1.3)))
    maps = {"reflectance": grey(total), "mean_free_path": grey(1 / 1.01), "eta": 1.3}
    plain, error = radiance(scene_of({"sigma_a": 0.01, "sigma_sp": 1.0, "eta": 1.3}, **ball_light), around(4.0, n), n)
    for other in (textured, maps):
        value, other_error = radiance(scene_of(other, **ball_light), around(4.0, n), n)
        assert abs(value[0] - plain[0]) < 4 * math.hypot(error[0], other_error[0])


@pytest.mark.parametrize(("shape", "warns"), [("rectangle", True), ("cube", False), ("sphere", False)])
def test_open_shapes_are_warned_about(shape: str, warns: bool) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        radiance(scene_of(MARBLE, {"type": shape}, sky=SKY), towards_origin(4), 4)
    assert any("is open" in str(warning.message) for warning in caught) == warns


@pytest.mark.parametrize(
    ("plugin", "says"),
    [
        ({"type": "bssrdf_medium", "sigma_a": 1.0, "sigma_sp": 1.0}, "eta is missing"),
        ({"type": "bssrdf_medium", "sigma_a": 1.0, "eta": 1.3}, "sigma_sp is missing"),
        ({"type": "bssrdf_medium", "sigma_a": -1.0, "sigma_sp": 1.0, "eta": 1.3}, "at least 0"),
        ({"type": "bssrdf_medium", "sigma_a": 0.0, "sigma_sp": 0.0, "eta": 1.3}, "the medium is empty"),
        ({"type": "bssrdf_medium", "sigma_a": 1.0, "sigma_sp": 1.0, "eta": 0.7}, "at least 1"),
        ({"type": "bssrdf_medium", "sigma_a": 1.0, "sigma_sp": 1.0, "eta": 1.3, "g": 1.0}, "between -1 and 1"),
        ({"type": "bssrdf", "kernel": "dipole", "terms": "diffusion,double"}, "some of diffusion, single, specular"),
        ({"type": "bssrdf", "terms": "specular"}, "with kernel dipole"),
        ({"type": "bssrdf", "kernel": "best"}, "table or dipole"),
        ({"type": "bssrdf", "method": "probes"}, "points or walks"),
        ({"type": "bssrdf", "max_depth": 0}, "above 0"),
    ],
)
def test_wrong_properties_are_named_with_what_to_give(plugin: dict[str, Any], says: str) -> None:
    with pytest.raises(Exception, match=says):
        mi.load_dict(plugin)


@pytest.mark.parametrize(("albedo", "eta", "g"), [(0.4, 1.3, 0.0), (0.97, 1.5, 0.0), (0.9, 1.3, 0.8)])
def test_a_reflectance_is_that_of_the_table(albedo: float, eta: float, g: float) -> None:
    total = float(scoped_x64(table_model(eta, g).total)(dipole.Medium(1 - albedo, albedo, eta)))
    made = mi.load_dict({"type": "bssrdf_medium", "reflectance": total, "mean_free_path": 2.0, "eta": eta, "g": g})
    np.testing.assert_allclose(coefficients(made.surface).ravel(), [(1 - albedo) / 2, albedo / 2], rtol=5e-3)


@pytest.mark.parametrize(
    ("medium", "options", "says"),
    [
        ({"sigma_a": 0.1, "sigma_sp": 1.0, "eta": 1.3, "g": -0.9}, {}, "eta 1.3 and g -0.9: no Monte Carlo table"),
        ({"reflectance": 0.5, "mean_free_path": 1.0, "eta": 1.3}, {"kernel": "dipole"}, "the dipole gives another"),
    ],
)
def test_what_a_medium_is_taken_for_is_told(medium: dict[str, Any], options: dict[str, str], says: str) -> None:
    with pytest.warns(UserWarning, match=says):
        radiance(scene_of(medium, {"type": "sphere"}, sky=SKY), around(1.0, 4), 4, **options)


def test_a_body_of_more_triangles_than_there_is_room_for_is_told() -> None:
    from bssrdf.render.points.spread import refine, surface_of

    ball = surface_of(mi.load_dict({"type": "sphere"}))
    with pytest.warns(UserWarning, match="ball: 9,[0-9]{3} triangles are all there is room for; edges are up to [34]"):
        coarse = refine(ball, lambda places, _: np.full(len(places), 0.02), 20_000, "ball")
    assert len(coarse.faces) < 20_000


def test_with_little_memory_a_picture_is_coarser_and_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prepare, "_free_bytes", lambda: 20_000_000)
    with pytest.warns(UserWarning, match="all there is room for"):
        value, _ = radiance(scene_of(MARBLE | {"scale": 100.0}, {"type": "sphere"}, sky=SKY), around(1.0, 64), 64)
    assert value[0] > 0.5


def test_straight_lines_between_vertices_hold_the_light_of_a_curve() -> None:
    """Of an exponential, whose triangles are 0.7 of its length wide."""
    x, y = (0.7 * each.ravel() for each in np.meshgrid(np.arange(40.0), np.arange(20.0), indexing="ij"))
    i, j = (each.ravel() for each in np.meshgrid(np.arange(39), np.arange(19), indexing="ij"))
    a = 20 * i + j
    faces = np.concatenate([np.stack([a, a + 20, a + 21], 1), np.stack([a, a + 21, a + 1], 1)])
    places = np.stack([x, y, 0 * x], axis=1)
    surface = BodySurface(places, np.tile([0.0, 0.0, 1.0], (800, 1)), np.zeros((800, 2)), faces)
    fall = np.exp(-x)[:, None]
    inner = faces[(places[faces][..., 1].min(axis=1) > 1) & (places[faces][..., 1].max(axis=1) < 12)]
    strip = inner[(places[inner][..., 0].min(axis=1) > 1) & (places[inner][..., 0].max(axis=1) < 20)]
    low, high = places[strip][..., 0].min(), places[strip][..., 0].max()
    known = (math.exp(-low) - math.exp(-high)) / (high - low)
    assert fall[strip].mean() > 1.035 * known
    assert prepare._between_vertices(surface, fall)[strip].mean() == pytest.approx(known, rel=4e-3)
