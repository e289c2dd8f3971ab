"""The light on which fits of finite samples are put to trial: the engine's absorbing walks of slabs and dishes.

No table and no ratio of diffusion: each sample is walked by its own coefficients. `python -m bssrdf.bench.finite_light`
makes the file that ships, or goes on with it. Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

import functools
import sys
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.session import atomic_write
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.transport import MonteCarloMedium, find_material, simulate

Floats = NDArray[np.float64]

FILE = "finite_light.npz"
"""Beside this module."""
MEDIA = (("Wholemilk", "R"), ("Skimmilk", "R"), ("Marble", "G"), ("Skin1", "G"), ("Chicken1", "G"))
"""From a total of 0.91 to one of 0.2."""
DEPTHS_MFP = (2.0, 3.0, 4.0, 6.0, 8.0, 16.0, 32.0)
BACKS: tuple[float | str, ...] = (0.0, 0.9, "air")
DISHES_MM = (30.0, 50.0, 80.0)
DISH_DEPTH_MM = 20.0
EDGES_MFP = np.concatenate([[0.0], np.geomspace(0.5, 24.0, 25)])
FAINTEST, NOISIEST = 1e-5, 0.15
"""Annuli fainter than this, of the innermost, or noisier are not used."""
PHOTONS_A_ROUND = 100_000
SEED = 51_000


@dataclass(frozen=True)
class Case:
    """A medium in what holds it."""

    material: str
    channel: str
    depth_mm: float
    back: float | str
    g: float = 0.0
    width_mm: float | None = None
    wall: str = "black"

    @property
    def name(self) -> str:
        vessel = "" if self.width_mm is None else f" in {self.width_mm:g} mm {self.wall}"
        return f"{self.material} {self.channel} g {self.g:g}: {self.depth_mm:.6g} mm on {self.back}{vessel}"

    @property
    def eta(self) -> float:
        return find_material(self.material).eta

    @property
    def coefficients(self) -> tuple[float, float]:
        """(σa, σs′)."""
        medium = find_material(self.material).medium(self.channel)
        return float(medium.sigma_a), float(medium.sigma_sp)

    @property
    def depth_mfp(self) -> float:
        """τ′ = σt′ d."""
        return self.depth_mm * sum(self.coefficients)

    @property
    def edges_mm(self) -> Floats:
        """Of the annuli: those within the wall."""
        edges = EDGES_MFP / sum(self.coefficients)
        return edges if self.width_mm is None else edges[edges <= self.width_mm / 2]

    @property
    def medium(self) -> MonteCarloMedium:
        sigma_a, sigma_sp = self.coefficients
        return MonteCarloMedium(
            sigma_a,
            sigma_sp / (1 - self.g),
            self.g,
            self.eta,
            self.depth_mm,
            self.back,  # type: ignore[arg-type]
            self.width_mm,
            self.wall,  # type: ignore[arg-type]
        )


@dataclass(frozen=True)
class FiniteLight:
    """R_d and R per unit entering flux, with standard errors, by annulus of the case's `edges_mm`."""

    rd: Floats
    rd_se: Floats
    total: float
    total_se: float
    photons: int


def slabs() -> list[Case]:
    """Five media by seven depths and three backs; and one of forward scattering by depth."""
    found = []
    for material, channel in MEDIA:
        sigma_tp = sum(Case(material, channel, 1.0, 0.0).coefficients)
        found += [Case(material, channel, tau / sigma_tp, back) for tau in DEPTHS_MFP for back in BACKS]
    sigma_tp = sum(Case("Skimmilk", "R", 1.0, 0.0).coefficients)
    found += [Case("Skimmilk", "R", tau / sigma_tp, back, 0.8) for tau in (8.0, 16.0) for back in (0.0, 0.9)]
    return found


def dishes() -> list[Case]:
    """Skim milk in cups."""
    return [
        Case("Skimmilk", "R", DISH_DEPTH_MM, 0.0, 0.0, width_mm, wall)
        for width_mm in DISHES_MM
        for wall in ("black", "air")
    ]


def slice_of(case: Case, *, rel_sd: float = 0.01, total_rel_sd: float = 0.002, **keys: Any) -> Slice:
    """The case's light as a slice of what is exactly known of its sample; `keys` win. No noise but the walk's."""
    light = shipped()[case.name]
    lo, hi = case.edges_mm[1:-1], case.edges_mm[2:]
    rd, se = light.rd[1:], light.rd_se[1:]
    good = (se < NOISIEST * rd) & (rd > FAINTEST * light.rd[1])
    part = ChannelSlice(((lo + hi) / 2)[good], rd[good], np.hypot(se, rel_sd * rd)[good], lo[good], hi[good])
    known: dict[str, Any] = {
        "g": case.g,
        "total_r": {case.channel: light.total},
        "total_r_sd": {case.channel: float(np.hypot(total_rel_sd * light.total, light.total_se))},
        "thickness_mm": case.depth_mm,
        "thickness_sd_mm": 0.0,
        "backing": case.back,
        "backing_sd": 0.0,
        "width_mm": case.width_mm,
        "wall": None if case.width_mm is None else case.wall,
    }
    return Slice({case.channel: part}, case.eta, "entering", "hemisphere", **{**known, **keys})


