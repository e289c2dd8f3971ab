"""The figure or a given mesh: lit from behind as the paper's Fig. 9, or as a face, its Fig. 11."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.render.head import head_mesh
from bssrdf.render.material import RenderMaterial
from bssrdf.render.scenes.place import SKY, panel, sky, table
from bssrdf.render.scenes.record import Body, Bump, Scene, Vector, Viewpoint
from bssrdf.render.surface_nets import TriangleMesh

BUST_MM = 60.0
FACE_MM = 320.0
"""Height of the figure: a small statue, and a head on shoulders in life size."""
_PORES_PX = 256
_PORES_REPEAT = (12.0, 8.0)
_PORES_SEED = 11


def bust(material: RenderMaterial, *, mesh: TriangleMesh | None = None, **look: Any) -> Scene:
    """The figure on a dark table, lit by a panel behind it and to one side."""
    mesh = mesh or _figure(BUST_MM)
    h, at = _stand(mesh)
    lights = {
        "behind": panel(at(1.9, 1.0, 1.3), at(0, 0, 0.6), (0.4 * h, 0.4 * h), radiance=25.0),
        SKY: sky(0.015),
    }
    camera = Viewpoint(at(-0.55, -2.7, 0.75), at(0, 0, 0.5), fov_deg=26.0)
    return Scene("bust", {"bust": _body(mesh, material, **look)}, lights, camera, {"table": table(0.1)})


def face(material: RenderMaterial, *, mesh: TriangleMesh | None = None, **look: Any) -> Scene:
    """The figure's face from near, pores as a bump map, lit hard from one side."""
    mesh = mesh or _figure(FACE_MM)
    h, at = _stand(mesh)
    rng = np.random.default_rng(_PORES_SEED)
    bump = Bump(_pores(rng), _PORES_REPEAT)
    lights = {
        "key": panel(at(2.2, -0.5, 1.6), at(0, 0, 0.6), (0.12 * h, 0.12 * h), radiance=200.0),
        SKY: sky(0.03),
    }
    camera = Viewpoint(at(-0.25, -2.5, 0.72), at(0, -0.05, 0.62), fov_deg=11.5)
    return Scene("face", {"face": _body(mesh, material, bump=bump, **look)}, lights, camera)


def _figure(height_mm: float) -> TriangleMesh:
    mesh = _figure_of_one()
    return mesh._replace(vertices=height_mm * mesh.vertices)


@functools.cache
def _figure_of_one() -> TriangleMesh:
    return head_mesh(1.0)


def _stand(mesh: TriangleMesh) -> tuple[float, Any]:
    """The height of the mesh, and a function from places in units of it, over the middle of its foot, to the scene."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    height = float(high[2] - low[2])
    foot = np.append((low + high)[:2] / 2, low[2])

    def at(x: float, y: float, z: float) -> Vector:
        px, py, pz = foot + height * np.array([x, y, z])
        return float(px), float(py), float(pz)

    return height, at


def _body(mesh: TriangleMesh, material: RenderMaterial, **look: Any) -> Body:
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1).sum() / 2
    volume = abs(np.einsum("ij,ij->", corners[:, 0], across)) / 6
    return Body(mesh, material, float(3 * volume / area), **look)


def _pores(rng: np.random.Generator) -> NDArray[np.float32]:
    """Small pits [mm] on a surface that repeats at its sides."""
    axis = np.fft.fftfreq(_PORES_PX) * _PORES_PX
    frequency = np.hypot(*np.meshgrid(axis, axis))
    band = np.exp(-np.square((frequency - 22) / 9))
    noise = np.fft.ifft2(np.fft.fft2(rng.normal(size=(_PORES_PX, _PORES_PX))) * band).real
    return (0.10 * np.tanh(noise / noise.std())).astype(np.float32)
