"""The table through which the integrators read all translucent surfaces of a scene. Coefficients in 1/scene unit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from bssrdf.render.interface import TABLE_SIZE, transmittance_table
from bssrdf.render.sampling import DipoleSources, dipole
from bssrdf.render.surface import (
    INVERSION_SIZE,
    MediumBoundary,
    coefficients,
    extinction,
    inversion_table,
    widest_coefficients,
)
from bssrdf.transport import scoped_x64
from bssrdf.transport.fresnel import boundary_a, exit_norm

_SCALARS = ("eta", "g", "alpha", "boundary_a", "exit_norm")

Floats = NDArray[np.float64]


@dataclass
class Optics:
    """The medium under each ray of a wavefront: colours and numbers as Dr.Jit arrays."""

    sigma_a: Any
    sigma_sp: Any
    eta: Any
    g: Any
    alpha: Any
    boundary_a: Any
    exit_norm: Any
    row: Any

    def dipole(self) -> DipoleSources:
        """Its two sources."""
        return dipole(self.sigma_a, self.sigma_sp, self.boundary_a)

    def sigma_s(self) -> Any:
        """Scattering coefficient, not reduced."""
        return self.sigma_sp / (1 - self.g)

    def sigma_t(self) -> Any:
        """Extinction coefficient."""
        return self.sigma_a + self.sigma_s()


class Media:
    """All translucent surfaces of a scene, by the shapes' BSDFs; the kernels read numbers, never constants."""

    def __init__(self, scene: Any) -> None:
        surfaces: dict[int, MediumBoundary] = {}
        self.shapes: list[Any] = []
        self.others = False
        """Has the scene surfaces of another kind?"""
        for shape in scene.shapes():
            bsdf = shape.bsdf()
            surface = getattr(bsdf, "surface", None)
            if isinstance(surface, MediumBoundary):
                surfaces[_registry_id(bsdf)] = surface
                self.shapes.append(shape)
            else:
                self.others = True
        self.surfaces = list(surfaces.values())
        self.textured = any(surface.textured for surface in self.surfaces)
        self.rough = any(surface.alpha > 0 for surface in self.surfaces)
        if self.surfaces:
            self._fill(list(surfaces))

    def _fill(self, ids: list[int]) -> None:
        rows = np.zeros(max(ids) + 1, np.uint32)
        rows[ids] = np.arange(1, len(ids) + 1)
        self._rows = mi.UInt32(rows)
        tables = [transmittance_table(surface.eta, surface.alpha) for surface in self.surfaces]
        norms = [_mean_transmittance(s, table) for s, table in zip(self.surfaces, tables, strict=True)]
        self._transmittance = mi.Float(np.concatenate(tables).astype(np.float32))
        self._inversion = mi.Float(np.concatenate([inversion_table(s.eta) for s in self.surfaces]).astype(np.float32))
        numbers = [_numbers(s, norm) for s, norm in zip(self.surfaces, norms, strict=True)]
        self._numbers = mi.Float(np.concatenate(numbers).astype(np.float32))
        self._stride = len(numbers[0])
        widest = [widest_coefficients(s).ravel() for s in self.surfaces]
        self._widest = mi.Float(np.concatenate(widest).astype(np.float32))

    def shortest_mean_free_path(self) -> float:
        """The least 1/σt over all surfaces and channels; 0 where a texture may hold anything."""
        if self.textured:
            return 0.0
        return min((1 / float(np.max(extinction(s))) for s in self.surfaces), default=math.inf)

    def row(self, si: Any, active: Any) -> tuple[Any, Any]:
        """Row of the table under each hit, and whether there is one."""
        bsdf_id = dr.reinterpret_array(mi.UInt32, si.bsdf())
        known = active & (bsdf_id < dr.width(self._rows))
        row = dr.gather(mi.UInt32, self._rows, bsdf_id, known)
        return dr.maximum(row, 1) - 1, known & (row > 0)

    def optics(self, si: Any, row: Any, active: Any) -> Optics:
        """The medium at each hit, textures looked up."""
        start = row * self._stride
        numbers = [dr.gather(mi.Float, self._numbers, start + i, active) for i in range(self._stride)]
        n = len(_SCALARS)
        n_channels = dr.size_v(mi.Spectrum)
        sigma_a = mi.Spectrum(numbers[n : n + n_channels])
        sigma_sp = mi.Spectrum(numbers[n + n_channels :])
        for i, surface in enumerate(self.surfaces):
            if surface.textured:
                here = active & (row == i)
                looked_up = self._look_up(surface, i, si, here)
                sigma_a, sigma_sp = dr.select(here, looked_up[0], sigma_a), dr.select(here, looked_up[1], sigma_sp)
        eta, g, alpha, boundary, norm = numbers[:n]
        return Optics(sigma_a, sigma_sp, eta, g, alpha, boundary, norm, row)

    def widest(self, optics: Optics, active: Any) -> DipoleSources | None:
        """The dipole of the places of a surface where light spreads farthest; None if it is the same everywhere."""
        if not self.textured:
            return None
        n = dr.size_v(mi.Spectrum)
        values = [dr.gather(mi.Float, self._widest, optics.row * 2 * n + i, active) for i in range(2 * n)]
        return dipole(mi.Spectrum(values[:n]), mi.Spectrum(values[n:]), optics.boundary_a)

    def optics_at(self, si: Any, optics: Optics, active: Any) -> Optics:
        """The medium at another point of the same surface."""
        return self.optics(si, optics.row, active) if self.textured else optics

    def transmittance(self, optics: Optics, cos_theta: Any) -> Any:
        """Share of the light from an outside direction that enters: Ft, over the slopes of a rough surface."""
        smooth = 1 - mi.fresnel(dr.maximum(cos_theta, 0), optics.eta)[0]
        if not self.rough:
            return smooth
        tabulated = _interpolated(self._transmittance, TABLE_SIZE, optics.row, cos_theta)
        return dr.select(optics.alpha > 0, tabulated, smooth)

    def normal(self, si: Any, row: Any, active: Any) -> Any:
        """Shading normal, tilted by the displacement map where there is one."""
        normal = mi.Normal3f(si.sh_frame.n)
        for i, surface in enumerate(self.surfaces):
            if surface.bump is not None:
                here = active & (row == i)
                gradient = surface.bump_scale * surface.bump.eval_1_grad(si, here)
                normal = dr.select(here, _tilted(gradient, si), normal)
        return normal

    def _look_up(self, surface: MediumBoundary, i: int, si: Any, active: Any) -> tuple[Any, Any]:
        first, second = (_value(surface.pair[name], si, active) for name in surface.pair)
        if "sigma_a" in surface.pair:
            return first * surface.scale, second * surface.scale
        q = mi.Spectrum([_interpolated(self._inversion, INVERSION_SIZE, i, channel) for channel in first])
        ratio = dr.square(q) / 3
        sigma_tp = surface.scale / dr.maximum(second, 1e-20)
        return ratio * sigma_tp, (1 - ratio) * sigma_tp


