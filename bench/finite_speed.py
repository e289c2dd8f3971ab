"""How long fits of finite samples take beside half spaces: `python -m bssrdf.bench.finite_speed [SLICES]`.

CPU time of three channels a slice with all that is reported, the best of some rounds that take turns. The light is the
table's own with 1 % of noise: only the time counts.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from bssrdf.fit import FitOptions, fit_slice, fit_slices
from bssrdf.holding import held, sample_ratio
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.transport import shipped_table
from bssrdf.transport.arrays import NUMPY
from bssrdf.transport.finite import Sample, top_of, total_ratio
from bssrdf.transport.light import shape_of

SLICES = 24
ALONE = 6
ROUNDS = 4
OPTIONS = FitOptions(model="mc", tables="shipped")
MEDIA = ((0.0014, 0.70), (0.0024, 2.55), (0.0041, 2.62), (0.06, 0.70))
"""σa and σs′ [1/mm] of milks, marble and a dark one; other channels absorb and scatter more."""
ETA = 1.3


def keys(kind: str, number: int, mfp: float) -> dict[str, Any]:
    """How a sample is held whose mean free path is so long [mm]."""
    back: dict[str, Any] = {"thickness_sd_mm": 0.1 * mfp, "backing": "black", "backing_sd": 0.03}
    return {
        "half space": {},
        "slab": {"thickness_mm": (10 + 4 * (number % 3)) * mfp, **back},
        "dish": {"thickness_mm": 20 * mfp, "width_mm": 40 * mfp, "wall": "black", **back},
    }[kind]


def slice_like(kind: str, number: int) -> Slice:
    """A slice of three channels."""
    rng = np.random.default_rng(number)
    sigma_a, sigma_sp = MEDIA[number % len(MEDIA)]
    piece = Slice({}, ETA, "entering", "hemisphere", g=0.0, scale_rel_sd=0.005, mm_rel_sd=0.002)
    piece = replace(piece, **keys(kind, number, 1 / sigma_sp))
    r = np.geomspace(1, 14, 120) / sigma_sp
    light = {
        name: _light(piece, (1 + k) * sigma_a, (1 + k / 10) * sigma_sp, r, rng)
        for k, name in enumerate(("R", "G", "B"))
    }
    return replace(
        piece,
        channels={name: ChannelSlice(r, rd, 0.01 * rd) for name, (rd, _) in light.items()},
        total_r={name: total for name, (_, total) in light.items()},
        total_r_sd={name: 0.002 * total for name, (_, total) in light.items()},
    )


def _light(
    piece: Slice, sigma_a: float, sigma_sp: float, r: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    """R_d [1/mm²] at r, and R."""
    table = shipped_table(ETA, 0.0)
    log_sigma, q = (np.full((1, 1), each) for each in shape_of(sigma_a, sigma_sp))
    sigma = float(np.exp(log_sigma[0, 0]))
    rd = sigma**2 * table.look(NUMPY, q, sigma * r[None])[0][0] * sample_ratio(piece, table, sigma_a, sigma_sp, r)
    total = float(table.total(NUMPY, q)[0][0, 0])
    kind, *lengths = held(piece)[:5]
    if kind != "half":
        sample = Sample(*(np.full((1, 1), each) for each in lengths))
        ratio, *_ = total_ratio(NUMPY, kind == "dish", sample, top_of(table), log_sigma, q)
        total *= float(ratio[0, 0])
    return rd * (1 + 0.01 * rng.standard_normal(r.size)), total * (1 + 0.002 * rng.standard_normal())


def speed(slices: int = SLICES) -> str:
    """A line for one by one and one for a batch: ms each, and over those of half spaces."""
    pieces = {kind: [slice_like(kind, k) for k in range(slices)] for kind in ("half space", "slab", "dish")}
    ways: dict[str, Callable[[list[Slice]], Any]] = {
        "one by one, ms a slice": lambda some: [fit_slice(piece, OPTIONS) for piece in some[:ALONE]],
        "in a batch, ms a slice": lambda some: fit_slices(some, OPTIONS),
    }
    best: dict[tuple[str, str], float] = {}
    for _ in range(1 + ROUNDS):  # the first makes the tables
        for way, run in ways.items():
            for kind, some in pieces.items():
                begun = time.process_time()
                run(some)
                spent = (time.process_time() - begun) / (ALONE if way.startswith("one") else slices)
                best[way, kind] = min(spent, best.get((way, kind), np.inf))
    return "\n".join(_line(way, {kind: best[way, kind] for kind in pieces}) for way in ways)


def _line(way: str, spent: dict[str, float]) -> str:
    half = spent["half space"]
    return f"{way}: " + ", ".join(f"{kind} {1e3 * each:.1f} ({each / half:.2f} x)" for kind, each in spent.items())


if __name__ == "__main__":
    print(speed(*map(int, sys.argv[1:])))
