"""The boundary between air and medium for light: refraction, and the transmittance of a rough surface."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from bssrdf.render.kernel import COSINES, cosines

_SLOPES = 24
"""Slopes across each way in the average over a rough surface."""


def transmittance_table(eta: float, alpha: float) -> NDArray[np.float64]:
    """Share of the light from an outside direction that is not reflected by a GGX surface of roughness `alpha`."""
    mu = cosines().astype(np.float32)
    if alpha == 0:
        return 1 - np.array(mi.fresnel(mi.Float(mu), eta)[0], np.float64)
    u = (np.arange(_SLOPES, dtype=np.float32) + 0.5) / _SLOPES
    mus, first, second = (mi.Float(grid.ravel()) for grid in np.meshgrid(mu, u, u, indexing="ij"))
    toward = mi.Vector3f(dr.sqrt(dr.maximum(1 - mus * mus, 0)), 0, mus)
    slopes = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
    facet, _ = slopes.sample(toward, mi.Point2f(first, second))
    cosine = dr.dot(toward, facet)
    away = 2 * cosine * mi.Vector3f(facet) - toward
    reflected = dr.select(away.z > 0, mi.fresnel(cosine, eta)[0] * slopes.smith_g1(away, facet), 0)
    return 1 - np.array(reflected, np.float64).reshape(COSINES, -1).mean(axis=1)


def refracted_cosine(cos_theta: Any, eta: Any) -> Any:
    """Cosine inside, for the cosine outside."""
    return dr.sqrt(dr.maximum((eta - 1) * (eta + 1) + dr.square(cos_theta), 0)) / eta


def refract_in(direction: Any, normal: Any, eta: Any) -> Any:
    """The direction inside, still on the outer side of the surface, that belongs to an outside one: Snell's law."""
    cos_theta = dr.dot(direction, normal)
    return (direction - normal * cos_theta) / eta + normal * refracted_cosine(cos_theta, eta)


def refract_out(direction: Any, normal: Any, eta: Any) -> tuple[Any, Any]:
    """The outside direction for one inside, and its cosine, which is 0 under total reflection."""
    cos_inside = dr.dot(direction, normal)
    cos2 = 1 - eta * eta * (1 - cos_inside * cos_inside)
    cos_theta = dr.sqrt(dr.maximum(cos2, 0))
    return dr.normalize((direction - normal * cos_inside) * eta + normal * cos_theta), cos_theta


def phase(g: Any, cos_theta: Any) -> Any:
    """Henyey and Greenstein's phase function; `cos_theta` is 1 straight ahead."""
    base = dr.maximum(1 + g * g - 2 * g * cos_theta, 1e-12)
    return (1 - g * g) / (4 * dr.pi) / (base * dr.sqrt(base))


def sample_phase(g: Any, ahead: Any, u: Any) -> Any:
    """A direction about `ahead`, after the phase function."""
    isotropic = dr.abs(g) < 1e-3
    safe = dr.select(isotropic, 1, g)
    t = (1 - g * g) / (1 - g + 2 * g * u.x)
    cos_theta = dr.select(isotropic, 2 * u.x - 1, (1 + g * g - t * t) / (2 * safe))
    cos_theta = dr.clip(cos_theta, -1, 1)
    sin_theta = dr.sqrt(dr.maximum(1 - cos_theta * cos_theta, 0))
    sin_phi, cos_phi = dr.sincos(2 * dr.pi * u.y)
    return mi.Frame3f(ahead).to_world(mi.Vector3f(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta))
