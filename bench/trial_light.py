"""The light on which fits are put to trial: the engine's absorbing walk of every cell of the material table.

No table, no dipole and no scaling: each cell is walked by its own coefficients at g = 0. `python -m
bssrdf.bench.trial_light` makes the file that ships, or goes on with it. Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

import functools
import sys
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bssrdf.session import atomic_write
from bssrdf.transport import CHANNELS, MIN_BATCHES, MonteCarloMedium, load_materials, simulate

Floats = NDArray[np.float64]

FILE = "trial_light.npz"
"""Beside this module."""
LIGHT_NOISE = 0.005
"""Root mean square relative error of the annuli that are used, at which a walk ends."""
STEPS_A_ROUND = 2e8
MOST_ROUNDS = 40
"""A dark cell whose far annuli get next to no light ends here."""
PILOT = 20_000
SEED = 33_000
N_RADII = 200
FIRST_MFP, LAST_MFP = 1.0, 24.0
FAINTEST = 1e-5
"""Of R_d at NEAR_MM: fainter annuli are not used."""
NEAR_MM = 0.15
NOISIEST = 0.05
"""Relative standard error from which on an annulus is not used."""
NOISIEST_ALONE = 0.25
"""The same of a light that serves one trial: noisier ones are too skew for errors to describe."""
LEAST_TOLD = 2
"""Annuli are used in any case: a fit can say that they are too few."""
PER_PHOTON = 4.0
"""What starting a photon costs, in collisions."""


@dataclass(frozen=True)
class Cell:
    """One entry of the material table."""

    material: str
    channel: str
    sigma_a: float
    sigma_sp: float
    eta: float

    @property
    def name(self) -> str:
        return f"{self.material} {self.channel}"


@dataclass(frozen=True)
class TrialLight:
    """R_d and R of one cell per unit entering flux, with standard errors; annulus 0 is a disc or holds NEAR_MM."""

    cell: Cell
    rd: Floats
    """(m,): mean over each annulus of `edges_mm`."""
    rd_se: Floats
    total: float
    total_se: float
    photons: int
    chosen: slice | None = None
    """The annuli to use, where more light than this says which are good."""

    @property
    def used(self) -> slice:
        """The annuli from FIRST_MFP on, up to the first that is fainter than FAINTEST or that few photons reached."""
        if self.chosen is not None:
            return self.chosen
        near = int(np.searchsorted(edges_mm(self.cell), NEAR_MM)) - 1
        first = self.rd.size - N_RADII
        good = (self.rd >= FAINTEST * self.rd[near]) & (self.rd_se < NOISIEST * self.rd)
        bad = np.flatnonzero(~good[first:])
        return slice(first, first + (int(bad[0]) if bad.size else N_RADII))

    @property
    def noise(self) -> float:
        """Root mean square relative error of the annuli used."""
        rd, se = self.rd[self.used], self.rd_se[self.used]
        return float(np.sqrt(np.mean(np.square(se / rd)))) if rd.size else np.inf


def cells() -> list[Cell]:
    """The 33 cells of the table that absorb: all but Spectralon's."""
    return [
        Cell(material.name, channel, float(medium.sigma_a), float(medium.sigma_sp), float(material.eta))
        for material in load_materials().values()
        if material.name != "Spectralon"
        for channel in CHANNELS
        for medium in [material.medium(channel)]
    ]


def edges_mm(cell: Cell) -> Floats:
    """Edges of N_RADII annuli about radii even in 1 to 24 mean free paths, and of those within them."""
    half = (LAST_MFP - FIRST_MFP) / (N_RADII - 1) / 2
    rings = np.linspace(FIRST_MFP - half, LAST_MFP + half, N_RADII + 1) / (cell.sigma_a + cell.sigma_sp)
    about_near = [edge for edge in (NEAR_MM - 0.01, NEAR_MM + 0.01) if edge < rings[0]]
    return np.array([0.0, *about_near, *rings])


def more(cell: Cell, so_far: TrialLight | None, photons: int, seed: int) -> TrialLight:
    """The light with that many photons more."""
    tally = simulate(
        MonteCarloMedium.reduced(cell.sigma_a, cell.sigma_sp, 0.0, cell.eta),
        r_edges_mm=edges_mm(cell),
        n_photons=photons,
        seed=seed,
    )
    new = TrialLight(cell, *tally.rd(), *tally.total_r(), tally.n_photons)
    return new if so_far is None else _together(so_far, new)


