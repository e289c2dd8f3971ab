"""Do intervals hold on light as a camera at an angle sees it? `python -m bssrdf.bench.camera_light` tries, and counts.

The light is walked apart from the tables (`camera_walk`); each seed is a light of its own.
Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.camera_walk import camera_walk
from bssrdf.fit import FitOptions, fit_slices
from bssrdf.rig import SampleMedium
from bssrdf.session.records import ChannelFit, ChannelSlice, Slice
from bssrdf.transport.exit_radiance import transmittance
from bssrdf.transport.photon import stream_states

Floats = NDArray[np.float64]


class Tried(NamedTuple):
    """A medium, and how many photons a seed takes for 1 to 2 % of noise in a ring."""

    medium: SampleMedium
    photons: int


MEDIA = {
    "Whole milk R": Tried(SampleMedium(0.0011, 2.55, 1.3), 60_000),
    "Ketchup R": Tried(SampleMedium(0.061, 0.18, 1.3), 500_000),
    "Skin1 G, g 0.8": Tried(SampleMedium(0.17, 0.88, 1.3, 0.8), 400_000),
    "Marble G, g 0.8": Tried(SampleMedium(0.0041, 2.62, 1.5, 0.8), 100_000),
}
ANGLES_DEG = (0.0, 30.0, 45.0, 60.0)
SEEDS = 24
NOISE, TOTAL_NOISE = 0.01, 0.002
KEYS = ("sigma_sp", "sigma_a")
RINGS = 54
NEAREST_MFP, FARTHEST_MFP = 0.3, 24.0
FAINTEST = 1e-5
"""Of the nearest ring: fainter ones are left out."""
NOISIEST = 0.25
"""Relative standard error of one seed, likewise."""


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
    """(seeds, n) [1/mm²]: light scattered twice or more, the mean over all azimuths."""
    total: Floats
    """(seeds,): over the whole surface."""

    @property
    def noise(self) -> Floats:
        """Relative standard error of one seed's `across`, by ring, from the spread of all."""
        return np.asarray(np.std(self.across, axis=0, ddof=1) / np.mean(self.across, axis=0))


def camera_lights(
    medium: SampleMedium, angles_deg: Sequence[float], seeds: Iterable[int], photons: int
) -> list[CameraLight]:
    """The light towards each angle, by seed."""
    sigma_s = medium.sigma_sp / (1 - medium.g)
    sigma_t, sigma_tp = sigma_s + medium.sigma_a, medium.sigma_sp + medium.sigma_a
    edges_mm = np.geomspace(NEAREST_MFP, FARTHEST_MFP, RINGS + 1) / sigma_tp
    cosines = np.cos(np.radians(angles_deg))
    per_e_fold = RINGS / np.log(FARTHEST_MFP / NEAREST_MFP)
    walk = partial(
        _walked, photons, (sigma_s / sigma_t, medium.g, medium.eta, cosines), edges_mm[0] * sigma_t, per_e_fold
    )
    with ThreadPoolExecutor() as pool:
        across, around, total = (np.stack(each, axis=1) for each in zip(*pool.map(walk, seeds), strict=True))
    flux = np.pi * float(transmittance(medium.eta, np.array(1.0))) / photons
    per_area = flux / (np.pi * np.diff(edges_mm**2))
    return [
        bright(CameraLight(medium, angle, edges_mm, a[:, 1:] * per_area, b[:, 1:] * per_area, flux * t))
        for angle, a, b, t in zip(angles_deg, across, around, total, strict=True)
    ]


def _walked(
    photons: int, medium: tuple[float, float, float, Floats], r_first: float, per_e_fold: float, seed: int
) -> tuple[Floats, Floats, Floats]:
    """Scores of one seed: (angles, rings) twice, and (angles,)."""
    [state] = stream_states(seed, 1)
    across, around = (np.zeros((medium[-1].size, RINGS + 1)) for _ in range(2))
    total = np.zeros(medium[-1].size)
    camera_walk(photons, state, *medium, r_first, per_e_fold, across, around, total)
    return across, around, total


def bright(light: CameraLight) -> CameraLight:
    """Without the far rings that are too faint or too noisy."""
    mean, across = light.around.mean(axis=0), light.across.mean(axis=0)
    noise = light.across.std(axis=0) / np.where(across > 0, across, np.nan)
    told = (mean >= FAINTEST * mean[0]) & ((noise < NOISIEST) | (np.arange(noise.size) <= np.nanargmin(noise)))
    last = int(np.argmin(np.append(told, False)))
    return CameraLight(
        light.medium,
        light.view_angle_deg,
        light.r_edges_mm[: last + 1],
        light.across[:, :last],
        light.around[:, :last],
        light.total,
    )


