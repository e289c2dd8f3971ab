"""Light as a camera at an angle sees it, walked apart from the tables: what intervals of camera slices are tried on.

Every collision of these walks sends its share towards the camera (`rig.sim.peel_off`); each seed is a light of its own.
Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bssrdf.rig import SampleMedium, SeenLight, seen_light
from bssrdf.session.records import ChannelSlice, Slice

Floats = NDArray[np.float64]

MEDIA = {
    "Wholemilk R": SampleMedium(0.0011, 2.55, 1.3),
    "Ketchup R": SampleMedium(0.061, 0.18, 1.3),
    "Skin1 G, g 0.8": SampleMedium(0.17, 0.88, 1.3, 0.8),
    "Marble G, g 0.8": SampleMedium(0.0041, 2.62, 1.5, 0.8),
}
ANGLES_DEG = (0.0, 30.0, 45.0, 60.0)
NEAREST_MFP, FARTHEST_MFP = 0.3, 24.0
FAINTEST = 1e-5
"""Of the nearest ring: fainter ones are left out."""
PHOTONS = 60_000
"""Of a walk: about 2 % of noise in a ring, for one to ten seconds."""


@dataclass(frozen=True)
class CameraLight:
    """π L/Φ of incident flux in rings, one row a seed; the rings are the walk's own, so nothing is interpolated."""

    medium: SampleMedium
    view_angle_deg: float
    r_edges_mm: Floats
    """(n + 1,)"""
    across: Floats
    """(seeds, n) [1/mm²]: at a right angle to the camera's plane of view, as a thin slice across the view."""
    around: Floats
    """(seeds, n) [1/mm²]: the mean over all azimuths."""
    total: Floats
    """(seeds,): over the whole surface."""

    @property
    def noise(self) -> Floats:
        """Relative standard error of one seed's `across`, by ring, from the spread of all."""
        return np.asarray(np.std(self.across, axis=0, ddof=1) / np.mean(self.across, axis=0))


def camera_light(
    medium: SampleMedium, view_angle_deg: float, seeds: range | tuple[int, ...], photons: int = PHOTONS
) -> CameraLight:
    """The light of each seed, kept in the user's cache."""
    lights = [seen_light(medium, view_angle_deg, photons=photons, seed=seed, anew=True) for seed in seeds]
    edges = lights[0].r_edges_mm
    sigma_tp = medium.sigma_a + medium.sigma_sp
    first, last = np.searchsorted(edges * sigma_tp, (NEAREST_MFP, FARTHEST_MFP))
    rings = slice(int(first), int(last) - 1)
    across, around = (np.stack([part(light)[rings] for light in lights]) for part in (_across, _around))
    mean = around.mean(axis=0)
    bright = int(np.argmax(np.append(mean < FAINTEST * mean[0], True)))
    return CameraLight(
        medium,
        view_angle_deg,
        edges[rings.start : rings.start + bright + 1],
        across[:, :bright],
        around[:, :bright],
        np.array([light.total for light in lights]),
    )


def camera_slices(light: CameraLight, noise: float, total_noise: float, seed: int) -> list[Slice]:
    """A slice across the view from each seed's light, with fresh noise of that relative size; stated is all of it."""
    rng = np.random.default_rng(seed)
    lo, hi = light.r_edges_mm[:-1], light.r_edges_mm[1:]
    walk = light.noise
    walk_total = float(np.std(light.total, ddof=1))
    pieces = []
    for across, total in zip(light.across, light.total, strict=True):
        noisy = across * (1 + noise * rng.standard_normal(across.size))
        part = ChannelSlice((lo + hi) / 2, noisy, np.hypot(noise, walk) * across, lo, hi)
        pieces.append(
            Slice(
                channels={"G": part},
                eta=light.medium.eta,
                g=light.medium.g,
                flux="incident",
                exit="fresnel",
                view_angle_deg=light.view_angle_deg,
                total_r={"G": float(total * (1 + total_noise * rng.standard_normal()))},
                total_r_sd={"G": float(np.hypot(total_noise * total, walk_total))},
            )
        )
    return pieces


def _around(light: SeenLight) -> Floats:
    """Means over rings and azimuths; light scattered once lies on the line towards the camera, and counts in them."""
    line = 0.0 if light.line_beyond is None else light.line_beyond
    return np.asarray(-np.diff(light.beyond + line) / (np.pi * np.diff(light.r_edges_mm**2)))


def _across(light: SeenLight) -> Floats:
    """Means over rings at a right angle to the plane of view, where no light scattered once leaves."""
    multiple = -np.diff(light.beyond) / (np.pi * np.diff(light.r_edges_mm**2))
    if light.harmonics is None:
        return np.asarray(multiple)
    order = np.arange(1, len(light.harmonics) + 1)
    return np.asarray(multiple * (1 + np.cos(order * np.pi / 2) @ light.harmonics))