def batches(cell: Cell, n: int, photons: int, seed: int) -> list[TrialLight]:
    """`n` independent lights of the cell, `photons` walked for each: a trial on one of its own shares no noise.

    One photon lights many annuli: in a dark cell the mean over 200 of them scatters 2 to 5 times more than if they were
    independent, and R goes along. A slice states errors of each radius for itself, so the lights exchange annuli, each
    for itself, and R: 1/n of that is left. Errors are the spread of all lights, and so are the annuli to use: a light's
    own noise chooses nothing.
    """
    n = max(n, MIN_BATCHES)
    tally = simulate(
        MonteCarloMedium.reduced(cell.sigma_a, cell.sigma_sp, 0.0, cell.eta),
        r_edges_mm=edges_mm(cell),
        n_photons=photons * n,
        seed=seed,
        n_batches=n,
    )
    rd = tally.scores[:, 0, :, :-1].sum((1, 3)) / tally.area_mm2
    return exchanged(cell, rd, tally.scores[:, 0].sum((1, 2, 3)), photons, seed)


def exchanged(cell: Cell, rd: Floats, total: Floats, photons: int, seed: int) -> list[TrialLight]:
    """A light for each batch (n, m) and (n,) of a walk, with annuli and R of any of them."""
    n = len(rd)
    alone, total_alone = np.std(rd, axis=0, ddof=1), float(np.std(total, ddof=1))
    whole = TrialLight(cell, rd.mean(0), alone / np.sqrt(n), float(total.mean()), total_alone / n**0.5, photons * n)
    first, last = whole.used.start, whole.used.stop
    rough = np.flatnonzero(alone[first:last] > NOISIEST_ALONE * whole.rd[first:last])
    told = slice(first, max(first + LEAST_TOLD, first + int(rough[0]) if rough.size else last))
    rng = np.random.default_rng(seed)
    pairs = zip(rng.permuted(rd, axis=0), rng.permuted(total), strict=True)
    return [TrialLight(cell, one, alone, float(r), total_alone, photons, told) for one, r in pairs]


def _together(a: TrialLight, b: TrialLight) -> TrialLight:
    photons = a.photons + b.photons
    w_a, w_b = a.photons / photons, b.photons / photons
    return TrialLight(
        a.cell,
        w_a * a.rd + w_b * b.rd,
        np.hypot(w_a * a.rd_se, w_b * b.rd_se),
        w_a * a.total + w_b * b.total,
        float(np.hypot(w_a * a.total_se, w_b * b.total_se)),
        photons,
    )


@functools.cache
def shipped() -> dict[str, TrialLight]:
    """The light that ships, by cell."""
    with as_file(files("bssrdf.bench") / FILE) as path:
        return _read(path)


def make(path: Path, noise: float = LIGHT_NOISE) -> None:
    """Walk on with every cell whose light in `path` is noisier than `noise`, a round at a time, and write after each.

    Two idle cores take about two hours.
    """
    lights = _read(path) if path.exists() else {}
    for number in range(1, MOST_ROUNDS + 1):
        for at, cell in enumerate(cells()):
            light = lights.get(cell.name) or more(cell, None, PILOT, SEED + at)
            a_round = photons_for(cell, STEPS_A_ROUND)
            if light.noise > noise and light.photons < number * a_round:
                light = more(cell, light, a_round, SEED + 1000 * number + at)
                print(f"{number} {cell.name}: {light.photons} photons, noise {light.noise:.2%}", file=sys.stderr)
            lights[cell.name] = light
            _write(path, lights)


def photons_for(cell: Cell, steps: float) -> int:
    """Photons for about so many collisions: a photon of albedo near 1 takes some 1/√(1 − α′)."""
    absorbed = cell.sigma_a / (cell.sigma_a + cell.sigma_sp)
    return max(1, int(steps / (PER_PHOTON + (1 - np.exp(-4.6 * np.sqrt(absorbed))) / absorbed)))


def _write(path: Path, lights: dict[str, TrialLight]) -> None:
    rows = list(lights.values())
    longest = max(light.rd.size for light in rows)
    with atomic_write(path) as part, part.open("wb") as stream:
        np.savez_compressed(
            stream,
            names=np.array([light.cell.name for light in rows]),
            rd=np.stack([_from_behind(light.rd, longest) for light in rows]).astype(np.float32),
            rd_se=np.stack([_from_behind(light.rd_se, longest) for light in rows]).astype(np.float32),
            total=np.array([light.total for light in rows]),
            total_se=np.array([light.total_se for light in rows]),
            photons=np.array([light.photons for light in rows]),
        )


def _from_behind(values: Floats, size: int) -> Floats:
    return np.concatenate([np.zeros(size - values.size), values])


def _read(path: Path) -> dict[str, TrialLight]:
    by_name = {cell.name: cell for cell in cells()}
    with np.load(path, allow_pickle=False) as content:
        stored = {key: content[key] for key in content.files}
    found = {}
    for row, name in enumerate(stored["names"].tolist()):
        size = edges_mm(by_name[name]).size - 1
        found[name] = TrialLight(
            by_name[name],
            stored["rd"][row, -size:].astype(float),
            stored["rd_se"][row, -size:].astype(float),
            float(stored["total"][row]),
            float(stored["total_se"][row]),
            int(stored["photons"][row]),
        )
    return found


if __name__ == "__main__":
    make(Path(__file__).parent / FILE)
