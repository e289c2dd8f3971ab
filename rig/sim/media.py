"""What can lie under the simulated beam: media by channel, the published materials, and the white tile.

Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.holding import BLACK
from bssrdf.session.records import Material
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
    thickness_mm: float | None = None
    """Depth of a slab; a half space without it."""
    back: float = 0.0
    """Share of the light that a face under the slab, in optical contact, sends back diffusely; 0 is an ideal black."""


@dataclass(frozen=True)
class SimSample:
    """What can lie under the beam: a half space or a slab, by its coefficients in each channel."""

    name: str
    media: dict[str, SampleMedium]
    spread_aspect: float = 1.0
    """How much farther light spreads across the view than along it: fibres."""

    def slab(self, thickness_mm: float, back: float) -> SimSample:
        """As much of it, on a back of this diffuse reflectance."""
        slabs = {name: replace(each, thickness_mm=thickness_mm, back=back) for name, each in self.media.items()}
        return replace(self, media=slabs)


def published_sample(name: str) -> SimSample:
    """A line of the published table, isotropic scattering; where it prints σa = 0, the tile's loss instead."""
    material = find_material(name)
    media = {
        channel: SampleMedium(sigma_a or TILE_ALBEDO_LOSS * sigma_sp, sigma_sp, material.eta)
        for channel, sigma_a, sigma_sp in zip(CHANNELS, material.sigma_a_per_mm, material.sigma_sp_per_mm, strict=True)
    }
    return SimSample(material.name, media)


def sample_of(material: Material) -> SimSample:
    """The published material, held as `[material]` says; InputError where the simulated bench cannot hold it so."""
    sample, depth, back = published_sample(material.name), material.thickness_mm, material.backing
    known = back == "black" or isinstance(back, int | float)
    if material.width_mm is not None or material.cover != "none" or (depth is not None and not known):
        raise InputError(
            'the simulated bench films half spaces, and slabs without a cover on backing = "black" or a diffuse '
            "reflectance; mend [material]"
        )
    if depth is None or isinstance(back, str | None):
        return sample if depth is None else sample.slab(depth, BLACK)
    return sample.slab(depth, back)


def white_tile() -> SimSample:
    """The reference: a thick Spectralon tile, which spreads the spot by its own scattering."""
    return published_sample("Spectralon")


def unit_medium(medium: SampleMedium) -> SampleMedium:
    """The medium of the same albedo whose σt′ is 1, as deep in mean free paths 1/σt′."""
    sigma_tp = medium.sigma_a + medium.sigma_sp
    loss = float(f"{medium.sigma_a / sigma_tp:.9g}")
    depth = None if medium.thickness_mm is None else float(f"{medium.thickness_mm * sigma_tp:.9g}")
    return SampleMedium(loss, 1 - loss, medium.eta, medium.g, depth, medium.back)


def r_edges_mfp() -> Array:
    """Edges of the radial bins in mean free paths 1/σt′, from 0."""
    lo, hi = np.log(_REACH_MFP)
    return np.concatenate([[0.0], np.exp(np.linspace(lo, hi, round(_BINS_PER_E_FOLD * (hi - lo))))])
