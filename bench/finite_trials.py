"""How often intervals of finite samples hold the truth: `python -m bssrdf.bench.finite_trials [TRIALS [SEED]]`.

The light is the engine's; noise, scale, and what is stated of depth and back are drawn about the truth.
"""

from __future__ import annotations

import sys

import numpy as np

from bssrdf.bench.finite_light import drawn, slabs
from bssrdf.fit import FitOptions, fit_slices

SHALLOWEST_MFP = 7.9
TRIALS = 20
SEED = 11


def trials(each: int = TRIALS, seed: int = SEED) -> str:
    """A line for each depth and back: the share of intervals of σa and σs′ that hold, and how many σa were refused."""
    rng = np.random.default_rng(seed)
    cases = [case for case in slabs() if case.depth_mfp > SHALLOWEST_MFP and not case.g for _ in range(each)]
    fits = fit_slices([drawn(case, rng) for case in cases], FitOptions(model="mc", tables="shipped"))
    found: dict[str, list[tuple[float, float]]] = {}
    for case, by_channel in zip(cases, fits, strict=True):
        fit = by_channel[case.channel]
        ends = (fit.sigma_a_interval95_per_mm, fit.sigma_sp_interval95_per_mm)
        held = [
            float(lo <= true <= hi) if np.isfinite(lo) else np.nan
            for true, (lo, hi) in zip(case.coefficients, ends, strict=True)
        ]
        for key in ("all", f"{case.depth_mfp:4.0f} mfp′ on {case.back}"):
            found.setdefault(key, []).append((held[0], held[1]))
    return "\n".join(_line(key, np.array(rows)) for key, rows in found.items())


def _line(key: str, rows: np.ndarray) -> str:
    share = np.nanmean(rows, axis=0)
    refused = int(np.isnan(rows[:, 0]).sum())
    return f"{key:18s} σa {share[0]:6.1%}  σs′ {share[1]:6.1%}  of {len(rows)}, σa refused {refused}"


if __name__ == "__main__":
    print(trials(*map(int, sys.argv[1:])))
