"""What pictures of the bench should show, known without rendering them."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np

from bssrdf.render import RenderMaterial
from bssrdf.transport import scoped_x64, table_model
from bssrdf.transport.dipole import Medium
from bssrdf.transport.fresnel import fresnel_r

_RINGS = 4000
_FARTHEST = 190.0
"""Radius [mfp′] up to which R_d is added up: the table ends at 200."""


def media(material: RenderMaterial) -> list[Medium]:
    """By channel."""
    return [Medium(a, sp, material.eta) for a, sp in zip(material.sigma_a, material.sigma_sp, strict=True)]


@scoped_x64
def sky_radiance(material: RenderMaterial) -> np.ndarray:
    """Radiance along the normal of a half space under an even sky of radiance 1.

    By reciprocity it is the specular Fr(0) and, of the Ft(0) that enters along the normal, the share that comes out.
    """
    mirror = float(fresnel_r(material.eta, 1.0))
    model = table_model(material.eta, material.g)
    return np.array([mirror + (1 - mirror) * float(model.total(medium)) for medium in media(material)])


@scoped_x64
def edge_radiance(material: RenderMaterial, x_mm: np.ndarray) -> np.ndarray:
    """Radiance along the normal (n, 3) of a half space that light along the normal, of irradiance 1, reaches at x > 0.

    Of the light that entered on a ring of radius r, the share arccos(−x/r)/π lies on the lit side.
    """
    model = table_model(material.eta, material.g)
    entering = 1 - float(fresnel_r(material.eta, 1.0))
    found = []
    for medium in media(material):
        path = 1 / float(medium.sigma_tp)
        r = path * np.geomspace(1e-4, _FARTHEST, _RINGS)
        ring = 2 * np.pi * r**2 * np.asarray(model.rd(medium, jnp.asarray(r)))  # per logarithm of r
        ring *= float(model.total(medium)) / np.trapezoid(ring, np.log(r))
        lit = np.arccos(np.clip(-np.asarray(x_mm)[:, None] / r, -1, 1)) / np.pi
        factor = float(model.total_radiance_factor(medium, 1.0))
        found.append(entering * np.trapezoid(ring * lit, np.log(r), axis=1) * factor / np.pi)
    return np.stack(found, axis=1)


def cut_share(albedo: float, depth: int) -> float:
    """What paths beyond `depth` scatterings carry, over what those between `depth`/2 and `depth` do.

    The light that leaves a half space after n scatterings falls as n^(−3/2) albedo^n; from a smaller body it falls
    faster, so that there this is an upper bound.
    """
    beyond, before = _tail(albedo, depth), _tail(albedo, depth / 2)
    return beyond / (before - beyond) if before > beyond else 0.0


def _tail(albedo: float, depth: float) -> float:
    """∫ n^(−3/2) albedo^n dn from `depth` on."""
    decay = -math.log(albedo)
    x = decay * depth
    return 2 * (math.exp(-x) / math.sqrt(depth) - math.sqrt(math.pi * decay) * math.erfc(math.sqrt(x)))
