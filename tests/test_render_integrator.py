"""The BSSRDF in Mitsuba against closed forms and the literal models of transport/."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import mitsuba as mi
from mitsuba_scenes import (
    MARBLE,
    SKY,
    VIEW,
    around,
    beam,
    beam_reference,
    even_light,
    even_terms,
    leaving_annulus,
    plane,
    prepared,
    radiance,
    sampler,
    scene_of,
    towards_origin,
    towards_square,
)
from mitsuba_scenes import (
    seen as seen_by,
)

from bssrdf.render import paths
from bssrdf.render.integrator import register
from bssrdf.render.variant import use_variant
from bssrdf.transport import dipole, table_model
from bssrdf.transport.fresnel import exit_norm, fresnel_t
from bssrdf.transport.materials import PublishedMaterial, load_materials
from bssrdf.transport.precision import scoped_x64

Floats = NDArray[np.float64]


pytestmark = pytest.mark.usefixtures("mitsuba_mono")


@pytest.mark.parametrize(
    "medium",
    [MARBLE, {"sigma_a": 0.17, "sigma_sp": 0.88, "eta": 1.3}, {"sigma_a": 0.061, "sigma_sp": 0.18, "eta": 1.3}],
    ids=["marble", "skin", "ketchup"],
)
def test_profile_around_a_narrow_beam_is_that_of_the_table(medium: dict[str, float]) -> None:
    """To five times 1/σtr, where a thousandth of the light is left."""
    sigma_a, sigma_sp = medium["sigma_a"], medium["sigma_sp"]
    far = 5 / math.sqrt(3 * sigma_a * (sigma_a + sigma_sp))
    edges = np.array([0.4, *np.geomspace(0.8, far, 6)])
    scene = scene_of(medium, beam=beam(0.25))
    n = 1 << 17
    found = []
    integrator = prepared(scene, view=far)
    for low, high in itertools.pairwise(edges.tolist()):
        rays = leaving_annulus(low, high, n, seed=3)
        found.append([math.pi * value[0] for value in seen_by(integrator, scene, rays, n)])
    values, errors = np.array(found).T
    expected = beam_reference(edges, 0.25, medium)
    assert np.all(errors < 0.006 * expected)
    np.testing.assert_allclose(values, expected, rtol=0.02)


# Even light


MARBLE_HALF = PublishedMaterial("Marble-half", (1.31, 1.1, 1.5), (1.31, 1.1, 1.5), (0.0,) * 3, 1.5)


@pytest.mark.parametrize("material", [*load_materials().values(), MARBLE_HALF], ids=lambda material: material.name)
def test_evenly_lit_slab_is_the_closed_form_of_the_table(material: PublishedMaterial) -> None:
    use_variant("rgb")
    register()
    sigmas = {
        "sigma_a": {"type": "rgb", "value": list(material.sigma_a_per_mm)},
        "sigma_sp": {"type": "rgb", "value": list(material.sigma_sp_per_mm)},
    }
    n = 1 << 14
    scene = scene_of(sigmas | {"eta": material.eta}, plane(2000), sky=SKY)
    values = [seen_by(prepared(scene, seed=seed), scene, towards_square(0.8, n), n)[0] for seed in (0, 1, 2)]
    expected = [even_light(material, channel, VIEW) for channel in range(3)]
    np.testing.assert_allclose(np.mean(values, axis=0), expected, rtol=0.005)  # of one seed 0.5 % of noise


def sky_emitters() -> dict[str, dict[str, Any]]:
    """Radiance 1 from everywhere above, by emitters of several kinds."""
    dome = {"type": "sphere", "radius": 400.0, "flip_normals": True, "emitter": {"type": "area", "radiance": 1.0}}
    image = {"type": "envmap", "bitmap": mi.Bitmap(np.ones((8, 16, 3), np.float32))}
    return {"constant": SKY, "image": image, "dome": dome}


@pytest.mark.parametrize("kind", ["constant", "image", "dome"])
def test_light_of_any_kind_enters_alike(kind: str) -> None:
    n = 1 << 16
    value, error = radiance(scene_of(MARBLE, light=sky_emitters()[kind]), towards_origin(n), n)
    marble = PublishedMaterial("", (MARBLE["sigma_sp"],) * 3, (MARBLE["sigma_a"],) * 3, (0.0,) * 3, MARBLE["eta"])
    assert abs(value[0] - even_light(marble, 0, VIEW)) < 4 * error[0] + 0.003


@pytest.mark.parametrize("kind", ["point", "directional"])
def test_light_from_one_direction_enters_as_the_lobes_say(kind: str) -> None:
    """Irradiance cos θ along the way of the view: both lobes of the table, R and cos θ of it come back scattered."""
    away = [-math.sqrt(1 - VIEW * VIEW), 0, VIEW]
    lights = {
        "directional": {"type": "directional", "direction": [-x for x in away], "irradiance": 1.0},
        "point": {"type": "point", "position": [400 * x for x in away], "intensity": 400.0**2},
    }
    n = 1 << 12
    value, _ = radiance(scene_of(MARBLE, light=lights[kind]), towards_origin(n), n)
    medium, model = dipole.Medium(**MARBLE), table_model(MARBLE["eta"], 0.0)
    total = float(scoped_x64(model.total)(medium))
    towards, ahead = (float(scoped_x64(model.total_radiance_factor)(medium, mu)) for mu in (VIEW, 1.0))
    expected = total * towards / math.pi * towards / ahead * float(fresnel_t(MARBLE["eta"], 1.0)) * VIEW
    assert value[0] == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_furnace_of_a_medium_that_absorbs_nothing_gives_back_all_light(alpha: float) -> None:
    white = {"sigma_a": 0.0, "sigma_sp": 2.0, "eta": 1.4, "alpha": alpha}
    n = 1 << 14
    value, error = radiance(scene_of(white, plane(2000), sky=SKY), towards_origin(n), n, light_samples=200)
    assert value[0] == pytest.approx(1, abs=0.004 + 3 * error[0])


def test_the_dipoles_terms_are_the_closed_form_of_the_paper() -> None:
    n = 1 << 16
    marble = PublishedMaterial("", (MARBLE["sigma_sp"],) * 3, (MARBLE["sigma_a"],) * 3, (0.0,) * 3, MARBLE["eta"])
    value, error = radiance(scene_of(MARBLE, sky=SKY), towards_origin(n), n, kernel="dipole")
    assert value[0] == pytest.approx(even_terms(marble, 0, VIEW), rel=4e-3, abs=3 * error[0])


def test_paper_leaves_the_exit_lobe_without_its_norm() -> None:
    n = 1 << 14
    scene = scene_of(MARBLE, sun={"type": "directional", "direction": [0, 0, -1]})
    ours, paper = (
        radiance(scene, towards_origin(n), n, kernel="dipole", terms="diffusion", paper=paper, max_depth=2)[0][0]
        for paper in (False, True)
    )
    assert paper / ours == pytest.approx(float(exit_norm(MARBLE["eta"])), rel=1e-4)


@pytest.mark.parametrize(("bright", "dark"), [(0.01, 0.2), (0.002, 0.05)])
def test_each_half_of_a_two_tone_surface_gives_back_its_own_total(bright: float, dark: float) -> None:
    """Of light that enters along the normal, with R_d of the medium under the place where it leaves."""
    tones = np.repeat(np.float32([bright, dark]), 32).reshape(1, 64, 1)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(tones.repeat(2, axis=0)), "raw": True, "filter_type": "nearest"}
    sun = {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0}
    scene = scene_of({"sigma_a": texture, "sigma_sp": 1.0, "eta": 1.3}, plane(60.0), sun=sun)
    integrator, n = prepared(scene, view=40.0), 1 << 16
    for side, sigma_a in ((-1, bright), (1, dark)):
        numbers = sampler(n, 3)
        place, out = numbers.next_2d(), mi.warp.square_to_cosine_hemisphere(numbers.next_2d())
        ray = mi.Ray3f(mi.Point3f(side * 20 * place.x, 30 * place.y - 15, 0) + 0.01 * out, -out)
        value, _ = seen_by(integrator, scene, ray, n)
        total = float(scoped_x64(table_model(1.3, 0.0).total)(dipole.Medium(sigma_a, 1.0, 1.3)))
        assert math.pi * value[0] == pytest.approx(total * float(fresnel_t(1.3, 1.0)), rel=0.01)


# Light sampling


@pytest.mark.parametrize("lamps", [1, 2, paths.MOST_LAMPS + 2])
def test_light_sampling_and_the_paths_own_directions_agree(lamps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    panels = {
        f"panel{i}": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().look_at([30 * x, 30 * y, 30], [0, 0, 0], [0, 0, 1]).scale([8, 8, 1]),
            "emitter": {"type": "area", "radiance": 1.0 + i},
        }
        for i, (x, y) in enumerate((math.cos(2 * i), math.sin(2 * i)) for i in range(lamps))
    }
    scene = scene_of({"sigma_a": 0.1, "sigma_sp": 1.0, "eta": 1.3, "alpha": 0.2}, **panels)
    n = 1 << 16
    for term in ("single", "specular"):
        both, both_error = radiance(scene, towards_origin(n), n, kernel="dipole", terms=term)
        with monkeypatch.context() as without:
            without.setattr(paths.Tracer, "_direct", lambda *_: mi.Spectrum(0))
            without.setattr(paths.Tracer, "_light_pdf", lambda *_: mi.Float(0))
            alone, alone_error = radiance(scene, towards_origin(n), n, seed=1, kernel="dipole", terms=term)
        assert abs(both[0] - alone[0]) < 4 * math.hypot(both_error[0], alone_error[0]) + 2e-3 * both[0], term


def test_light_through_a_pane_without_refraction_is_the_same() -> None:
    """It can enter only by the path's own directions, through another surface."""
    pane = plane() | {
        "to_world": mi.ScalarTransform4f().translate([0, 0, 2]).scale([400, 400, 1]),
        "bsdf": {"type": "dielectric", "int_ior": 1.000001, "ext_ior": 1.0},
    }
    n = 1 << 16
    open_air, first = radiance(scene_of(MARBLE, sky=SKY), towards_origin(n), n)
    behind, second = radiance(scene_of(MARBLE, sky=SKY, pane=pane), towards_origin(n), n)
    assert abs(open_air[0] - behind[0]) < 4 * math.hypot(first[0], second[0]) + 4e-3