def drawn(case: Case, rng: np.random.Generator, *, depth_rel_sd: float = 0.02, back_sd: float = 0.03) -> Slice:
    """A slice of the case by somebody who measured it: noise, scale, and what is stated of depth and back are drawn."""
    noise, total_noise, scale_sd = 0.01, 0.002, 0.005
    piece = slice_of(case, rel_sd=noise, total_rel_sd=total_noise)
    part = piece.channels[case.channel]
    scale = 1 + scale_sd * rng.standard_normal()
    value = scale * part.rd_per_mm2 * (1 + noise * rng.standard_normal(part.r_mm.size))
    total = scale * piece.total_r[case.channel] * (1 + total_noise * rng.standard_normal())
    back = case.back
    if not isinstance(back, str):
        back = float(np.clip(back + back_sd * rng.standard_normal(), 0, 0.99))
    return replace(
        piece,
        channels={case.channel: replace(part, rd_per_mm2=value)},
        total_r={case.channel: total},
        scale_rel_sd=scale_sd,
        thickness_mm=case.depth_mm * (1 + depth_rel_sd * rng.standard_normal()),
        thickness_sd_mm=depth_rel_sd * case.depth_mm,
        backing=back,
        backing_sd=back_sd,
    )


def more(case: Case, so_far: FiniteLight | None, photons: int, seed: int) -> FiniteLight:
    """The light with that many photons more."""
    tally = simulate(case.medium, r_edges_mm=case.edges_mm, n_photons=photons, seed=seed, n_threads=1)
    new = FiniteLight(*tally.rd(), *tally.total_r(), tally.n_photons)
    if so_far is None:
        return new
    a, b = (each.photons / (so_far.photons + new.photons) for each in (so_far, new))
    return FiniteLight(
        a * so_far.rd + b * new.rd,
        np.hypot(a * so_far.rd_se, b * new.rd_se),
        a * so_far.total + b * new.total,
        float(np.hypot(a * so_far.total_se, b * new.total_se)),
        so_far.photons + new.photons,
    )


@functools.cache
def shipped() -> dict[str, FiniteLight]:
    """The light that ships, by the name of its case."""
    with as_file(files("bssrdf.bench") / FILE) as path:
        return _read(path)


def make(path: Path, rounds: int = 10) -> None:
    """Walk on with every case until it has had `rounds`; a round of all takes one core about four minutes."""
    lights = _read(path) if path.exists() else {}
    for number in range(1, rounds + 1):
        for at, case in enumerate([*slabs(), *dishes()]):
            light = lights.get(case.name)
            if light is None or light.photons < number * PHOTONS_A_ROUND:
                lights[case.name] = more(case, light, PHOTONS_A_ROUND, SEED + 1000 * number + at)
                print(f"{number} {case.name}: R {lights[case.name].total:.4f}", file=sys.stderr)
        _write(path, lights)


def _write(path: Path, lights: dict[str, FiniteLight]) -> None:
    rows, size = list(lights.values()), EDGES_MFP.size - 1
    with atomic_write(path) as part, part.open("wb") as stream:
        np.savez_compressed(
            stream,
            names=np.array(list(lights)),
            rd=np.stack([np.pad(each.rd, (0, size - each.rd.size)) for each in rows]).astype(np.float32),
            rd_se=np.stack([np.pad(each.rd_se, (0, size - each.rd.size)) for each in rows]).astype(np.float32),
            total=np.array([each.total for each in rows]),
            total_se=np.array([each.total_se for each in rows]),
            photons=np.array([each.photons for each in rows]),
            n=np.array([each.rd.size for each in rows]),
        )


def _read(path: Path) -> dict[str, FiniteLight]:
    with np.load(path, allow_pickle=False) as content:
        stored = {key: content[key] for key in content.files}
    return {
        name: FiniteLight(
            stored["rd"][row, : stored["n"][row]].astype(float),
            stored["rd_se"][row, : stored["n"][row]].astype(float),
            float(stored["total"][row]),
            float(stored["total_se"][row]),
            int(stored["photons"][row]),
        )
        for row, name in enumerate(stored["names"].tolist())
    }


if __name__ == "__main__":
    make(Path(__file__).parent / FILE, *map(int, sys.argv[1:]))
