"""Small scenes and rays for Mitsuba, and what closed forms say of them."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import drjit as dr
import mitsuba as mi

from bssrdf.transport import dipole, single, table_model
from bssrdf.transport.fresnel import fresnel_t
from bssrdf.transport.materials import PublishedMaterial
from bssrdf.transport.precision import scoped_x64

Floats = NDArray[np.float64]


MARBLE = {"sigma_a": 0.0041, "sigma_sp": 2.62, "eta": 1.5}
SKY = {"type": "constant"}
VIEW = 0.8
"""Cosine of the viewing angle."""


def plane(half: float = 200.0) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale([half, half, 1])}


def scene_of(medium: dict[str, Any], shape: dict[str, Any] | None = None, **others: Any) -> Any:
    body = (shape or plane()) | {"bsdf": {"type": "bssrdf_medium", **medium}}
    return mi.load_dict({"type": "scene", "body": body, **others})


def sampler(n: int, seed: int) -> Any:
    made = mi.load_dict({"type": "independent"})
    made.seed(seed, n)
    return made


def camera(width: float) -> Any:
    """From above, so wide, 64 pixels a side."""
    above = mi.ScalarTransform4f().look_at([0, 0, 50], [0, 0, 0], [0, 1, 0]).scale([width / 2, width / 2, 1])
    film = {"type": "hdrfilm", "width": 64, "height": 64}
    return mi.load_dict({"type": "orthographic", "to_world": above, "film": film})


def prepared(scene: Any, view: float = 2.0, **options: Any) -> Any:
    """An integrator that knows the light of the scene; surfaces are fine within the view."""
    integrator = mi.load_dict({"type": "bssrdf", **options})
    if hasattr(integrator, "prepare"):
        integrator.prepare(scene, camera(view))
    return integrator


def seen(integrator: Any, scene: Any, ray: Any, n: int, seed: int = 0) -> tuple[Floats, Floats]:
    """Mean over n samples of the rays, and its standard error, by channel."""
    value, _, _ = integrator.sample(scene, sampler(n, seed), ray)
    values = np.array(value, np.float64)
    return values.mean(axis=1), values.std(axis=1) / math.sqrt(n)


def radiance(scene: Any, ray: Any, n: int, seed: int = 0, view: float = 2.0, **options: Any) -> tuple[Floats, Floats]:
    """`seen` by an integrator that is made for it."""
    return seen(prepared(scene, view, **options), scene, ray, n, seed)


def towards_origin(n: int, mu: float = VIEW) -> Any:
    direction = mi.Vector3f(math.sqrt(1 - mu * mu), 0, -mu)
    return mi.Ray3f(dr.zeros(mi.Point3f, n) - 5 * direction, direction)


def towards_square(half: float, n: int, mu: float = VIEW) -> Any:
    """Onto places all over a square about the origin."""
    place = (2 * sampler(n, 5).next_2d() - 1) * half
    direction = mi.Vector3f(math.sqrt(1 - mu * mu), 0, -mu)
    return mi.Ray3f(mi.Point3f(place.x, place.y, 0) - 5 * direction, direction)


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
    """Radiance under light of radiance 1 from everywhere, by the table: what a beam from there would send back."""
    medium = dipole.Medium(material.sigma_a_per_mm[channel], material.sigma_sp_per_mm[channel], material.eta)
    model = table_model(material.eta, 0.0)
    entering = float(fresnel_t(material.eta, 1.0)) * float(scoped_x64(model.total)(medium))
    towards, ahead = (float(scoped_x64(model.total_radiance_factor)(medium, cosine)) for cosine in (mu, 1.0))
    return 1 - float(fresnel_t(material.eta, mu)) + entering * towards / ahead


def even_terms(material: PublishedMaterial, channel: int, mu: float) -> float:
    """The same by the sum of the paper's terms."""
    sigma_a, sigma_sp = material.sigma_a_per_mm[channel], material.sigma_sp_per_mm[channel]
    transmitted = float(fresnel_t(material.eta, mu))
    diffuse = float(dipole.total_r(dipole.Medium(sigma_a, sigma_sp, material.eta)))
    return 1 - transmitted + transmitted * diffuse + even_single(sigma_a, sigma_sp, 0.0, material.eta, mu)


def across_spot(r_lo: float, r_hi: float, spot: float, log2_n: int = 17) -> Floats:
    """Distances between points of an annulus and points of an evenly lit disk in its middle."""
    u = stats.qmc.Sobol(3, seed=0).random_base2(log2_n).T
    r, offset = np.sqrt(r_lo**2 + (r_hi**2 - r_lo**2) * u[0]), spot * np.sqrt(u[1])
    return np.hypot(r - offset * np.cos(math.tau * u[2]), offset * np.sin(math.tau * u[2]))


def beam_reference(edges: Floats, spot: float, medium: dict[str, float]) -> Floats:
    """R_d of the table, of the flux that entered, spread over the spot; mean over each annulus."""
    grid = np.geomspace(1e-3, 40, 2000)
    profile = np.asarray(scoped_x64(table_model(medium["eta"], 0.0).rd)(dipole.Medium(**medium), grid))
    means = [
        np.exp(np.interp(np.log(across_spot(low, high, spot)), np.log(grid), np.log(profile))).mean()
        for low, high in itertools.pairwise(edges)
    ]
    return float(fresnel_t(medium["eta"], 1.0)) * np.array(means)
