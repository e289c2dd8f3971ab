"""The translucent surface, BSDF plugin `bssrdf_medium`, and the table through which the integrators read all of them.

Coefficients in 1/scene unit. Each of sigma_a, sigma_sp, reflectance and mean_free_path is a number, a colour or a
texture; everything else is one number for a surface.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.render.interface import TABLE_SIZE, transmittance_table
from bssrdf.render.sampling import Dipole, dipole
from bssrdf.transport.dipole import total_r_of_ratio
from bssrdf.transport.fresnel import boundary_a, exit_norm
from bssrdf.transport.precision import scoped_x64

PLUGIN = "bssrdf_medium"
PAIRS = (("sigma_a", "sigma_sp"), ("reflectance", "mean_free_path"))
NUMBERS = {"scale": 1.0, "g": 0.0, "alpha": 0.0, "bump_scale": 1.0}

_SCALARS = ("eta", "g", "alpha", "boundary_a", "exit_norm")
_INVERSION_SIZE = 1024

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Surface:
    """What one `bssrdf_medium` says: numbers, and the two quantities of a pair by name, as colours or textures."""

    eta: float
    g: float
    alpha: float
    scale: float
    pair: dict[str, Any]
    """Either Floats of shape (channels,) or a texture."""
    bump: Any | None
    bump_scale: float

    @property
    def textured(self) -> bool:
        """Do the coefficients change over the surface?"""
        return not all(isinstance(value, np.ndarray) for value in self.pair.values())


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

    def dipole(self) -> Dipole:
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
        surfaces: dict[int, Surface] = {}
        self.shapes: list[Any] = []
        self.others = False
        """Has the scene surfaces of another kind?"""
        for shape in scene.shapes():
            bsdf = shape.bsdf()
            surface = getattr(bsdf, "surface", None)
            if isinstance(surface, Surface):
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
        self._inversion = mi.Float(np.concatenate([_inversion(s.eta) for s in self.surfaces]).astype(np.float32))
        numbers = [_numbers(s, norm) for s, norm in zip(self.surfaces, norms, strict=True)]
        self._numbers = mi.Float(np.concatenate(numbers).astype(np.float32))
        self._stride = len(numbers[0])

    def shortest_mean_free_path(self) -> float:
        """The least 1/σt over all surfaces and channels; 0 where a texture may hold anything."""
        if self.textured:
            return 0.0
        return min((1 / float(np.max(_extinction(s))) for s in self.surfaces), default=math.inf)

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
        return Optics(sigma_a, sigma_sp, *numbers[:n], row)

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
                normal = dr.select(here, _tilted(surface, si, here), normal)
        return normal

    def _look_up(self, surface: Surface, i: int, si: Any, active: Any) -> tuple[Any, Any]:
        first, second = (_value(surface.pair[name], si, active) for name in surface.pair)
        if "sigma_a" in surface.pair:
            return first * surface.scale, second * surface.scale
        q = mi.Spectrum([_interpolated(self._inversion, _INVERSION_SIZE, i, channel) for channel in first])
        ratio = dr.square(q) / 3
        sigma_tp = surface.scale / dr.maximum(second, 1e-20)
        return ratio * sigma_tp, (1 - ratio) * sigma_tp


@functools.cache
def register_medium(variant: str) -> None:
    """Make `bssrdf_medium` known to Mitsuba in its current variant, whose name is `variant`."""

    class BssrdfMedium(mi.BSDF):
        """To other integrators a Lambertian surface of the medium's reflectance, behind a smooth boundary."""

        def __init__(self, properties: Any) -> None:
            super().__init__(properties)
            self.surface = read_surface(properties)
            self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [self.m_flags]

        def sample(self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any) -> Any:
            out = dr.zeros(mi.BSDFSample3f)
            out.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            out.pdf = mi.warp.square_to_cosine_hemisphere_pdf(out.wo)
            out.wo.z = dr.mulsign(out.wo.z, si.wi.z)
            out.eta = 1.0
            out.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
            out.sampled_component = mi.UInt32(0)
            value = self.eval(context, si, out.wo, active) / out.pdf
            return out, dr.select(active & (out.pdf > 0), value, 0)

        def eval(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            surface = self.surface
            reflected = mi.Spectrum(total_reflectance(surface).tolist())
            cos_i, cos_o = dr.abs(wo.z), dr.abs(si.wi.z)
            lobe = (1 - mi.fresnel(cos_i, surface.eta)[0]) * (1 - mi.fresnel(cos_o, surface.eta)[0])
            scale = 1 / (math.pi * float(exit_norm(surface.eta)))
            return dr.select(active & (wo.z * si.wi.z > 0), reflected * lobe * cos_i * scale, 0)

        def pdf(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            return dr.select(active & (wo.z * si.wi.z > 0), dr.abs(wo.z) / math.pi, 0)

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def traverse(self, callback: Any) -> None:
            pass

        def to_string(self) -> str:
            return f"BssrdfMedium[{self.surface}]"

    mi.register_bsdf(PLUGIN, BssrdfMedium)


def read_surface(properties: Any) -> Surface:
    """The plugin's properties, checked. Raises InputError, one line, for what is missing or out of range."""
    numbers = {name: float(properties.get(name, default)) for name, default in NUMBERS.items()}
    _require("eta" in properties, "eta is missing", "give the index inside over outside, as 1.3")
    eta = float(properties["eta"])
    _require(1 <= eta < 10, f"eta = {eta:g}", "give an index of at least 1, inside over outside")
    _require(-1 < numbers["g"] < 1, f"g = {numbers['g']:g}", "give a mean cosine between -1 and 1")
    _require(0 <= numbers["alpha"] <= 1, f"alpha = {numbers['alpha']:g}", "give a roughness of 0 to 1")
    _require(0 < numbers["scale"] < math.inf, f"scale = {numbers['scale']:g}", "give a factor above 0")
    given = [pair for pair in PAIRS if any(name in properties for name in pair)]
    _require(
        len(given) == 1, "its coefficients are unclear", "give sigma_a and sigma_sp, or reflectance and mean_free_path"
    )
    for name in given[0]:
        _require(name in properties, f"{name} is missing", f"give {given[0][0]} and {given[0][1]}")
    pair = {name: _colour_or_texture(properties, name) for name in given[0]}
    for name, value in pair.items():
        if isinstance(value, np.ndarray):
            _require(
                bool(np.all(np.isfinite(value)) and np.all(value >= 0)),
                f"{name} = {value}",
                "give values of at least 0",
            )
    surface = Surface(
        eta,
        numbers["g"],
        numbers["alpha"],
        numbers["scale"],
        pair,
        properties.get_unbounded_texture("bump") if "bump" in properties else None,
        numbers["bump_scale"],
    )
    if not surface.textured:
        _require(
            bool(np.all(coefficients(surface).sum(0) > 0)), "the medium is empty", "give sigma_a + sigma_sp above 0"
        )
    return surface


@scoped_x64
def coefficients(surface: Surface) -> Floats:
    """sigma_a and sigma_sp of an untextured surface in 1/scene unit, shape (2, channels)."""
    first, second = surface.pair.values()
    if "sigma_a" in surface.pair:
        return np.stack([first, second]) * surface.scale
    ratio = np.interp(first, np.linspace(0, 1, _INVERSION_SIZE), _inversion(surface.eta)) ** 2 / 3
    return np.stack([ratio, 1 - ratio]) * surface.scale / np.maximum(second, 1e-20)


def _interpolated(table: Any, size: int, row: Any, x: Any) -> Any:
    """A row of a table over a uniform grid of x from 0 to 1."""
    place = dr.clip(x, 0, 1) * (size - 1)
    index = dr.minimum(mi.UInt32(place), size - 2)
    start = row * size + index
    return dr.lerp(dr.gather(mi.Float, table, start), dr.gather(mi.Float, table, start + 1), place - mi.Float(index))


def _extinction(surface: Surface) -> Floats:
    sigma_a, sigma_sp = coefficients(surface)
    return sigma_a + sigma_sp / (1 - surface.g)


def total_reflectance(surface: Surface) -> Floats:
    """R of the mean coefficients, shape (channels,)."""
    sigma_a, sigma_sp = mean_coefficients(surface)
    return _total(sigma_a / (sigma_a + sigma_sp), surface.eta)


def mean_coefficients(surface: Surface) -> Floats:
    """sigma_a and sigma_sp, or those of the textures' means, shape (2, channels)."""
    n = dr.size_v(mi.Spectrum)
    means = {
        name: value if isinstance(value, np.ndarray) else np.full(n, float(np.ravel(np.array(value.mean()))[0]))
        for name, value in surface.pair.items()
    }
    return coefficients(Surface(surface.eta, surface.g, surface.alpha, surface.scale, means, None, 1.0))


@scoped_x64
def _total(ratio: Floats, eta: float) -> Floats:
    return np.asarray(total_r_of_ratio(ratio, np.full_like(ratio, eta)))


@functools.cache
def _inversion(eta: float) -> Floats:
    """q = √(3(1 − α′)) over R on a uniform grid from 0 to 1."""
    q = np.linspace(0, math.sqrt(3), 1 << 14)
    totals = _total(q * q / 3, eta)
    return np.interp(np.linspace(0, 1, _INVERSION_SIZE), totals[::-1], q[::-1])


@scoped_x64
def _numbers(surface: Surface, norm: float) -> Floats:
    scalars = [surface.eta, surface.g, surface.alpha, float(boundary_a(surface.eta)), norm]
    n = dr.size_v(mi.Spectrum)
    colours = np.ones((2, n)) if surface.textured else coefficients(surface)
    return np.concatenate([scalars, *colours])


@scoped_x64
def _mean_transmittance(surface: Surface, table: Floats) -> float:
    """C = 2∫ T μ dμ of the boundary."""
    if surface.alpha == 0:
        return float(exit_norm(surface.eta))
    mu = np.linspace(0, 1, TABLE_SIZE)
    return float(2 * np.trapezoid(table * mu, mu))


def _tilted(surface: Surface, si: Any, active: Any) -> Any:
    gradient = surface.bump_scale * surface.bump.eval_1_grad(si, active)
    n = si.sh_frame.n
    along_u = si.dp_du + n * (gradient.x - dr.dot(n, si.dp_du))
    along_v = si.dp_dv + n * (gradient.y - dr.dot(n, si.dp_dv))
    tilted = dr.normalize(dr.cross(along_u, along_v))
    tilted = dr.select(dr.dot(tilted, n) < 0, -tilted, tilted)
    return mi.Normal3f(dr.select(dr.isfinite(dr.sum(tilted)), tilted, n))


def _value(value: Any, si: Any, active: Any) -> Any:
    return mi.Spectrum(value.tolist()) if isinstance(value, np.ndarray) else value.eval(si, active)


def _colour_or_texture(properties: Any, name: str) -> Any:
    texture = properties.get_unbounded_texture(name)
    if texture.is_spatially_varying():
        return texture
    return np.ravel(np.array(texture.eval(dr.zeros(mi.SurfaceInteraction3f)), dtype=np.float64))


def _registry_id(bsdf: Any) -> int:
    return int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))[0])


def _require(holds: bool, value: str, remedy: str) -> None:
    if not holds:
        raise InputError(f"{PLUGIN}: {value}: {remedy}")
