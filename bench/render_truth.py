"""What pictures of the bench should show, known without rendering them."""

from __future__ import annotations

import math

import numpy as np

from bssrdf.render import RenderMaterial
from bssrdf.transport import dipole, first_order_total, scoped_x64, table_model
from bssrdf.transport.dipole import Medium
from bssrdf.transport.fresnel import exit_norm, fresnel_r


@scoped_x64
def sky_radiance(material: RenderMaterial, *, paper: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Radiance along the normal of a half space under an even sky of radiance 1: the sum of the terms, and the truth.

    By reciprocity it is the specular Fr(0) and, of the Ft(0) that enters along the normal, the share that comes out.
    The `paper`'s exit lobe leaves the 1/C out of the diffusion term.
    """
    mirror = float(fresnel_r(material.eta, 1.0))
    scale = float(exit_norm(material.eta)) if paper else 1.0
    model = table_model(material.eta, material.g)
    terms, truth = [], []
    for a, sp, s in zip(material.sigma_a, material.sigma_sp, material.sigma_s, strict=True):
        medium = Medium(a, sp, material.eta)
        single = float(first_order_total(s, a, material.g, material.eta))
        terms.append(mirror + (1 - mirror) * (scale * float(dipole.total_r(medium)) + single))
        truth.append(mirror + (1 - mirror) * float(model.total(medium)))
    return np.array(terms), np.array(truth)


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
