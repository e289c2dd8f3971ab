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
    leaving_annulus,
    plane,
    radiance,
    scene_of,
    towards_origin,
)

from bssrdf.render import paths, probes, sampling
from bssrdf.render.integrator import register
from bssrdf.render.variant import use_variant
from bssrdf.transport import dipole
from bssrdf.transport.fresnel import exit_norm, fresnel_t
from bssrdf.transport.materials import PublishedMaterial, load_materials
from bssrdf.transport.precision import scoped_x64

Floats = NDArray[np.float64]


pytestmark = pytest.mark.usefixtures("mitsuba_mono")


def test_profile_around_a_narrow_beam_is_dipole_plus_single_scattering() -> None:
    edges = np.array([0.2, 0.4, 0.8, 2.0, 5.0, 12.0])
    scene = scene_of(MARBLE, beam=beam(0.1))
    n = 1 << 18
    found = []
    for low, high in itertools.pairwise(edges.tolist()):
        rays = leaving_annulus(low, high, n, seed=3)
        found.append([math.pi * value[0] for value in radiance(scene, rays, n, terms="diffusion,single", max_depth=2)])
    values, errors = np.array(found).T
    expected = beam_reference(edges, 0.1)
    assert np.all(errors < 0.006 * expected)
    np.testing.assert_allclose(values, expected, rtol=0.01)


# Even light


@pytest.mark.parametrize("material", load_materials().values(), ids=lambda material: material.name)
def test_evenly_lit_slab_is_the_closed_form_of_its_terms(material: PublishedMaterial) -> None:
    use_variant("rgb")
    register()
    sigmas = {
        "sigma_a": {"type": "rgb", "value": list(material.sigma_a_per_mm)},
        "sigma_sp": {"type": "rgb", "value": list(material.sigma_sp_per_mm)},
    }
    n = 1 << 18
    value, error = radiance(scene_of(sigmas | {"eta": material.eta}, sky=SKY), towards_origin(n), n)
    expected = [even_light(material, channel, VIEW) for channel in range(3)]
    assert np.all(error < 0.006 * np.array(expected))
    np.testing.assert_allclose(value, expected, rtol=0.01)


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
    """Irradiance cos θ along the way of the view: R Ft²/(π C) cos θ of it comes back by diffusion."""
    away = [-math.sqrt(1 - VIEW * VIEW), 0, VIEW]
    lights = {
        "directional": {"type": "directional", "direction": [-x for x in away], "irradiance": 1.0},
        "point": {"type": "point", "position": [400 * x for x in away], "intensity": 400.0**2},
    }
    n = 1 << 16
    value, error = radiance(scene_of(MARBLE, light=lights[kind]), towards_origin(n), n, terms="diffusion")
    total = float(scoped_x64(dipole.total_r)(dipole.Medium(**MARBLE)))
    lobe = float(fresnel_t(MARBLE["eta"], VIEW)) ** 2 / (math.pi * float(exit_norm(MARBLE["eta"])))
    assert value[0] == pytest.approx(total * lobe * VIEW, abs=4 * error[0], rel=2e-3)


@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_furnace_of_a_medium_that_absorbs_nothing_gives_back_all_light(alpha: float) -> None:
    white = {"sigma_a": 0.0, "sigma_sp": 2.0, "eta": 1.4, "alpha": alpha}
    n = 1 << 17
    value, error = radiance(scene_of(white, sky=SKY), towards_origin(n), n, terms="diffusion,specular")
    assert value[0] == pytest.approx(1, abs=0.004 + 3 * error[0])


def test_paper_leaves_the_exit_lobe_without_its_norm() -> None:
    n = 1 << 14
    scene = scene_of(MARBLE, sun={"type": "directional", "direction": [0, 0, -1]})
    ours, paper = (
        radiance(scene, towards_origin(n), n, terms="diffusion", paper=paper, max_depth=2)[0][0]
        for paper in (False, True)
    )
    assert paper / ours == pytest.approx(float(exit_norm(MARBLE["eta"])), rel=1e-4)


def test_exponential_sampling_has_the_same_mean() -> None:
    n = 1 << 18
    scene = scene_of(MARBLE, sky=SKY)
    exact, exponential = (
        radiance(scene, towards_origin(n), n, terms="diffusion", sampling=law) for law in sampling.LAWS
    )
    assert abs(exact[0][0] - exponential[0][0]) < 4 * math.hypot(exact[1][0], exponential[1][0])


# Light sampling


