"""The boundary between air and medium for light: refraction, and the transmittance of a rough surface."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

TABLE_SIZE = 128
"""Entries of a transmittance table, uniform in the outside cosine from 0 to 1."""


def transmittance_table(eta: float, alpha: float) -> NDArray[np.float64]:
    """Share of the light from an outside direction that a GGX surface of roughness `alpha` lets in."""
    within = 1 / TABLE_SIZE  # Mitsuba's quadrature fails at both ends
    mu = mi.Float(np.clip(np.linspace(0, 1, TABLE_SIZE), within, 1 - within**2).astype(np.float32))
    if alpha == 0:
        return 1 - np.array(mi.fresnel(mu, eta)[0], np.float64)
    toward = mi.Vector3f(dr.sqrt(dr.maximum(1 - mu * mu, 0)), 0, mu)
    return 1 - np.array(mi.eval_reflectance(mi.MicrofacetType.GGX, alpha, alpha, toward, eta), np.float64)


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
