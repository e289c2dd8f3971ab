"""The translucent surface: the BSDF plugin `bssrdf_medium`, what it may say, and its coefficients.

Coefficients in 1/scene unit. Each of sigma_a, sigma_sp, reflectance and mean_free_path is a number, a colour or a
texture; everything else is one number for a surface.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.render.interface import transmittance_table
from bssrdf.render.kernel import cosines, kernels
from bssrdf.transport import nearest

PLUGIN = "bssrdf_medium"
PAIRS = (("sigma_a", "sigma_sp"), ("reflectance", "mean_free_path"))
NUMBERS = {"scale": 1.0, "g": 0.0, "alpha": 0.0, "bump_scale": 1.0}

INVERSION_SIZE = 1024
_MEDIA = 33
"""Evenly spaced in q, between which R is interpolated."""
_LOOKS = 256
"""Places looked up in a texture along each side."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MediumBoundary:
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
        return any(_is_texture(value) for value in self.pair.values())


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

        @functools.cached_property
        def _numbers(self) -> tuple[Any, Any]:
            """η and R/(πC), opaque, so that one kernel serves all media."""
            mu = cosines()
            norm = 2 * np.trapezoid(transmittance_table(self.surface.eta, 0.0) * mu, mu)
            over_lobes = mi.Spectrum((total_reflectance(self.surface) / (math.pi * norm)).tolist())
            eta = mi.Float(self.surface.eta)
            dr.make_opaque(eta, over_lobes)
            return eta, over_lobes

        def eval(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            eta, over_lobes = self._numbers
            cos_i, cos_o = dr.abs(wo.z), dr.abs(si.wi.z)
            lobe = (1 - mi.fresnel(cos_i, eta)[0]) * (1 - mi.fresnel(cos_o, eta)[0])
            return dr.select(active & (wo.z * si.wi.z > 0), over_lobes * lobe * cos_i, 0)

        def pdf(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            return dr.select(active & (wo.z * si.wi.z > 0), dr.abs(wo.z) / math.pi, 0)

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            return self.eval(context, si, wo, active), self.pdf(context, si, wo, active)

        def traverse(self, callback: Any) -> None:
            pass

        def to_string(self) -> str:
            return f"BssrdfMedium[{self.surface}]"

    mi.register_bsdf(PLUGIN, BssrdfMedium)


def read_surface(properties: Any) -> MediumBoundary:
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
        _require(_is_texture(value) or _is_amount(value), f"{name} = {value}", "give finite values of at least 0")
    surface = MediumBoundary(
        eta,
        numbers["g"],
        numbers["alpha"],
        numbers["scale"],
        pair,
        properties.get_unbounded_texture("bump") if "bump" in properties else None,
        numbers["bump_scale"],
    )
    empty = not surface.textured and not np.all(coefficients(surface).sum(axis=0) > 0)
    _require(not empty, "the medium is empty", "give sigma_a + sigma_sp above 0")
    return surface


def coefficients(surface: MediumBoundary) -> Floats:
    """sigma_a and sigma_sp of an untextured surface in 1/scene unit, shape (2, channels)."""
    first, second = surface.pair.values()
    if "sigma_a" in surface.pair:
        return np.stack(np.broadcast_arrays(first, second)) * surface.scale
    ratio = np.interp(first, np.linspace(0, 1, INVERSION_SIZE), inversion_table(surface.eta, surface.g)) ** 2
    return np.stack([ratio, 1 - ratio]) * surface.scale / np.maximum(second, 1e-20)


def extinction(surface: MediumBoundary) -> Floats:
    sigma_a, sigma_sp = coefficients(surface)
    return sigma_a + sigma_sp / (1 - surface.g)


def total_reflectance(surface: MediumBoundary) -> Floats:
    """R of the mean coefficients by the Monte Carlo table, shape (channels,)."""
    sigma_a, sigma_sp = mean_coefficients(surface)
    albedo, at_hand = sigma_sp / (sigma_a + sigma_sp), nearest(surface.eta, surface.g)
    table = kernels(at_hand.eta, at_hand.g, np.unique(albedo))
    return np.asarray(table.total[np.searchsorted(table.albedo, albedo)])


def mean_coefficients(surface: MediumBoundary) -> Floats:
    """sigma_a and sigma_sp, or those of the textures' means, shape (2, channels)."""
    n = dr.size_v(mi.Spectrum)
    means = {
        name: value if not _is_texture(value) else np.full(n, float(np.ravel(np.array(value.mean()))[0]))
        for name, value in surface.pair.items()
    }
    return coefficients(replace(surface, pair=means))


def albedo_range(surface: MediumBoundary) -> tuple[float, float]:
    """The least and the largest reduced albedo on a textured surface, as seen at many places of it."""
    looked = {name: _looked_up(value) for name, value in surface.pair.items()}
    sigma_a, sigma_sp = coefficients(replace(surface, pair=looked))
    albedo = sigma_sp / np.maximum(sigma_a + sigma_sp, 1e-30)
    return float(albedo.min()), float(albedo.max())


def _looked_up(value: Any) -> Floats:
    """Values of a texture all over it, (channels, places), or a colour."""
    if not _is_texture(value):
        return np.asarray(value)[:, None]
    u, v = np.meshgrid(*[(np.arange(_LOOKS, dtype=np.float32) + 0.5) / _LOOKS] * 2)
    si = dr.zeros(mi.SurfaceInteraction3f, u.size)
    si.uv = mi.Point2f(u.ravel(), v.ravel())
    return np.array(mi.Spectrum(value.eval(si)), np.float64)


@functools.cache
def inversion_table(eta: float, g: float) -> Floats:
    """q = √(1 − α′) over R of the Monte Carlo table, on a uniform grid from 0 to 1."""
    from scipy.interpolate import PchipInterpolator

    at_hand = nearest(eta, g)
    media = kernels(at_hand.eta, at_hand.g, 1 - np.linspace(1, 0, _MEDIA) ** 2)
    q_of_total = PchipInterpolator(media.total, np.sqrt(1 - media.albedo))
    return np.asarray(q_of_total(np.linspace(0, 1, INVERSION_SIZE) * media.total[-1]))


def _colour_or_texture(properties: Any, name: str) -> Any:
    texture = properties.get_unbounded_texture(name)
    if texture.is_spatially_varying():
        return texture
    return np.ravel(np.array(texture.eval(dr.zeros(mi.SurfaceInteraction3f)), dtype=np.float64))


def _is_texture(value: Any) -> bool:
    return not isinstance(value, np.ndarray)


def _is_amount(value: Floats) -> bool:
    return bool(np.all(np.isfinite(value)) and np.all(value >= 0))


def _require(holds: bool, value: str, remedy: str) -> None:
    if not holds:
        raise InputError(f"{PLUGIN}: {value}: {remedy}")