def test_light_sampling_and_the_paths_own_directions_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    panel = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at([30, 0, 30], [0, 0, 0], [0, 1, 0]).scale([20, 20, 1]),
        "emitter": {"type": "area", "radiance": 1.0},
    }
    scene = scene_of({"sigma_a": 0.1, "sigma_sp": 1.0, "eta": 1.3, "alpha": 0.2}, panel=panel)
    n = 1 << 18
    for term in paths.TERMS:
        both, both_error = radiance(scene, towards_origin(n), n, terms=term)
        with monkeypatch.context() as without:
            without.setattr(paths.Tracer, "_direct", lambda *_: mi.Spectrum(0))
            without.setattr(paths.Tracer, "_light_pdf", lambda *_: mi.Float(0))
            alone, alone_error = radiance(scene, towards_origin(n), n, seed=1, terms=term)
        assert abs(both[0] - alone[0]) < 4 * math.hypot(both_error[0], alone_error[0]) + 2e-3 * both[0], term


def test_a_spots_rays_and_the_probes_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(MARBLE, spot=beam(3.0))
    n = 1 << 17
    both, error = radiance(scene, towards_origin(n), n, terms="diffusion", max_depth=2)
    monkeypatch.setattr("bssrdf.render.spots.SPOT", "none of them")
    alone, alone_error = radiance(scene, towards_origin(n), n, seed=1, terms="diffusion", max_depth=2)
    assert abs(both[0] - alone[0]) < 4 * math.hypot(error[0], alone_error[0])
    assert error[0] < alone_error[0]


def test_light_through_a_pane_without_refraction_is_the_same() -> None:
    """It can enter only by the path's own directions, through another surface."""
    pane = plane() | {
        "to_world": mi.ScalarTransform4f().translate([0, 0, 2]).scale([400, 400, 1]),
        "bsdf": {"type": "dielectric", "int_ior": 1.000001, "ext_ior": 1.0},
    }
    n = 1 << 16
    open_air, first = radiance(scene_of(MARBLE, sky=SKY), towards_origin(n), n)
    behind, second = radiance(scene_of(MARBLE, sky=SKY, pane=pane), towards_origin(n), n)
    assert abs(open_air[0] - behind[0]) < 4 * math.hypot(first[0], second[0])


# Limits and symmetries


@pytest.mark.parametrize("scale", [1e3, 1e6], ids=["short", "below single precision"])
def test_short_mean_free_path_is_the_brdf(scale: float) -> None:
    sun = {"type": "directional", "direction": [1, 0, -1]}
    scene = scene_of(MARBLE | {"scale": scale, "g": 0.3}, {"type": "sphere", "radius": 1.0}, sun=sun)
    n = 1 << 17
    for term in ("diffusion", "single"):
        far, far_error = radiance(scene, around(1.0, n), n, terms=term)
        local, local_error = radiance(scene, around(1.0, n), n, type="bssrdf_brdf", terms=term)
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
    assert np.all(np.abs(rgb - mono) < 4 * np.hypot(rgb_error, mono_error))


def test_diffusion_is_reciprocal_on_a_plane_and_on_a_sphere() -> None:
    source = sampling.dipole(mi.Spectrum(0.05), mi.Spectrum(1.0), mi.Float(2.0))
    rng = np.random.default_rng(5)
    n_i, n_o = (v / np.linalg.norm(v, axis=0) for v in rng.normal(size=(2, 3, 100)))
    sphere = [(2 * n_i, n_i, 2 * n_o, n_o)]
    up = np.broadcast_to([[0.0], [0.0], [1.0]], (3, 100))
    flat = [(n_i * [[1], [1], [0]], up, n_o * [[1], [1], [0]], up)]
    for x_i, normal_i, x_o, normal_o in sphere + flat:
        there = probes.rd_between(source, mi.Vector3f(x_i - x_o), mi.Normal3f(normal_i))
        back = probes.rd_between(source, mi.Vector3f(x_o - x_i), mi.Normal3f(normal_o))
        np.testing.assert_allclose(np.array(there), np.array(back), rtol=1e-4)


@pytest.mark.parametrize(
    "medium",
    [
        {"sigma_a": 0.0, "sigma_sp": 1.0, "eta": 1.3},
        {"sigma_a": 1e-6, "sigma_sp": 0.999999, "eta": 1.3, "g": 0.9},
        {"sigma_a": 1.0, "sigma_sp": 0.0, "eta": 1.0},
        {"sigma_a": 1e3, "sigma_sp": 1e-3, "eta": 2.0, "g": -0.9, "alpha": 0.5},
    ],
    ids=["no absorption", "albedo 0.999999", "no scattering", "black"],
)
@pytest.mark.parametrize("law", sampling.LAWS)
def test_hard_media_give_finite_pictures(medium: dict[str, Any], law: str) -> None:
    n = 1 << 12
    light = {"sky": SKY, "beam": beam(0.01)}
    for shape, rays in ((None, towards_origin(n, 1.0)), ({"type": "sphere"}, around(1.0, n))):
        value, _ = radiance(scene_of(medium, shape, **light), rays, n, sampling=law)
        assert np.isfinite(value[0])
        assert value[0] >= 0
