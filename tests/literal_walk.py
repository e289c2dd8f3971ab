"""A second Monte Carlo walk, as a textbook has it, which shares no line with the package: light for its tests.

No splitting, no table, no scaling: one photon after another, logarithms, sines and Snell's law (Wang, Jacques and
Zheng 1995). `python tests/literal_walk.py` writes the curves in fixtures/, in two minutes. Lengths in mm,
coefficients in 1/mm; values per unit flux that entered, over the hemisphere of exits.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FIXTURES = Path(__file__).parent / "fixtures"
BATCHES = 40
LEAST_WEIGHT, SURVIVAL = 1e-3, 0.1
EDGES_MFP = np.concatenate(
    [[0.0], np.geomspace(0.05, 1, 12), np.arange(1.25, 3, 0.25), np.arange(3, 12, 0.5), np.arange(12, 24.5, 1)]
)
NOISIEST = 0.05
"""Relative standard error beyond which, and beyond, annuli are left out."""


@dataclass(frozen=True)
class WalkedMedium:
    """A semi-infinite medium, and how many photons tell its light to half a percent a ring."""

    sigma_a: float
    sigma_sp: float
    eta: float
    g: float
    photons: int


MEDIA = {
    "marbleG_g0": WalkedMedium(0.0041, 2.62, 1.5, 0.0, 3_000_000),
    "skin1G_g0.8": WalkedMedium(0.17, 0.88, 1.3, 0.8, 6_000_000),
    "ketchupR_g0": WalkedMedium(0.061, 0.18, 1.3, 0.0, 12_000_000),
}


@njit
def walk(
    rng: np.random.Generator, photons: int, sigma_a: float, sigma_s: float, g: float, eta: float, edges: Floats
) -> Floats:
    """Weight that left in each ring, and last beyond them all."""
    out = np.zeros(edges.size)
    sigma_t = sigma_a + sigma_s
    for _ in range(photons):
        x = y = z = 0.0
        ux, uy, uz, weight = 0.0, 0.0, 1.0, 1.0
        while weight > 0.0:
            step = -np.log(1.0 - rng.random()) / sigma_t
            left = False
            while z + step * uz < 0.0:  # on its way it meets the surface
                part = -z / uz
                x, y, z, step = x + part * ux, y + part * uy, 0.0, step - part
                sin_out = eta * np.sqrt(1.0 - uz * uz)
                reflected = 1.0
                if sin_out < 1.0:
                    cos_in, cos_out = -uz, np.sqrt(1.0 - sin_out * sin_out)
                    r_s = (eta * cos_in - cos_out) / (eta * cos_in + cos_out)
                    r_p = (eta * cos_out - cos_in) / (eta * cos_out + cos_in)
                    reflected = (r_s * r_s + r_p * r_p) / 2.0
                if rng.random() >= reflected:
                    ring = np.searchsorted(edges, np.sqrt(x * x + y * y), side="right") - 1
                    out[min(ring, edges.size - 1)] += weight
                    left = True
                    break
                uz = -uz
            if left:
                break
            x, y, z = x + step * ux, y + step * uy, z + step * uz
            weight *= sigma_s / sigma_t
            if weight < LEAST_WEIGHT:
                weight = weight / SURVIVAL if rng.random() < SURVIVAL else 0.0
            if g == 0.0:
                cos_turn = 2.0 * rng.random() - 1.0
            else:
                ratio = (1.0 - g * g) / (1.0 - g + 2.0 * g * rng.random())
                cos_turn = (1.0 + g * g - ratio * ratio) / (2.0 * g)
            sin_turn = np.sqrt(max(0.0, 1.0 - cos_turn * cos_turn))
            about = 2.0 * np.pi * rng.random()
            if abs(uz) > 0.99999:
                ux, uy, uz = sin_turn * np.cos(about), sin_turn * np.sin(about), np.copysign(cos_turn, uz * cos_turn)
            else:
                across = np.sqrt(1.0 - uz * uz)
                ux, uy, uz = (
                    sin_turn * (ux * uz * np.cos(about) - uy * np.sin(about)) / across + ux * cos_turn,
                    sin_turn * (uy * uz * np.cos(about) + ux * np.sin(about)) / across + uy * cos_turn,
                    -sin_turn * np.cos(about) * across + uz * cos_turn,
                )
                norm = np.sqrt(ux * ux + uy * uy + uz * uz)
                ux, uy, uz = ux / norm, uy / norm, uz / norm
    return out


def light_of(medium: WalkedMedium, photons: int, seed: int) -> tuple[Floats, Floats, Floats]:
    """Edges, and batches of R_d (BATCHES, n) and of R (BATCHES,)."""
    edges = EDGES_MFP / (medium.sigma_a + medium.sigma_sp)
    sigma_s = medium.sigma_sp / (1 - medium.g)
    each = -(-photons // BATCHES)
    streams = np.random.default_rng(seed).spawn(BATCHES)
    left = np.array([walk(rng, each, medium.sigma_a, sigma_s, medium.g, medium.eta, edges) for rng in streams]) / each
    return edges, left[:, :-1] / (np.pi * np.diff(edges**2)), left.sum(axis=1)


def mean_se(batches: Floats) -> tuple[Any, Any]:
    return batches.mean(axis=0), batches.std(axis=0, ddof=1) / np.sqrt(len(batches))


def write(name: str, medium: WalkedMedium) -> None:
    edges, rd, total = light_of(medium, medium.photons, seed=1)
    value, error = mean_se(rd)
    r, r_error = mean_se(total)
    noisy = error > NOISIEST * value
    n = int(np.argmax(noisy)) if noisy.any() else noisy.size
    rows = zip(edges[:n], edges[1 : n + 1], value[:n], error[:n], strict=True)
    head = (
        f"# tests/literal_walk.py, {medium.photons} photons: semi-infinite medium, pencil at normal incidence\n"
        f"# sigma_s_prime={medium.sigma_sp}/mm sigma_a={medium.sigma_a}/mm eta={medium.eta} g={medium.g}\n"
        "# R_per_mm2 is per unit flux ENTERING the medium; means over rings [r_lo, r_hi], with standard errors\n"
        f"# total_R_entering={r:.6f} +- {r_error:.6f}\n"
        "r_lo_mm,r_hi_mm,R_per_mm2,se_per_mm2\n"
    )
    body = "".join(",".join(f"{each:.6g}" for each in row) + "\n" for row in rows)
    (FIXTURES / f"{name}.csv").write_text(head + body, encoding="utf-8")


if __name__ == "__main__":
    for name, medium in MEDIA.items():
        write(name, medium)
        print(name)
