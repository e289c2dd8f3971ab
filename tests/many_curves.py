"""Curves for tests of bulk work, as plain, as a camera's, and with every column and key."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.session.slice_csv import write_slice
from bssrdf.transport.dipole import Medium, rd, total_r
from bssrdf.transport.precision import scoped_x64

R_MM = np.linspace(1.0, 20.0, 40)


@scoped_x64
def plain(eta: float = 1.3, g: float | None = 0.0, *, sigma_a: float = 0.02, seed: int = 0) -> Slice:
    """Two channels of the dipole's light with 1 % noise."""
    noise = np.random.default_rng(seed)
    channels, totals = {}, {}
    for name, factor in (("R", 1.0), ("633nm", 1.5)):
        medium = Medium(factor * sigma_a, 1.0, eta)
        exact = np.array(rd(medium, R_MM))
        noisy = exact * (1 + 0.01 * noise.standard_normal(R_MM.size))
        channels[name], totals[name] = ChannelSlice(R_MM, noisy, 0.01 * exact), float(total_r(medium))
    return Slice(channels, eta, "entering", "hemisphere", total_r=totals, total_r_sd=dict.fromkeys(totals, 0.002), g=g)


def filmed(*, spot_mm: float = 0.25, first_mm: float = 0.4, seed: int = 0) -> Slice:
    """One channel in annuli of growing width on both sides, as `measure` writes it, blurred by a spot."""
    base = plain(1.5, 0.0, seed=seed).channels["R"]
    edges = np.geomspace(first_mm, 18, 37)
    lo, hi = np.repeat(edges[:-1], 2), np.repeat(edges[1:], 2)
    middle = (lo + hi) / 2
    light = np.exp(np.interp(middle, R_MM, np.log(np.abs(base.rd_per_mm2))))
    side = np.tile(np.array([-1, 1], np.int8), edges.size - 1)
    noise = 1 + 0.01 * np.random.default_rng(seed).standard_normal(middle.size)
    part = ChannelSlice(middle, light * noise, 0.01 * light, lo, hi, side)
    return Slice(
        {"G": part}, 1.5, "incident", "fresnel", spot_radius_mm=spot_mm, spot_radius_sd_mm=0.01, band_mm=0.5, g=0.0
    )


def rich() -> Slice:
    """A slice in which every column and many keys stand, one channel without errors."""
    sides = np.array([-1, -1, 1, 1], np.int8)
    r = np.array([0.25, 1.0, 0.25, 1.0])
    parts = {
        name: ChannelSlice(r, np.array([1e-3, -2e-5, 1 / 3, 0.1]), sd, r - 0.1, r + 0.1, sides)
        for name, sd in (("B", np.array([1e-4, np.nan, 0.1, 0.2])), ("R", np.full(4, np.nan)))
    }
    return Slice(
        parts,
        1.5,
        "incident",
        "fresnel",
        total_r={"R": 0.75},
        total_r_sd={"R": 1e-3},
        lost_fraction={"B": 0.01, "R": 0.02},
        material='a "name", with commas',
        flags=("light_lost", "noise"),
        provenance={"sha256": {"frames/a.dng": "00ff"}, "exposures_s": [1, 0.25], "n": 3, "ok": True, "é": 1e-300},
    )


def files_of(folder: Path, slices: dict[str, Slice]) -> list[Path]:
    """A slice.csv for each name."""
    files = [folder / name for name in slices]
    for file, piece in zip(files, slices.values(), strict=True):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_slice(file, piece)
    return files
