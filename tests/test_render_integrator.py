"""The BSSRDF in Mitsuba against closed forms, the literal models of transport/ and our own Monte Carlo."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import drjit as dr
import mitsuba as mi

from bssrdf.render import paths, probes, sampling
from bssrdf.render.integrator import register
from bssrdf.render.medium import Media
from bssrdf.render.variant import ADVICE, find_backend, use_variant
from bssrdf.transport import dipole, single
from bssrdf.transport.engine import MonteCarloMedium, simulate
from bssrdf.transport.fresnel import exit_norm, fresnel_t
from bssrdf.transport.materials import PublishedMaterial, load_materials
from bssrdf.transport.precision import scoped_x64

Floats = NDArray[np.float64]

MARBLE = {"sigma_a": 0.0041, "sigma_sp": 2.62, "eta": 1.5}
SKY = {"type": "constant"}
VIEW = 0.8
"""Cosine of the viewing angle."""


@pytest.fixture(autouse=True)
def _mono() -> Iterator[None]:
    if find_backend() is None:
        pytest.skip(ADVICE)
    use_variant("mono")
    register()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "shape .* is open", UserWarning)
        yield


def plane(half: float = 500.0) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale([half, half, 1])}


def scene_of(medium: dict[str, Any], shape: dict[str, Any] | None = None, **others: Any) -> Any:
    body = (shape or plane()) | {"bsdf": {"type": "bssrdf_medium", **medium}}
    return mi.load_dict({"type": "scene", "body": body, **others})


def sampler(n: int, seed: int) -> Any:
    made = mi.load_dict({"type": "independent"})
    made.seed(seed, n)
    return made


def radiance(scene: Any, ray: Any, n: int, seed: int = 0, **options: Any) -> tuple[Floats, Floats]:
    """Mean over n samples of the rays, and its standard error, by channel."""
    integrator = mi.load_dict({"type": "bssrdf", **options})
    value, _, _ = integrator.sample(scene, sampler(n, seed), ray)
    values = np.array(value, np.float64)
    return values.mean(axis=1), values.std(axis=1) / math.sqrt(n)


def towards_origin(n: int, mu: float = VIEW) -> Any:
    direction = mi.Vector3f(math.sqrt(1 - mu * mu), 0, -mu)
    return mi.Ray3f(dr.zeros(mi.Point3f, n) - 5 * direction, direction)


def around(scene_radius: float, n: int, seed: int = 9) -> Any:
    """Parallel rays through the disk of that radius about the origin."""
    place = mi.warp.square_to_uniform_disk(sampler(n, seed).next_2d()) * (0.9 * scene_radius)
    return mi.Ray3f(mi.Point3f(place.x, place.y, 4 * scene_radius), mi.Vector3f(0, 0, -1))


def leaving_annulus(r_lo: float, r_hi: float, n: int, seed: int) -> Any:
    """Rays onto the plane z = 0 whose mean radiance, times π, is the exitance of the annulus."""
    numbers = sampler(n, seed)
    low, high = dr.opaque(mi.Float, r_lo), dr.opaque(mi.Float, r_hi)
    radius = dr.sqrt(dr.lerp(low * low, high * high, numbers.next_1d()))
    sin_phi, cos_phi = dr.sincos(2 * math.pi * numbers.next_1d())
    direction = mi.warp.square_to_cosine_hemisphere(numbers.next_2d())
    return mi.Ray3f(mi.Point3f(radius * cos_phi, radius * sin_phi, 0) + 0.01 * direction, -direction)


def beam(radius: float) -> dict[str, Any]:
    """One unit of flux within `radius` of the origin, along the normal."""
    distance = 80 * radius
    angle = math.degrees(math.atan(radius / distance))
    return {
        "type": "spot",
        "to_world": mi.ScalarTransform4f().look_at([0, 0, distance], [0, 0, 0], [0, 1, 0]),
        "intensity": (distance / radius) ** 2 / math.pi,
        "cutoff_angle": angle,
        "beam_width": 0.9999 * angle,
    }


def even_single(sigma_a: float, sigma_sp: float, g: float, eta: float, mu: float) -> float:
    """Radiance by single scattering of a plane under light of radiance 1 from everywhere."""
    nodes, weights = np.polynomial.legendre.leggauss(48)
    u = (1 + nodes) / 2
    cos_i, phi = np.meshgrid(u * u, (np.arange(48) + 0.5) * math.tau / 48, indexing="ij")
    sin_i = np.sqrt(1 - cos_i**2)
    w_i = np.stack([sin_i * np.cos(phi), sin_i * np.sin(phi), cos_i], axis=-1)
    w_o = np.broadcast_to([-math.sqrt(1 - mu * mu), 0, mu], w_i.shape)
    value = scoped_x64(single.outgoing_radiance)(sigma_sp / (1 - g), sigma_a, g, eta, w_i, w_o)
    return float(math.tau * np.sum((np.asarray(value) * cos_i).mean(axis=1) * u * weights))


def even_light(material: PublishedMaterial, channel: int, mu: float) -> float:
    """Closed form of all terms under light of radiance 1 from everywhere."""
    sigma_a, sigma_sp = material.sigma_a_per_mm[channel], material.sigma_sp_per_mm[channel]
    transmitted = float(fresnel_t(material.eta, mu))
    diffuse = float(dipole.total_r(dipole.Medium(sigma_a, sigma_sp, material.eta)))
    return 1 - transmitted + transmitted * diffuse + even_single(sigma_a, sigma_sp, 0.0, material.eta, mu)


# A slab with a narrow beam


def across_spot(r_lo: float, r_hi: float, spot: float, log2_n: int = 17) -> Floats:
    """Distances between points of an annulus and points of an evenly lit disk in its middle."""
    u = stats.qmc.Sobol(3, seed=0).random_base2(log2_n).T
    r, offset = np.sqrt(r_lo**2 + (r_hi**2 - r_lo**2) * u[0]), spot * np.sqrt(u[1])
    return np.hypot(r - offset * np.cos(math.tau * u[2]), offset * np.sin(math.tau * u[2]))


def beam_reference(edges: Floats, spot: float) -> Floats:
    """Dipole plus single scattering, of the flux that entered, spread over the spot; mean over each annulus."""
    medium = dipole.Medium(**MARBLE)
    grid = np.geomspace(1e-3, 40, 2000)
    first = scoped_x64(single.first_order_rd)(MARBLE["sigma_sp"], MARBLE["sigma_a"], 0.0, MARBLE["eta"], grid)
    profile = np.asarray(scoped_x64(dipole.rd)(medium, grid)) + np.asarray(first)
    means = [
        np.exp(np.interp(np.log(across_spot(low, high, spot)), np.log(grid), np.log(profile))).mean()
        for low, high in itertools.pairwise(edges)
    ]
    return float(fresnel_t(MARBLE["eta"], 1.0)) * np.array(means)


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


# The probes' density


def torus(wide: float = 3.0, thin: float = 1.0, n: int = 96) -> tuple[Floats, NDArray[np.uint32]]:
    a, b = np.meshgrid(*[np.arange(n) * math.tau / n] * 2, indexing="ij")
    ring = wide + thin * np.cos(b)
    corners = np.stack([ring * np.cos(a), ring * np.sin(a), thin * np.sin(b)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    here, up, right, both = (((i + p) % n) * n + (j + q) % n for p, q in ((0, 0), (0, 1), (1, 0), (1, 1)))
    faces = np.concatenate([np.stack([here, right, both], -1), np.stack([here, both, up], -1)]).reshape(-1, 3)
    return corners, faces.astype(np.uint32)


def as_mesh(corners: Floats, faces: NDArray[np.uint32], bsdf: dict[str, Any]) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh("made", len(corners), len(faces), props=properties)
    held = mi.traverse(mesh)
    held["vertex_positions"] = mi.Float(corners.ravel().astype(np.float32))
    held["faces"] = mi.UInt32(faces.ravel())
    held.update()
    return mesh


def ball(radius: float = 2.0, n: int = 96) -> tuple[Floats, NDArray[np.uint32]]:
    """A cube's faces in a grid, blown up to a sphere."""
    u, v = np.meshgrid(*[np.tan(np.linspace(-math.pi / 4, math.pi / 4, n + 1))] * 2, indexing="ij")
    one = np.ones_like(u)
    sides = [np.stack(s, -1) for s in ((u, v, one), (v, u, -one), (one, u, v), (-one, v, u), (v, one, u), (u, -one, v))]
    corners = np.concatenate([s.reshape(-1, 3) for s in sides])
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    here = i * (n + 1) + j
    quad = np.concatenate(
        [np.stack([here, here + n + 1, here + n + 2], -1), np.stack([here, here + n + 2, here + 1], -1)]
    )
    faces = np.concatenate([quad.reshape(-1, 3) + k * (n + 1) ** 2 for k in range(6)])
    return radius * corners / np.linalg.norm(corners, axis=1, keepdims=True), faces.astype(np.uint32)


