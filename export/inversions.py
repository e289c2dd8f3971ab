"""Colour to albedo, as renderers' random walks read it, and back. Isotropic scattering; dimensionless."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from scipy.optimize import brentq


def van_de_hulst(albedo: float) -> float:
    """Colour whose walk has this albedo, by van de Hulst's fit of R: Blender from 5.2 on, OpenPBR's suggestion."""
    s = math.sqrt(1 - albedo)
    return (1 - s) * (1 - 0.139 * s) / (1 + 1.17 * s)


def wrenninge(albedo: float) -> float:
    """Colour whose walk has this albedo, by Wrenninge et al. 2017 at g = 0: Blender up to 5.1."""
    if albedo >= _wrenninge_albedo(1.0):
        return 1.0
    return float(brentq(lambda colour: _wrenninge_albedo(colour) - albedo, 0.0, 1.0, xtol=1e-12))


def _wrenninge_albedo(colour: float) -> float:
    blend = colour**0.25
    low = 1.8260523782 * math.atan(5.11246790344 * colour) ** 1.09686102424
    high = 0.496310210422 * math.atan(4.2350080375 * colour) ** 2.40602999408
    return (1 - blend) * low + blend * high


class ClosureRule(NamedTuple):
    """How Cycles reads its random walk."""

    version: Literal["5.1", "5.2"]
    method: str
    """Of Principled's `subsurface_method`, in the versions that know the rule."""
    radius_per_mfp: float

    def colour(self, albedo: float) -> float:
        """Base colour of a walk."""
        return van_de_hulst(albedo) if self.version == "5.2" else wrenninge(albedo)


BLENDER = (ClosureRule("5.2", "RANDOM_WALK", 1.0), ClosureRule("5.1", "RANDOM_WALK", 4 * math.pi))
"""From 5.2 on, and up to 5.1 (which later versions still have as RANDOM_WALK_LEGACY)."""
