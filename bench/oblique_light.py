"""Do intervals hold for beams at an angle? `python -m bssrdf.bench.oblique_light` walks, makes the tables, and counts.

The light is walked apart from the tables (`oblique_walk`), towards a camera at the normal and on either side of the
beam; slices across the beam's plane and means over all azimuths. A table that is not at hand takes 300 processor
seconds. Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.camera_light import (
    FARTHEST_MFP,
    NEAREST_MFP,
    NOISE,
    RINGS,
    TOTAL_NOISE,
    CameraLight,
    Tried,
    bright,
    camera_slices,
    score,
    table,
)
from bssrdf.bench.oblique_walk import oblique_walk
from bssrdf.fit import FitOptions, fit_slices
from bssrdf.rig import SampleMedium
from bssrdf.session.records import Slice
from bssrdf.transport.exit_radiance import transmittance
from bssrdf.transport.photon import stream_states

Floats = NDArray[np.float64]

MEDIA = {
    "g 0.8": Tried(SampleMedium(0.02, 1.0, 1.4, 0.8), 380_000),
    "g 0": Tried(SampleMedium(0.1, 1.0, 1.33, 0.0), 250_000),
}
BEAMS_DEG = (20.0, 45.0, 60.0)
VIEWS_DEG = (0.0, 30.0, -30.0)
"""Positive on the side that the beam runs to."""
SEEDS = 24


def oblique_lights(
    medium: SampleMedium, beam_deg: float, views_deg: Sequence[float], seeds: Iterable[int], photons: int
) -> list[CameraLight]:
    """The light towards each view, by seed; `across` is at a right angle to the beam's plane."""
    sigma_s = medium.sigma_sp / (1 - medium.g)
    sigma_t, sigma_tp = sigma_s + medium.sigma_a, medium.sigma_sp + medium.sigma_a
    edges_mm = np.geomspace(NEAREST_MFP, FARTHEST_MFP, RINGS + 1) / sigma_tp
    walk = partial(
        _walked,
        photons,
        (sigma_s / sigma_t, medium.g, medium.eta, math.sin(math.radians(beam_deg))),
        np.sin(np.radians(views_deg)),
        edges_mm[0] * sigma_t,
    )
    with ThreadPoolExecutor() as pool:
        across, around, total = (np.stack(each, axis=1) for each in zip(*pool.map(walk, seeds), strict=True))
    flux = np.pi * float(transmittance(medium.eta, np.cos(np.radians(beam_deg)))) / photons
    per_area = flux / (np.pi * np.diff(edges_mm**2))
    return [
        bright(CameraLight(medium, abs(view), edges_mm, a[:, 1:] * per_area, b[:, 1:] * per_area, flux * t))
        for view, a, b, t in zip(views_deg, across, around, total, strict=True)
    ]


def _walked(
    photons: int, medium: tuple[float, float, float, float], sines: Floats, r_first: float, seed: int
) -> tuple[Floats, Floats, Floats]:
    """Scores of one seed: (views, rings) twice, and (views,)."""
    [state] = stream_states(seed, 1)
    across, around = (np.zeros((sines.size, RINGS + 1)) for _ in range(2))
    total = np.zeros(sines.size)
    per_e_fold = RINGS / math.log(FARTHEST_MFP / NEAREST_MFP)
    oblique_walk(photons, state, *medium, sines, r_first, per_e_fold, across, around, total)
    return across, around, total


def oblique_slices(
    light: CameraLight, beam_deg: float, azimuth: Literal["perpendicular", "mean"], seed: int
) -> list[Slice]:
    """Slices across the beam's plane, or means over all azimuths."""
    seen = light if azimuth == "perpendicular" else replace(light, across=light.around)
    return [
        replace(piece, incidence_deg=beam_deg, azimuth=azimuth)
        for piece in camera_slices(seen, NOISE, TOTAL_NOISE, seed)
    ]


def main() -> None:
    """Walk, fit and print."""
    outcomes = []
    for number, (name, tried) in enumerate(MEDIA.items()):
        for beam in BEAMS_DEG:
            print(f"{name}, beam at {beam:g}°: {SEEDS} x {tried.photons} photons", file=sys.stderr)
            first = 10_000 + 1000 * number + 10 * int(beam)
            lights = oblique_lights(tried.medium, beam, VIEWS_DEG, range(first, first + SEEDS), tried.photons)
            for view, light in zip(VIEWS_DEG, lights, strict=True):
                for azimuth in ("perpendicular", "mean"):
                    pieces = oblique_slices(light, beam, azimuth, seed=first)
                    fits = [fit["G"] for fit in fit_slices(pieces, FitOptions(model="mc"))]
                    outcomes.append(score(f"{name}, {beam:g}°, {azimuth}", replace(light, view_angle_deg=view), fits))
    print(table(outcomes))


if __name__ == "__main__":
    main()