def sheet(half: float = 12.0, n: int = 240) -> tuple[Floats, NDArray[np.uint32]]:
    x, y = np.meshgrid(*[np.linspace(-half, half, n + 1)] * 2, indexing="ij")
    here = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate(
        [np.stack([here, here + n + 1, here + n + 2], 1), np.stack([here, here + n + 2, here + 1], 1)]
    )
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1), faces.astype(np.uint32)


SURFACES = {"plane": (sheet, (0.03, 0.02)), "sphere": (ball, (0.4, 0.3)), "torus": (torus, (2.5, 0.2))}


@pytest.mark.parametrize("surface", SURFACES)
def test_probes_density_is_one_over_the_surface_for_each_hit(surface: str) -> None:
    """∫ density dA is the number of hits to expect: over the plane one for each probe along the normal."""
    make, (x, y) = SURFACES[surface]
    medium = {"type": "bssrdf_medium", "sigma_a": 0.5, "sigma_sp": 1.5, "eta": 1.3}
    corners, faces = make()
    scene = mi.load_dict({"type": "scene", "body": as_mesh(corners, faces, medium)})
    n = 1 << 17
    si = scene.ray_intersect(mi.Ray3f(dr.zeros(mi.Point3f, n) + mi.Point3f(x, y, 20), mi.Vector3f(0, 0, -1)))
    media = Media(scene)
    row, found = media.row(si, si.is_valid())
    side = dr.select(si.n.z < 0, mi.Float(-1), mi.Float(1))
    source = media.optics(si, row, found).dipole()
    body = probes.LitPoint(si, mi.Frame3f(mi.Vector3f(si.n * side)), side, source, mi.Spectrum(1))
    entry = probes.find_entry(scene, sampler(n, 4), body, "exact", 8, found)
    hits = np.array(dr.select(entry.found, entry.weight * entry.density, 0), np.float64)

    one = dr.gather(type(source), source, mi.UInt32(0))
    point = dr.gather(type(si), si, mi.UInt32(0))
    body = probes.LitPoint(point, mi.Frame3f(mi.Vector3f(point.n * side[0])), mi.Float(side[0]), one, mi.Spectrum(1))
    tips = corners[faces]
    across = np.cross(tips[:, 1] - tips[:, 0], tips[:, 2] - tips[:, 0]) / 2
    area = np.linalg.norm(across, axis=1)
    total = 0.0
    shares = np.random.default_rng(1).dirichlet([1, 1, 1], (8, len(faces)))
    for share in shares:
        offset = np.einsum("fk,fkx->xf", share, tips) - np.array(point.p).reshape(3, 1)
        density = probes.entry_density(body, mi.Vector3f(offset), mi.Normal3f((across / area[:, None]).T), "exact")
        within = np.linalg.norm(offset, axis=0) < float(np.array(body.reach())[0])
        total += float(np.sum(np.array(density) * area * within)) / len(shares)
    assert total == pytest.approx(hits.mean(), rel=0.012, abs=4 * hits.std() / math.sqrt(n))
    if surface == "plane":
        assert total == pytest.approx(probes.AXIS_SHARES[0], rel=0.012)