def camera_slices(light: CameraLight, noise: float, total_noise: float, seed: int) -> list[Slice]:
    """A slice across the view from each seed's light, with fresh noise of that relative size; stated is all of it.

    One photon lights many rings, and R with them: in milk R and the curve of a walk correlate by 0.9. A slice states
    errors of each ring for itself, so the seeds exchange rings, each for itself, and R.
    """
    rng = np.random.default_rng(seed)
    lo, hi = light.r_edges_mm[:-1], light.r_edges_mm[1:]
    exchanged = rng.permuted(light.across, axis=0), rng.permuted(light.total)
    walk = light.noise
    walk_total = float(np.std(light.total, ddof=1))
    pieces = []
    for across, total in zip(*exchanged, strict=True):
        noisy = across * (1 + noise * rng.standard_normal(across.size))
        part = ChannelSlice((lo + hi) / 2, noisy, np.hypot(noise, walk) * light.across.mean(axis=0), lo, hi)
        pieces.append(
            Slice(
                channels={"G": part},
                eta=light.medium.eta,
                g=light.medium.g,
                flux="incident",
                exit="fresnel",
                view_angle_deg=light.view_angle_deg,
                total_r={"G": float(total * (1 + total_noise * rng.standard_normal()))},
                total_r_sd={"G": float(np.hypot(total_noise * np.mean(light.total), walk_total))},
            )
        )
    return pieces


class CameraScore(NamedTuple):
    """What the fits of one medium and angle come to; pairs are (σs′, σa)."""

    name: str
    angle_deg: float
    inside: tuple[int, int]
    """95 % intervals that hold the truth."""
    fits: int
    z: tuple[float, float]
    """The largest distance from the truth in standard deviations."""
    rel_sd: tuple[float, float]
    """Median."""
    exit_law: tuple[float, float]
    """The exit law's median share of the variance."""


def score(name: str, light: CameraLight, fits: Sequence[ChannelFit]) -> CameraScore:
    """How often, and how nearly, the intervals hold what made the light."""
    inside, furthest, rel_sd, exit_law = zip(*(_score_of(key, light, fits) for key in KEYS), strict=True)
    return CameraScore(name, light.view_angle_deg, inside, len(fits), furthest, rel_sd, exit_law)


def _score_of(key: str, light: CameraLight, fits: Sequence[ChannelFit]) -> tuple[int, float, float, float]:
    ends = np.log([getattr(fit, f"{key}_interval95_per_mm") for fit in fits])
    sd = (ends[:, 1] - ends[:, 0]) / (2 * 1.96)
    z = np.abs(ends.mean(axis=1) - np.log(getattr(light.medium, key))) / sd
    shares = [fit.budget.get(key, {}).get("exit_law", 0.0) for fit in fits]
    return int((z <= 1.96).sum()), float(np.nanmax(z)), float(np.nanmedian(sd)), float(np.median(shares))


def table(outcomes: Sequence[CameraScore]) -> str:
    """A line for each medium and angle, and what they come to, as Markdown."""
    lines = [
        "| medium | view | hold σs′, σa | furthest, sd | sd σs′, σa | exit law |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {o.name} | {o.angle_deg:g}° | {o.inside[0]}, {o.inside[1]} of {o.fits} | {o.z[0]:.1f}, {o.z[1]:.1f} "
        f"| {100 * o.rel_sd[0]:.2f}, {100 * o.rel_sd[1]:.2f} % | {o.exit_law[0]:.2f}, {o.exit_law[1]:.2f} |"
        for o in outcomes
    ]
    fits = sum(o.fits for o in outcomes)
    for k, symbol in enumerate(("σs′", "σa")):
        inside, furthest = sum(o.inside[k] for o in outcomes), max(o.z[k] for o in outcomes)
        lines.append(f"\n{symbol}: {inside} of {fits} intervals hold, the furthest is {furthest:.1f} sd off")
    return "\n".join(lines)


def main() -> None:
    """Walk, fit and print."""
    outcomes = []
    for number, (name, tried) in enumerate(MEDIA.items()):
        for angle in ANGLES_DEG:
            print(f"{name}, {angle:g}°: {SEEDS} x {tried.photons} photons", file=sys.stderr)
            first = 1000 * number + 10 * int(angle)  # walks of its own: what one is off by is counted once
            [light] = camera_lights(tried.medium, (angle,), range(first, first + SEEDS), tried.photons)
            pieces = camera_slices(light, NOISE, TOTAL_NOISE, seed=first)
            fits = [fit["G"] for fit in fit_slices(pieces, FitOptions(model="mc"))]
            outcomes.append(score(name, light, fits))
    print(table(outcomes))


if __name__ == "__main__":
    main()
