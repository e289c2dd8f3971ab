"""Makes the tables that ship with the package: `python -m bssrdf.bench.white_tables sample`, then `compress`.

Sampling needs numpy, scipy and numba only, so that it can run on any machine with many cores; `reference` runs the
absorbing engine on media that lie between the tables' nodes, to test them against.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bssrdf.transport import MonteCarloMedium, WhiteSamples, decay_constant, sample, simulate

ETAS = (1.3, 1.33, 1.4, 1.5)
GS = (0.0, 0.35, 0.6, 0.75, 0.8, 0.9)
WIDE_ETAS = (1.0, 1.15, 1.4, 1.7, 2.1, 2.5, 3.0)
WIDE_GS = (0.0, 0.4, 0.7, 0.85)
"""The coarse grid, of every index that people ask for."""
SEED = 20011
WIDE_SEED = 20012
REFERENCE_SEED = 711
REFERENCE_MEDIA = {
    "ketchup_b": (1.45, 0.03, 0.0, 1.3),
    "ketchup_b_forward": (1.45, 0.03, 0.8, 1.3),
    "whole_milk_r": (0.0011, 2.55, 0.8, 1.3),
    "intralipid": (0.02, 1.0, 0.7, 1.33),
    "silicone": (0.004, 0.9, 0.66, 1.43),
    "mid_absorbing": (0.5, 1.0, 0.68, 1.37),
    "forward_clear": (0.001, 1.0, 0.9, 1.4),
    "half_forward": (0.03, 1.0, 0.5, 1.45),
}
"""σa, σs′ [1/mm], g, η."""
FOLDER = Path(__file__).parent.parent / "transport" / "white" / "tables"
ANGLES_DEG = (0.0, 30.0, 45.0, 60.0)


def save_samples(path: Path, samples: WhiteSamples) -> None:
    """Write raw samples, floats in single precision."""
    arrays: dict[str, Any] = {name: np.asarray(value) for name, value in dataclasses.asdict(samples).items()}
    np.savez_compressed(path, **{k: v.astype(np.float32) if v.ndim > 1 else v for k, v in arrays.items()})


def load_samples(path: Path) -> WhiteSamples:
    """Read what `save_samples` wrote."""
    with np.load(path, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    return WhiteSamples(
        **{k: v.astype(np.float64) if v.ndim > 1 else v if v.ndim else v.item() for k, v in arrays.items()}
    )


def sample_all(out: Path, gs: Sequence[float], core_seconds: float, n_threads: int, *, wide: bool) -> None:
    """Raw samples of each g, one file each: `core_seconds` of processor time on average, more for larger g."""
    etas, seed = (WIDE_ETAS, WIDE_SEED) if wide else (ETAS, SEED)
    for g in gs:
        began = time.perf_counter()
        share = core_seconds * (0.5 + g) / (0.5 + float(np.mean(GS)))
        samples = sample(g, np.array(etas), share, seed=seed, n_threads=n_threads)
        save_samples(out / f"samples_g{g:g}.npz", samples)
        print(f"g {g}: {samples.n_photons.sum()} photons, {time.perf_counter() - began:.0f} s", file=sys.stderr)


def reference_all(out: Path, core_seconds: float, n_threads: int) -> None:
    """R_d, totals and radiance of the reference media by the absorbing engine, about `core_seconds` each."""
    stored: dict[str, Any] = {}
    for name, (sigma_a, sigma_sp, g, eta) in REFERENCE_MEDIA.items():
        medium = MonteCarloMedium.reduced(sigma_a, sigma_sp, g, eta)
        far = min(
            60.0 / (sigma_a + sigma_sp), 17.0 / (decay_constant(medium.sigma_s / medium.sigma_t, g) * medium.sigma_t)
        )
        edges = np.append(0, np.geomspace(0.02 / (sigma_a + sigma_sp), far, 60))
        simulate(medium, r_edges_mm=edges, n_photons=1, seed=0)
        began = time.perf_counter()
        simulate(medium, r_edges_mm=edges, n_photons=20_000, seed=1, n_threads=1)
        n_photons = int(20_000 * core_seconds / (time.perf_counter() - began))
        tally = simulate(
            medium, r_edges_mm=edges, n_photons=n_photons, seed=REFERENCE_SEED, n_threads=n_threads, n_batches=64
        )
        stored[f"{name}_edges_mm"] = edges
        stored[f"{name}_rd"] = np.stack(tally.rd())
        stored[f"{name}_first"] = np.stack(tally.rd("first"))
        stored[f"{name}_total"] = np.array(tally.total_r())
        stored[f"{name}_radiance"] = np.array([tally.radiance(angle) for angle in ANGLES_DEG])
        stored[f"{name}_total_radiance"] = np.array([tally.total_radiance(angle) for angle in ANGLES_DEG])
        print(f"{name}: {tally.n_photons} photons, {time.perf_counter() - began:.0f} s", file=sys.stderr)
    np.savez_compressed(out / "reference.npz", **stored)


def compress_all(out: Path, tables: Path, *, wide: bool) -> None:
    """The file of tables from the raw samples in `out`."""
    from bssrdf.transport import fit_tables, table_set, write_tables

    fitted = {}
    for path in sorted(out.glob("samples_g*.npz")):
        samples = load_samples(path)
        for eta, table in zip(samples.etas, fit_tables(samples), strict=True):
            fitted[samples.g, float(eta)] = table
            print(f"g {samples.g:g}, eta {eta:g}: chi2 {table.chi2:.2f}", file=sys.stderr)
    write_tables(tables, table_set(fitted), small=wide)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["sample", "reference", "compress"])
    parser.add_argument("--out", type=Path, required=True, help="folder of the raw samples")
    parser.add_argument("--core-seconds", type=float, default=900.0, help="processor time for a g or a medium")
    parser.add_argument("--wide", action="store_true", help="the coarse grid out to an index of 3")
    parser.add_argument("--g", type=float, nargs="+", help="values of g to sample, if not all")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--tables", type=Path, help="file that compress writes, if not the one that ships")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    if args.what == "sample":
        sample_all(args.out, args.g or (WIDE_GS if args.wide else GS), args.core_seconds, args.threads, wide=args.wide)
    elif args.what == "reference":
        reference_all(args.out, args.core_seconds, args.threads)
    else:
        compress_all(args.out, args.tables or FOLDER / ("wide.npz" if args.wide else "white.npz"), wide=args.wide)


if __name__ == "__main__":
    main()
