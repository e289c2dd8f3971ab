"""What a volume renderer loses that ends paths after so many scatterings."""

from __future__ import annotations

import math

import numpy as np

from bssrdf.export.spread import WalkMedium
from bssrdf.transport import half_space

NEARLY_WHITE = 1e-6
"""1 − albedo at which R has its square-root law."""


def lost_share(medium: WalkMedium, depth: int) -> float:
    """Of R, what comes out after more than `depth` scatterings.

    Where R = 1 − c √(1 − α) near α = 1, the order n carries c/(2 √π) n^(−3/2) αⁿ.
    """
    c = _slope(medium.g, medium.eta) * math.sqrt(1 / math.pi)
    decay = math.log1p(medium.sigma_a / medium.sigma_s)
    x = decay * depth
    tail = c / math.sqrt(depth) * (math.exp(-x) - math.sqrt(math.pi * x) * math.erfc(math.sqrt(x)))
    return tail / medium.total


def depth_for(media: tuple[WalkMedium, ...], share: float, most: int) -> int:
    """The least power of two at which none of the media loses more than this share, or `most`."""
    depth = 1024
    while depth < most and max(lost_share(medium, depth) for medium in media) > share:
        depth *= 2
    return depth


def _slope(g: float, eta: float) -> float:
    white = half_space(1 - NEARLY_WHITE, g, eta, np.array([1.0])).total
    return (1 - white) / math.sqrt(NEARLY_WHITE)
