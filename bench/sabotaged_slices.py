"""Slices that something is wrong with, each in one way: `python -m bssrdf.bench.sabotaged_slices [mc|dipole|auto]`.

The light is the engine's absorbing walk, from 0.1 mean free paths on. A slice is caught if its fit states no number, or
if both intervals, the dipole's with its model error, hold the truth. Lengths in mm, coefficients in 1/mm.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit import FitOptions, fit_slices
from bssrdf.rig import SampleMedium
from bssrdf.session.records import ChannelFit, ChannelSlice, Slice
from bssrdf.transport import IncidentBeam, MonteCarloMedium, simulate

Floats = NDArray[np.float64]

MEDIA = {
    "skin": SampleMedium(0.17, 0.88, 1.3, 0.8),
    "marble": SampleMedium(0.0041, 2.62, 1.5, 0.8),
}
RINGS, NEAREST_MFP, FARTHEST_MFP = 40, 0.1, 24.0
SPOT_MFP = 0.5
NOISE, TOTAL_NOISE = 0.01, 0.002
NOISIEST = 0.2
"""Relative standard error of the walk from which on a ring is not used."""
STEPS = 6e7
SEEDS = 1, 2, 3, 4
"""Walks and noise: of one seed's 24 slices too few hold for a median of widths."""
KEYS = ("sigma_sp", "sigma_a")


class Unspoilt(NamedTuple):
    """A medium's slice without a fault, and with the light of a wide spot."""

    honest: Slice
    spotted: Slice


def _times(curve: float = 1.0, r: float = 1.0, sd: float = 1.0, floor: float = 0.0) -> Callable[[Unspoilt], Slice]:
    """R alone stays as it was."""

    def made(case: Unspoilt) -> Slice:
        c = case.honest.channels["G"]
        assert c.r_lo_mm is not None
        assert c.r_hi_mm is not None
        rd = curve * c.rd_per_mm2 + floor * c.rd_per_mm2.max()
        part = ChannelSlice(r * c.r_mm, rd, curve * sd * c.sd_per_mm2, r * c.r_lo_mm, r * c.r_hi_mm)
        return replace(case.honest, channels={"G": part})

    return made


FAULTS: dict[str, Callable[[Unspoilt], Slice]] = {
    **{f"curve x {factor:g}": _times(curve=factor) for factor in (1.05, 1.1, 1.5, 3.0, 10.0)},
    "radii in cm": _times(r=0.1),
    "g 0.3 off": lambda case: replace(case.honest, g=(case.honest.g or 0.0) - 0.3),
    "eta 0.1 off": lambda case: replace(case.honest, eta=case.honest.eta + 0.1),
    "a floor of glare": _times(floor=0.01),
    "R of another sample": lambda case: replace(case.honest, total_r={"G": 0.85 * case.honest.total_r["G"]}),
    "spot ignored": lambda case: case.spotted,
    "noise understated": _times(sd=0.2),
}


def case_of(medium: SampleMedium, seed: int) -> Unspoilt:
    """The slices of a medium, walked."""
    rng = np.random.default_rng(seed)
    sigma_tp = medium.sigma_a + medium.sigma_sp
    edges = np.append(0.0, np.geomspace(NEAREST_MFP, FARTHEST_MFP, RINGS + 1) / sigma_tp)
    absorbed = medium.sigma_a / sigma_tp
    photons = int(STEPS * (1 - medium.g) / (4 + (1 - np.exp(-4.6 * np.sqrt(absorbed))) / absorbed))
    walked = MonteCarloMedium.reduced(medium.sigma_a, medium.sigma_sp, medium.g, medium.eta)

    def slice_of(spot_mm: float) -> Slice:
        tally = simulate(walked, IncidentBeam(spot_mm), r_edges_mm=edges, n_photons=photons, seed=seed)
        rd, error = (each[1:] for each in tally.rd())
        good = np.append(error < NOISIEST * rd, False)
        first = int(np.argmax(good))
        use = slice(first, first + int(np.argmin(good[first:])))
        sd = np.hypot(NOISE, error / rd)[use] * rd[use]
        noisy = rd[use] + NOISE * rd[use] * rng.standard_normal(sd.size)
        lo, hi = edges[1:-1][use], edges[2:][use]
        total, total_error = tally.total_r()
        return Slice(
            channels={"G": ChannelSlice((lo + hi) / 2, noisy, sd, lo, hi)},
            eta=medium.eta,
            g=medium.g,
            flux="entering",
            exit="hemisphere",
            total_r={"G": total * (1 + TOTAL_NOISE * rng.standard_normal())},
            total_r_sd={"G": float(np.hypot(TOTAL_NOISE * total, total_error))},
            scale_rel_sd=0.0,
            mm_rel_sd=0.0,
        )

    return Unspoilt(slice_of(0.0), slice_of(SPOT_MFP / sigma_tp))


def holds(found: ChannelFit, medium: SampleMedium) -> bool:
    """Whether both intervals hold the medium, with the model's error beside."""
    for key in KEYS:
        lo, hi = getattr(found, f"{key}_interval95_per_mm")
        off = found.model_error.get(key, 0.0) if found.model == "dipole" else 0.0
        if not lo * max(1 - off, 0) <= getattr(medium, key) <= hi * (1 + off):
            return False
    return True


def widths(found: ChannelFit) -> Floats:
    """Of both intervals, in ln σ."""
    with np.errstate(divide="ignore"):
        return np.array([np.diff(np.log(getattr(found, f"{key}_interval95_per_mm")))[0] for key in KEYS])


def judged(model: str, seed: int) -> list[tuple[str, str, float]]:
    """Medium and fault, what became of it, and how wide the intervals are over those of the honest slice."""
    outcomes: list[tuple[str, str, float]] = []
    for name, medium in MEDIA.items():
        case = case_of(medium, seed)
        pieces = [case.honest, *(fault(case) for fault in FAULTS.values())]
        fits = [each["G"] for each in fit_slices(pieces, FitOptions(model=model))]  # type: ignore[arg-type]
        for fault, found in zip(("none", *FAULTS), fits, strict=True):
            stated = found.status in ("converged", "upper_bound")
            how = found.status if not stated else "holds" if holds(found, medium) else "WRONG"
            wide = float(np.max(widths(found) / widths(fits[0]))) if stated else float("nan")
            outcomes.append((f"{name}, {fault}", how, wide))
    return outcomes


def main(models: Sequence[str]) -> None:
    """Judge all and print a line for each."""
    for model in models or ("mc", "dipole"):
        outcomes = [each for seed in SEEDS for each in judged(model, seed)]
        for name, how, wide in outcomes:
            print(f"{model}: {name}: {how}" + (f", {wide:.2f} x as wide" if wide == wide else ""))
        caught = [how != "WRONG" for name, how, _ in outcomes if not name.endswith("none")]
        ratio = np.median([wide for name, how, wide in outcomes if how == "holds" and not name.endswith("none")])
        print(f"{model}: {sum(caught)} of {len(caught)} caught; those that hold {ratio:.2f} x as wide (median)")


if __name__ == "__main__":
    main(sys.argv[1:])