# Limits and symmetries


@pytest.mark.parametrize("scale", [1e3, 1e6], ids=["short", "below single precision"])
@pytest.mark.parametrize("kernel", ["table", "dipole"])
def test_short_mean_free_path_is_the_brdf(scale: float, kernel: str) -> None:
    sun = {"type": "directional", "direction": [1, 0, -1]}
    scene = scene_of(MARBLE | {"scale": scale, "g": 0.3}, {"type": "sphere", "radius": 1.0}, sun=sun)
    n = 1 << 17
    far, far_error = radiance(scene, around(1.0, n), n, kernel=kernel)
    local, local_error = radiance(scene, around(1.0, n), n, type="bssrdf_brdf", kernel=kernel)
    assert abs(far[0] - local[0]) < 0.01 * local[0] + 4 * math.hypot(far_error[0], local_error[0])


def test_three_mono_renders_are_one_rgb() -> None:
    marble = load_materials()["Marble"]
    sphere = {"type": "sphere", "radius": 4.0}
    n = 1 << 17
    mono, mono_error = [], []
    for channel in range(3):
        medium = {"sigma_a": marble.sigma_a_per_mm[channel], "sigma_sp": marble.sigma_sp_per_mm[channel], "eta": 1.5}
        value, error = radiance(scene_of(medium, sphere, sky=SKY), around(4.0, n), n)
        mono.append(value[0])
        mono_error.append(error[0])
    use_variant("rgb")
    register()
    colours = {
        "sigma_a": {"type": "rgb", "value": list(marble.sigma_a_per_mm)},
        "sigma_sp": {"type": "rgb", "value": list(marble.sigma_sp_per_mm)},
    }
    rgb, rgb_error = radiance(scene_of(colours | {"eta": 1.5}, sphere, sky=SKY), around(4.0, n), n)
    assert np.all(np.abs(rgb - mono) < 4 * np.hypot(rgb_error, mono_error) + 2e-3 * rgb)


