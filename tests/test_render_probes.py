"""Probes of a surface: their density is one over the surface for each hit, whatever its shape."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("mitsuba", reason='Mitsuba is not installed: pip install "bssrdf[render]"')

import drjit as dr
import mitsuba as mi
from mitsuba_scenes import sampler

from bssrdf.render import probes
from bssrdf.render.medium import Media

Floats = NDArray[np.float64]


pytestmark = pytest.mark.usefixtures("mitsuba_mono")


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
