"""What can lie under the simulated beam: media by channel, the published materials, and the white tile.

Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bssrdf.transport import CHANNELS, find_material

Array = NDArray[np.float64]

TILE_ALBEDO_LOSS = 4.6e-6
"""σa/σs′ of the tile. Its total reflectance is 0.99 then; the published 0.00 would keep every photon for ever."""


_BINS_PER_E_FOLD = 10
_REACH_MFP = (0.005, 2000.0)
"""Innermost and outermost edge of the radial bins above 0, in reduced mean free paths."""


@dataclass(frozen=True)
class SampleMedium:
    """One channel of a sample."""

    sigma_a: float
    sigma_sp: float
    eta: float
    g: float = 0.0


@dataclass(frozen=True)
class SimSample:
    """What can lie under the beam: a half space, by its coefficients in each channel."""

    name: str
    media: dict[str, SampleMedium]


def published_sample(name: str) -> SimSample:
    """A line of the published table, isotropic scattering; where it prints σa = 0, the tile's loss instead."""
    material = find_material(name)
    media = {
        channel: SampleMedium(sigma_a or TILE_ALBEDO_LOSS * sigma_sp, sigma_sp, material.eta)
        for channel, sigma_a, sigma_sp in zip(CHANNELS, material.sigma_a_per_mm, material.sigma_sp_per_mm, strict=True)
    }
    return SimSample(material.name, media)


def white_tile() -> SimSample:
    """The reference: a thick Spectralon tile, which spreads the spot by its own scattering."""
    return published_sample("Spectralon")


def unit_medium(medium: SampleMedium) -> SampleMedium:
    """The medium of the same albedo whose σt′ is 1."""
    loss = float(f"{medium.sigma_a / (medium.sigma_a + medium.sigma_sp):.9g}")
    return SampleMedium(loss, 1 - loss, medium.eta, medium.g)


def r_edges_mfp() -> Array:
    """Edges of the radial bins in mean free paths 1/σt′, from 0."""
    lo, hi = np.log(_REACH_MFP)
    return np.concatenate([[0.0], np.exp(np.linspace(lo, hi, round(_BINS_PER_E_FOLD * (hi - lo))))])
