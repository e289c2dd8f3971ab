"""The figure or a given mesh: lit from behind as the paper's Fig. 9, or as a face, its Fig. 11."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.render import head, surface_nets
from bssrdf.render.kept import kept
from bssrdf.render.material import RenderMaterial
from bssrdf.render.scenes.place import SKY, paint, panel, sky, table, wall
from bssrdf.render.scenes.record import Body, Bump, Scene, Vector, Viewpoint
from bssrdf.render.surface_nets import TriangleMesh

BUST_MM = 60.0
FACE_MM = 320.0
"""Height of the figure: a small statue, and a head on shoulders in life size."""
_PORES_PX = 256
_PORES_MM = 26.0
"""Width over which the pores repeat."""
_PORES_SEED = 11
_DUSK = paint(0.05, 0.065, 0.085)
_WOOD = paint(0.10, 0.06, 0.035)

At = Callable[[float, float, float], Vector]


def bust(material: RenderMaterial, *, mesh: TriangleMesh | None = None, **look: Any) -> Scene:
    """The figure on a table, lit from behind on both sides, so that what is thin glows."""
    mesh, h, at = _stand(mesh or _figure(BUST_MM))
    lights = {
        "key": panel(_round(at, -80, 2.0, 1.45), at(0, 0, 0.7), (0.25 * h, 0.25 * h), radiance=30.0),
        "behind": panel(_round(at, 162, 2.0, 1.1), at(0, 0, 0.7), (0.3 * h, 0.3 * h), radiance=12.0),
        SKY: sky(0.02),
    }
    camera = Viewpoint(_round(at, 25, 2.6, 0.82), at(0, 0, 0.58), fov_deg=20.0)
    furniture = {"table": table(_WOOD), "wall": wall(_round(at, 205, 2.8, 0.5), _DUSK)}
    body = Body(mesh, material, mesh.size(), **look)
    return Scene("bust", {"bust": body}, lights, camera, furniture, white_percentile=97.0)


def face(material: RenderMaterial, *, mesh: TriangleMesh | None = None, **look: Any) -> Scene:
    """The figure's face from near, pores as a bump map, under a lamp that casts soft shadows."""
    mesh, h, at = _stand(mesh or _figure(FACE_MM))
    around = np.pi * float(np.ptp(mesh.vertices[:, 0]))
    repeat = (max(1.0, round(around / _PORES_MM)), max(1.0, round(h / _PORES_MM)))
    bump = Bump(_pores(np.random.default_rng(_PORES_SEED)), repeat)
    lights = {
        "key": panel(_round(at, -50, 2.0, 1.7), at(0, 0, 0.65), (0.2 * h, 0.2 * h), radiance=40.0),
        "behind": panel(_round(at, 120, 2.0, 1.2), at(0, 0, 0.65), (0.25 * h, 0.25 * h), radiance=4.0),
        SKY: sky(0.03),
    }
    camera = Viewpoint(_round(at, -12, 2.5, 0.75), at(0, -0.03, 0.63), fov_deg=9.5)
    furniture = {"wall": wall(_round(at, 168, 3.0, 0.5), _DUSK)}
    return Scene("face", {"face": Body(mesh, material, mesh.size(), bump=bump, **look)}, lights, camera, furniture)


def _figure(height_mm: float) -> TriangleMesh:
    mesh = _figure_of_one()
    return mesh._replace(vertices=height_mm * mesh.vertices)


@functools.cache
def _figure_of_one() -> TriangleMesh:
    source = "".join(inspect.getsource(module) for module in (head, surface_nets))
    made = kept("head", (source,), lambda: head.head_mesh(1.0)._asdict())
    return surface_nets.TriangleMesh(**made)


def _stand(mesh: TriangleMesh) -> tuple[TriangleMesh, float, At]:
    """The mesh with the middle of its foot at the origin, its height, and places in units of it."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    height = float(high[2] - low[2])
    foot = np.append((low + high)[:2] / 2, low[2])

    def at(x: float, y: float, z: float) -> Vector:
        return height * x, height * y, height * z

    return mesh._replace(vertices=mesh.vertices - foot), height, at


def _round(at: At, azimuth_deg: float, distance: float, z: float) -> Vector:
    """A place round the figure: before its face at 0°, on its right-hand side at 90°."""
    azimuth = np.radians(azimuth_deg)
    return at(float(-distance * np.sin(azimuth)), float(-distance * np.cos(azimuth)), z)


def _pores(rng: np.random.Generator) -> NDArray[np.float32]:
    """Small pits [mm] on a surface that repeats at its sides."""
    axis = np.fft.fftfreq(_PORES_PX) * _PORES_PX
    frequency = np.hypot(*np.meshgrid(axis, axis))
    band = np.exp(-np.square((frequency - 22) / 9))
    noise = np.fft.ifft2(np.fft.fft2(rng.normal(size=(_PORES_PX, _PORES_PX))) * band).real
    return (0.10 * np.tanh(noise / noise.std())).astype(np.float32)