# Full Monte Carlo in Mitsuba against our own


def slab_for_volpath(sigma_a: float, sigma_s: float, g: float, eta: float) -> dict[str, Any]:
    surface = {"type": "dielectric", "int_ior": eta, "ext_ior": 1.0} if eta > 1 else {"type": "null"}
    return {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -50]).scale([200, 200, 50]),
        "bsdf": surface,
        "interior": {
            "type": "homogeneous",
            "albedo": sigma_s / (sigma_a + sigma_s),
            "sigma_t": sigma_a + sigma_s,
            "phase": {"type": "hg", "g": g} if g else {"type": "isotropic"},
        },
    }


def test_volpath_under_an_even_sky_reflects_what_our_monte_carlo_does() -> None:
    """Seen along the normal: by reciprocity the light that comes back of a beam along the normal."""
    sigma_a, sigma_s, g, eta = 0.2, 2.0, 0.4, 1.4
    scene = mi.load_dict({"type": "scene", "slab": slab_for_volpath(sigma_a, sigma_s, g, eta), "sky": SKY})
    n = 1 << 15
    value, error = radiance(scene, towards_origin(n, 1.0), n, type="volpath", max_depth=400, rr_depth=401)
    tally = simulate(MonteCarloMedium(sigma_a, sigma_s, g, eta), r_edges_mm=[0, 1], n_photons=40_000, seed=1)
    entering, entering_error = tally.total_r()
    transmitted = float(fresnel_t(eta, 1.0))
    expected = 1 - transmitted + transmitted * entering
    assert abs(value[0] - expected) < 4 * math.hypot(error[0], transmitted * entering_error)