def test_light_and_view_can_change_places() -> None:
    """A lamp's light seen along one direction is that of a lamp there seen along the other, for equal irradiance."""
    found = []
    n = 1 << 12
    for seen, lit in ((0.9, 0.4), (0.4, 0.9)):
        away = [-math.sqrt(1 - lit * lit), 0, lit]
        sun = {"type": "directional", "direction": [-x for x in away], "irradiance": 1 / lit}
        found.append(radiance(scene_of(MARBLE, sun=sun), towards_origin(n, seen), n)[0][0])
    assert found[0] == pytest.approx(found[1], rel=3e-3)


@pytest.mark.parametrize(
    ("kernel", "medium"),
    [
        ("table", {"sigma_a": 0.0, "sigma_sp": 1.0, "eta": 1.3}),
        ("table", {"sigma_a": 1e-6, "sigma_sp": 0.999999, "eta": 1.3, "g": 0.9}),
        ("table", {"sigma_a": 1.0, "sigma_sp": 0.0, "eta": 1.0}),
        ("table", {"sigma_a": 1e3, "sigma_sp": 1e-3, "eta": 2.0, "g": -0.9, "alpha": 0.5}),
        ("dipole", {"sigma_a": 0.0, "sigma_sp": 1.0, "eta": 1.3}),
        ("dipole", {"sigma_a": 1e3, "sigma_sp": 0.0, "eta": 2.0, "g": -0.9, "alpha": 0.5}),
    ],
    ids=["white", "albedo 0.999999", "no scattering", "black", "white, dipole", "black, dipole"],
)
def test_hard_media_give_finite_pictures(kernel: str, medium: dict[str, Any]) -> None:
    n = 1 << 12
    light = {"sky": SKY, "beam": beam(0.1)}
    for shape, rays in ((plane(5.0), towards_origin(n, 1.0)), ({"type": "sphere"}, around(1.0, n))):
        value, _ = radiance(scene_of(medium, shape, **light), rays, n, view=8.0, kernel=kernel)
        assert np.isfinite(value[0])
        assert value[0] >= 0
