"""The table through which the integrators read all translucent surfaces of a scene. Coefficients in 1/scene unit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from bssrdf.render.interface import transmittance_table
from bssrdf.render.kernel import COSINES, Kernel, Kernels, cosines, kernels
from bssrdf.render.surface import (
    INVERSION_SIZE,
    MediumBoundary,
    albedo_range,
    coefficients,
    extinction,
    inversion_table,
)
from bssrdf.transport import nearest

_SCALARS = ("eta", "g", "alpha", "first_kernel", "kernels", "least_q", "most_q")
_TEXTURE_KERNELS = 33
"""Media of a texture for which tables are made, evenly spaced in q = √(1 − α′)."""

Floats = NDArray[np.float64]


@dataclass
class Optics:
    """The medium under each ray of a wavefront: colours and numbers as Dr.Jit arrays."""

    sigma_a: Any
    sigma_sp: Any
    eta: Any
    g: Any
    alpha: Any
    kernel: Any
    """Place of each channel's medium among all tables, between two of them where coefficients vary."""
    row: Any

    def sigma_s(self) -> Any:
        """Scattering coefficient, not reduced."""
        return self.sigma_sp / (1 - self.g)

    def sigma_t(self) -> Any:
        """Extinction coefficient."""
        return self.sigma_a + self.sigma_s()


class Media:
    """All translucent surfaces of a scene, by the shapes' BSDFs; the kernels read numbers, never constants."""

    def __init__(self, scene: Any, kernel: Kernel = "table") -> None:
        surfaces: dict[int, MediumBoundary] = {}
        self._kernel = kernel
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
        self.tables = [_tables(surface, kernel) for surface in self.surfaces]
        if self.surfaces:
            self._fill(list(surfaces))

    def _fill(self, ids: list[int]) -> None:
        rows = np.zeros(max(ids) + 1, np.uint32)
        rows[ids] = np.arange(1, len(ids) + 1)
        self._rows = mi.UInt32(rows)
        crossed = [transmittance_table(surface.eta, surface.alpha) for surface in self.surfaces]
        self._transmittance = mi.Float(np.concatenate(crossed).astype(np.float32))
        inverted = [_inversion(surface) for surface in self.surfaces]
        self._inversion = mi.Float(np.concatenate(inverted).astype(np.float32))
        lobes = [table.lobe * once for table, once in zip(self.tables, crossed, strict=True)]
        mu = cosines()
        norms = [2 * np.trapezoid(lobe * mu, mu, axis=1) for lobe in lobes]
        self._lobe = mi.Float(np.concatenate(lobes).astype(np.float32).ravel())
        self._norm = mi.Float(np.concatenate(norms).astype(np.float32))
        self._total = mi.Float(np.concatenate([table.total for table in self.tables]).astype(np.float32))
        first = np.cumsum([0, *(len(table.total) for table in self.tables)])
        numbers = [_numbers(*each) for each in zip(self.surfaces, self.tables, first, strict=False)]
        self._numbers = mi.Float(np.concatenate(numbers).astype(np.float32))
        self._stride = len(numbers[0])

    def shortest_mean_free_path(self) -> float:
        """The least 1/σt over all surfaces and channels; 0 where a texture may hold anything."""
        if self.textured:
            return 0.0
        return min((1 / float(np.max(extinction(s))) for s in self.surfaces), default=math.inf)

    def remarks(self) -> list[str]:
        """A line for each surface whose light is not quite that of its own medium."""
        found = []
        for surface in self.surfaces:
            at_hand = nearest(surface.eta, surface.g)
            if self._kernel == "table" and not at_hand.near:
                found.append(
                    f"surface of eta {surface.eta:g} and g {surface.g:g}: no Monte Carlo table is that near; "
                    f"its points are of eta {at_hand.eta:g} and g {at_hand.g:g}"
                )
            if self._kernel == "dipole" and "reflectance" in surface.pair:
                found.append("a reflectance is taken to be the Monte Carlo table's; the dipole gives another of it")
        return found

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
        n, n_channels = len(_SCALARS), dr.size_v(mi.Spectrum)
        sigma_a, sigma_sp, kernel = (
            mi.Spectrum(numbers[n + i * n_channels : n + (i + 1) * n_channels]) for i in range(3)
        )
        eta, g, alpha, first, count, least, most = numbers[:n]
        for i, surface in enumerate(self.surfaces):
            if surface.textured:
                here = active & (row == i)
                looked_up = self._look_up(surface, i, si, here)
                sigma_a, sigma_sp = dr.select(here, looked_up[0], sigma_a), dr.select(here, looked_up[1], sigma_sp)
                q = dr.sqrt(sigma_a / dr.maximum(sigma_a + sigma_sp, 1e-20))
                place = (most - q) / dr.maximum(most - least, 1e-6) * (count - 1)
                kernel = dr.select(here, first + dr.clip(place, 0, count - 1), kernel)
        return Optics(sigma_a, sigma_sp, eta, g, alpha, kernel, row)

    def optics_at(self, si: Any, optics: Optics, active: Any) -> Optics:
        """The medium at another point of the same surface."""
        return self.optics(si, optics.row, active) if self.textured else optics

    def transmittance(self, optics: Optics, cos_theta: Any) -> Any:
        """Share of the light from an outside direction that enters: Ft, over the slopes of a rough surface."""
        smooth = 1 - mi.fresnel(dr.maximum(cos_theta, 0), optics.eta)[0]
        if not self.rough:
            return smooth
        tabulated = _interpolated(self._transmittance, COSINES, optics.row, cos_theta)
        return dr.select(optics.alpha > 0, tabulated, smooth)

    def total(self, optics: Optics) -> Any:
        """R, of the light that enters along the normal."""
        return self._by_channel(optics, lambda row: dr.gather(mi.Float, self._total, row))

    def entering(self, optics: Optics, cos_theta: Any) -> Any:
        """Share of the light from an outside direction that enters, times what of it comes out over R."""
        return self._by_channel(optics, lambda row: _interpolated(self._lobe, COSINES, row, cos_theta))

    def leaving(self, optics: Optics, cos_theta: Any) -> Any:
        """π times the radiance towards an outside direction, over the radiant exitance."""

        def lobe(row: Any) -> Any:
            norm = dr.gather(mi.Float, self._norm, row)
            return _interpolated(self._lobe, COSINES, row, cos_theta) / norm

        return self._by_channel(optics, lobe)

    def leaving_of(self, row: int) -> Callable[[Floats], Floats]:
        """`leaving` at cosines (k,) as NumPy arrays, (k, channels), of an untextured surface."""
        surface, table, mu = self.surfaces[row], self.tables[row], cosines()
        rows = np.searchsorted(table.albedo, _albedo(surface))
        lobes = table.lobe[rows] * transmittance_table(surface.eta, surface.alpha)
        lobes /= 2 * np.trapezoid(lobes * mu, mu, axis=1).reshape(-1, 1)
        return lambda cosine: np.stack([np.interp(cosine, mu, lobe) for lobe in lobes], axis=1)

    def _by_channel(self, optics: Optics, value: Callable[[Any], Any]) -> Any:
        found = []
        for place in optics.kernel:
            row = mi.UInt32(place)
            one = value(row)
            if self.textured:
                above = dr.minimum(row + 1, dr.width(self._total) - 1)
                one = dr.lerp(one, value(above), place - mi.Float(row))
            found.append(one)
        return mi.Spectrum(found)

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
        ratio = dr.square(q)
        sigma_tp = surface.scale / dr.maximum(second, 1e-20)
        return ratio * sigma_tp, (1 - ratio) * sigma_tp


