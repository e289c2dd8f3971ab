"""Samples for the simulated bench: the published materials, and the white tile."""

from __future__ import annotations

from bssrdf.rig.sim.light import Sample, SampleMedium
from bssrdf.transport.materials import CHANNELS, find_material

TILE_ALBEDO_LOSS = 4.6e-6
"""σa/σs′ of the tile. Its total reflectance is 0.99 then; the published 0.00 would keep every photon for ever."""


def published_sample(name: str) -> Sample:
    """A line of the published table, isotropic scattering; where it prints σa = 0, the tile's loss instead."""
    material = find_material(name)
    media = {
        channel: SampleMedium(sigma_a or TILE_ALBEDO_LOSS * sigma_sp, sigma_sp, material.eta)
        for channel, sigma_a, sigma_sp in zip(CHANNELS, material.sigma_a_per_mm, material.sigma_sp_per_mm, strict=True)
    }
    return Sample(material.name, media)


def white_tile() -> Sample:
    """The reference: a thick Spectralon tile, which spreads the spot by its own scattering."""
    return published_sample("Spectralon")