def _interpolated(table: Any, size: int, row: Any, x: Any) -> Any:
    """A row of a table over a uniform grid of x from 0 to 1."""
    place = dr.clip(x, 0, 1) * (size - 1)
    index = dr.minimum(mi.UInt32(place), size - 2)
    start = row * size + index
    return dr.lerp(dr.gather(mi.Float, table, start), dr.gather(mi.Float, table, start + 1), place - mi.Float(index))


@scoped_x64
def _numbers(surface: MediumBoundary, norm: float) -> Floats:
    scalars = [surface.eta, surface.g, surface.alpha, float(boundary_a(surface.eta)), norm]
    n = dr.size_v(mi.Spectrum)
    colours = np.ones((2, n)) if surface.textured else coefficients(surface)
    return np.concatenate([scalars, *colours])


@scoped_x64
def _mean_transmittance(surface: MediumBoundary, table: Floats) -> float:
    """C = 2∫ T μ dμ of the boundary."""
    if surface.alpha == 0:
        return float(exit_norm(surface.eta))
    mu = np.linspace(0, 1, TABLE_SIZE)
    return float(2 * np.trapezoid(table * mu, mu))


def _tilted(gradient: Any, si: Any) -> Any:
    """Normal of the surface displaced by a height of this gradient in the texture's coordinates."""
    n = si.sh_frame.n
    along_u = si.dp_du + n * (gradient.x - dr.dot(n, si.dp_du))
    along_v = si.dp_dv + n * (gradient.y - dr.dot(n, si.dp_dv))
    tilted = dr.normalize(dr.cross(along_u, along_v))
    tilted = dr.select(dr.dot(tilted, n) < 0, -tilted, tilted)
    return mi.Normal3f(dr.select(dr.isfinite(dr.sum(tilted)), tilted, n))


def _value(value: Any, si: Any, active: Any) -> Any:
    return mi.Spectrum(value.tolist()) if isinstance(value, np.ndarray) else value.eval(si, active)


def _registry_id(bsdf: Any) -> int:
    return int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))[0])
