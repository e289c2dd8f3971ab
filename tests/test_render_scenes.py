"""Scenes in code: closed figures, media by name, what is wrong with a scene in one line, and the choice of a model."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

from bssrdf.errors import InputError, UsageError
from bssrdf.render.choose import DEEP, WIDE, choose_model, mc_refusal, mc_remarks, remarks, spread_mm
from bssrdf.render.head import head_distance, head_mesh
from bssrdf.render.material import HALF_ALBEDO, RenderMaterial, find_medium, medium_of_fit
from bssrdf.render.picture import load_stage
from bssrdf.render.plugins import RenderOptions
from bssrdf.render.scenes.catalogue import SCENES, build_scene
from bssrdf.render.scenes.lathe import ring, turned
from bssrdf.render.scenes.place import sky
from bssrdf.render.scenes.record import Body, Scene, Thing, Viewpoint
from bssrdf.render.surface_nets import TriangleMesh
from bssrdf.session.records import ChannelFit, Fit

MARBLE = find_medium("Marble")
HIGHEST = 0.9957
"""The top of the figure in its own units."""


@pytest.fixture(scope="module")
def figure() -> TriangleMesh:
    return head_mesh(100.0, cells=60)


def ball_of(material: RenderMaterial, radius_mm: float, *, footprint_mm: float = 0.1) -> Scene:
    camera = Viewpoint((0, -5 * radius_mm, 0), (0, 0, 0), width_mm=256 * footprint_mm)
    return Scene("ball", {"ball": Body({"type": "sphere"}, material, radius_mm)}, {}, camera)


def edges_of(mesh: TriangleMesh) -> np.ndarray:
    pairs = mesh.faces.astype(int)[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, counts = np.unique(np.sort(pairs, axis=1), axis=0, return_counts=True)
    return counts


def volume_of(mesh: TriangleMesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_the_figure_is_closed_and_its_normals_point_out(figure: TriangleMesh) -> None:
    assert np.all(edges_of(figure) % 2 == 0)
    assert volume_of(figure) > 0
    in_its_units = figure.vertices / figure.vertices[:, 2].max() * HIGHEST
    outside = in_its_units + 0.01 * figure.normals
    assert np.mean(head_distance(outside) > 0) > 0.99
    assert np.abs(head_distance(in_its_units)).max() < 0.2 / 60


def test_the_figure_is_as_tall_as_asked(figure: TriangleMesh) -> None:
    assert np.ptp(figure.vertices[:, 2]) == pytest.approx(100, rel=1e-9)


def test_a_turned_body_is_closed_and_has_the_volume_of_its_profile() -> None:
    angle = np.linspace(-np.pi / 2, np.pi / 2, 60)
    ball = turned(np.stack([2 * np.cos(angle), 2 * np.sin(angle)], axis=1), sides=120)
    assert np.all(edges_of(ball) == 2)
    assert volume_of(ball) == pytest.approx(4 / 3 * np.pi * 8, rel=3e-3)
    assert np.einsum("ij,ij->i", ball.normals, ball.vertices / 2).min() > 0.99


def test_a_turned_ring_is_closed_and_has_the_volume_of_its_profile() -> None:
    square = np.array([[3.0, -1.0], [4.0, -1.0], [4.0, 1.0], [3.0, 1.0]])
    tube = ring(square, sides=200)
    assert np.all(edges_of(tube) == 2)
    assert volume_of(tube) == pytest.approx(np.pi * (16 - 9) * 2, rel=1e-3)


def test_milk_and_glass_touch_nowhere() -> None:
    scene = build_scene("milk")
    bodies = [body.shape for body in scene.bodies.values() if isinstance(body.shape, TriangleMesh)]
    things = [thing.mesh for thing in scene.furniture.values() if isinstance(thing, Thing)]
    spans = sorted((mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()) for mesh in bodies + things)
    assert len(spans) == 3
    assert all(below < above for (_, below), (above, _) in itertools.pairwise(spans))


@pytest.mark.parametrize("name", ["bust", "face"])
def test_a_mesh_stands_on_the_table_wherever_its_file_puts_it(name: str, figure: TriangleMesh) -> None:
    moved = figure._replace(vertices=np.add(figure.vertices, (300.0, -20.0, -55.0)))
    here, there = (build_scene(name, own={"mesh": mesh}) for mesh in (figure, moved))
    stood = there.bodies[name].shape
    assert isinstance(stood, TriangleMesh)
    assert stood.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(stood.vertices, here.bodies[name].shape.vertices, atol=1e-9)
    assert there.camera.origin == pytest.approx(here.camera.origin)


def test_a_published_name_gives_its_coefficients() -> None:
    skin = find_medium("skin1", g=0.85)
    assert skin.sigma_a == (0.032, 0.17, 0.48)
    np.testing.assert_allclose(skin.sigma_s, np.divide((0.74, 0.88, 1.01), 0.15))


def test_the_hard_case_has_albedo_one_half_at_the_mean_free_path_of_marble() -> None:
    half = find_medium(HALF_ALBEDO)
    np.testing.assert_allclose(half.albedo, 0.5)
    np.testing.assert_allclose(half.mean_free_path, MARBLE.mean_free_path)


def test_an_unknown_material_is_one_line_with_the_nearest_names() -> None:
    with pytest.raises(InputError, match=r'^material "marbel" is not in .* Marble, .*fit\.json$'):
        find_medium("marbel")


def fit_of(channels: str = "RGB", status: str = "converged") -> Fit:
    def channel(sigma_a: float) -> ChannelFit:
        nan = float("nan")
        return ChannelFit(
            model="mc",
            sigma_a_per_mm=sigma_a,
            sigma_a_sd_per_mm=nan,
            sigma_a_interval95_per_mm=(nan, nan),
            sigma_sp_per_mm=1.0,
            sigma_sp_sd_per_mm=nan,
            sigma_sp_interval95_per_mm=(nan, nan),
            correlation=nan,
            total_r_measured=nan,
            total_r_model=nan,
            window_mm=(0, 1),
            n=9,
            chi2_reduced=nan,
            status=status,  # type: ignore[arg-type]
        )

    found = {name: channel(0.1 * number) for number, name in enumerate(channels)}
    return Fit("0", "wax.csv", "", {}, "wax", 1.4, 0.3, found)


def test_a_fit_is_a_material_in_red_green_and_blue() -> None:
    wax = medium_of_fit(fit_of())
    assert (wax.name, wax.eta, wax.g) == ("wax", 1.4, 0.3)
    assert wax.sigma_a == pytest.approx((0, 0.1, 0.2))


@pytest.mark.parametrize(("fit", "fault"), [(fit_of("RG"), "lacks the channel B"), (fit_of(status="failed"), "failed")])
def test_a_fit_that_cannot_colour_a_picture_is_refused(fit: Fit, fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        medium_of_fit(fit)


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_has_light_bodies_of_finite_size_and_no_remark(name: str) -> None:
    scene = build_scene(name, width_px=32)
    assert scene.lights
    assert scene.camera.pixels[0] == 32
    assert all(0 < body.size_mm < 1000 for body in scene.bodies.values())
    assert remarks(scene) == []


def test_coefficients_in_the_wrong_unit_are_remarked() -> None:
    per_m = dataclasses.replace(MARBLE, sigma_a=(2.1e-6,) * 3, sigma_sp=(2e-3,) * 3)
    (line,) = remarks(ball_of(per_m, 20))
    assert "1/mm" in line
    assert "20 mm" in line


def test_options_of_another_scene_are_refused() -> None:
    with pytest.raises(UsageError, match="block takes no light; slab does"):
        build_scene("block", own={"light": "sky"})
    with pytest.raises(UsageError, match='no scene "bunny"'):
        build_scene("bunny")


def test_a_missing_texture_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such texture"):
        build_scene("texture", own={"texture_path": tmp_path / "none.png"})


def test_a_light_spreads_by_its_diffuse_mean_free_path_and_without_absorption_by_the_radius_that_holds_it() -> None:
    assert spread_mm(MARBLE)[2] == pytest.approx(MARBLE.diffuse_mean_free_path[2])
    white = find_medium("Spectralon")
    assert max(white.diffuse_mean_free_path) == np.inf
    assert 10 * white.mean_free_path[0] < spread_mm(white)[0] < 50 * white.mean_free_path[0]


def test_auto_takes_the_brdf_where_light_spreads_less_than_a_pixel() -> None:
    spread = max(spread_mm(MARBLE))
    assert choose_model(ball_of(MARBLE, 100 * spread, footprint_mm=0.9 * spread))[0] == "bssrdf"
    assert choose_model(ball_of(MARBLE, 100 * spread, footprint_mm=1.1 * spread))[0] == "brdf"


def test_what_volpath_does_not_find_is_refused() -> None:
    assert mc_refusal(build_scene("block"))
    assert mc_refusal(build_scene("block", roughness=0.3)) is None


def test_mc_says_that_it_loses_light_on_rough_bodies_alone() -> None:
    assert mc_remarks(build_scene("bust")) == []
    (said,) = mc_remarks(build_scene("face"))
    assert "loses light" in said


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize(("share", "method"), [(0.9, "walks"), (1.1, "points")])
@pytest.mark.parametrize("material", ["Marble", "Skin1"])
def test_auto_walks_in_bodies_that_are_small_against_light_s_ways(material: str, share: float, method: str) -> None:
    medium = find_medium(material)
    radius = share * max(WIDE * max(spread_mm(medium)), DEEP * max(medium.mean_free_path))
    scene = ball_of(medium, radius)
    ball = dataclasses.replace(scene.bodies["ball"], shape={"type": "sphere", "radius": radius})
    lit = dataclasses.replace(scene, bodies={"ball": ball}, lights={"sky": sky(1.0)})
    assert load_stage(lit, RenderOptions("bssrdf")).chosen.startswith(method)


def test_a_mesh_in_micrometres_is_remarked() -> None:
    (line,) = remarks(ball_of(MARBLE, 20_000))
    assert "20 m large" in line