@pytest.mark.parametrize(("order", "depth"), [("first", 2), ("all", 200)])
def test_volpath_around_a_beam_is_our_monte_carlo(order: Any, depth: int) -> None:
    """Index-matched, since no light sampling finds a beam through a refracting surface."""
    sigma_a, sigma_s, spot = 0.3, 1.0, 1.0
    scene = mi.load_dict({"type": "scene", "slab": slab_for_volpath(sigma_a, sigma_s, 0.0, 1.0), "beam": beam(spot)})
    fine = np.concatenate([[0], np.geomspace(0.02, 8, 40)])
    tally = simulate(MonteCarloMedium(sigma_a, sigma_s), r_edges_mm=fine, n_photons=400_000, seed=2)
    profile, _ = tally.rd(order)
    n = 1 << 16
    for low, high in ((0.0, 1.0), (1.0, 2.0), (2.0, 4.0)):
        rays = leaving_annulus(low, high, n, seed=6)
        value, error = radiance(scene, rays, n, type="volpath", max_depth=depth, rr_depth=depth + 1)
        distance = across_spot(low, high, spot)
        bins = np.searchsorted(fine, distance, side="right") - 1
        expected = np.append(profile, 0)[bins].mean()
        assert math.pi * value[0] == pytest.approx(expected, rel=0.02, abs=4 * math.pi * error[0])


# What cannot be rendered, or only so-so


def test_a_flat_texture_is_the_number_in_it() -> None:
    def grey(value: float) -> dict[str, Any]:
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.full((2, 2, 1), value, np.float32)), "raw": True}

    n = 1 << 16
    ball_light = {"shape": {"type": "sphere", "radius": 4.0}, "sky": SKY}
    textured = {"sigma_a": grey(0.01), "sigma_sp": grey(1.0), "eta": 1.3}
    medium = dipole.Medium(0.01, 1.0, 1.3)
    maps = {"reflectance": grey(float(dipole.total_r(medium))), "mean_free_path": grey(1 / 1.01), "eta": 1.3}
    plain, error = radiance(scene_of({"sigma_a": 0.01, "sigma_sp": 1.0, "eta": 1.3}, **ball_light), around(4.0, n), n)
    for other in (textured, maps):
        value, other_error = radiance(scene_of(other, **ball_light), around(4.0, n), n)
        assert abs(value[0] - plain[0]) < 4 * math.hypot(error[0], other_error[0])


def test_on_the_seam_of_two_media_each_half_gives_its_own_light() -> None:
    """Diffusion goes by the coefficients where light entered: half of either total, seen from the seam."""
    first, second = dipole.Medium(0.3, 1.0, 1.3), dipole.Medium(0.003, 1.0, 1.3)
    halves = np.array([[[first.sigma_a], [second.sigma_a]]], np.float32)
    medium = {
        "sigma_a": {"type": "bitmap", "bitmap": mi.Bitmap(halves), "raw": True, "filter_type": "nearest"},
        "sigma_sp": 1.0,
        "eta": 1.3,
    }
    n = 1 << 18
    value, error = radiance(scene_of(medium, sky=SKY), towards_origin(n), n, terms="diffusion")
    totals = [float(scoped_x64(dipole.total_r)(half)) for half in (first, second)]
    expected = float(fresnel_t(1.3, VIEW)) * np.mean(totals)
    assert error[0] < 0.005 * expected
    assert value[0] == pytest.approx(expected, rel=0.01)


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
        ({"type": "bssrdf", "terms": "diffusion,double"}, "some of diffusion, single, specular"),
        ({"type": "bssrdf", "sampling": "best"}, "exact or exponential"),
        ({"type": "bssrdf", "max_depth": 0}, "above 0"),
    ],
)
def test_wrong_properties_are_named_with_what_to_give(plugin: dict[str, Any], says: str) -> None:
    with pytest.raises(Exception, match=says):
        mi.load_dict(plugin)