def _interpolated(table: Any, size: int, row: Any, x: Any) -> Any:
    """A row of a table over a uniform grid of x from 0 to 1."""
    place = dr.clip(x, 0, 1) * (size - 1)
    index = dr.minimum(mi.UInt32(place), size - 2)
    start = row * size + index
    return dr.lerp(dr.gather(mi.Float, table, start), dr.gather(mi.Float, table, start + 1), place - mi.Float(index))


def _tables(surface: MediumBoundary, kernel: Kernel) -> Kernels:
    """Of the surface's channels, or of media over all that a texture holds; of the nearest phase function at hand."""
    if surface.textured:
        most, least = (math.sqrt(1 - albedo) for albedo in albedo_range(surface))
        albedo = 1 - np.linspace(max(most, least + 1e-3), least, _TEXTURE_KERNELS) ** 2
    else:
        albedo = np.unique(_albedo(surface))
    at_hand = nearest(surface.eta, surface.g) if kernel == "table" else surface
    return kernels(at_hand.eta, at_hand.g, albedo, kernel)


def _inversion(surface: MediumBoundary) -> Floats:
    return inversion_table(surface.eta, surface.g) if "reflectance" in surface.pair else np.zeros(INVERSION_SIZE)


def _albedo(surface: MediumBoundary) -> Floats:
    sigma_a, sigma_sp = coefficients(surface)
    return np.asarray(sigma_sp / (sigma_a + sigma_sp))


def _numbers(surface: MediumBoundary, table: Kernels, first: int) -> Floats:
    """Scalars of a surface, then its coefficients and the places of its tables, by channel."""
    most, least = np.sqrt(1 - table.albedo[[0, -1]])
    scalars = [surface.eta, surface.g, surface.alpha, first, len(table.albedo), least, most]
    if surface.textured:
        return np.concatenate([scalars, np.ones(3 * dr.size_v(mi.Spectrum))])
    return np.concatenate([scalars, *coefficients(surface), first + np.searchsorted(table.albedo, _albedo(surface))])


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
