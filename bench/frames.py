"""`bssrdf bench frames`: do the intervals hold the truth when frames are at fault?

Those of R, of each decade of the curve, and of the coefficients that are fitted to it. Truth is what a camera without
noise and without fault shows of the same light, and the walk's own total.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.frame_faults import FAULTS, PLAIN, Setup, currents, scene, session_of, write_session
from bssrdf.calib import Exposures, Surface
from bssrdf.errors import InputError
from bssrdf.fit import fit_slice
from bssrdf.measure import Hdr, Image, Progress, SliceOptions, measure_session, measure_slice
from bssrdf.session.records import Camera, ChannelSlice, Slice

Array = NDArray[np.float64]

Z95 = 1.96
_TRUTH_REL_SD = 1e-6
_LEAST_SHARE = 1e-6
"""Of the curve's peak, down to which decades are judged,"""
_CLEAR = 0.3
"""where their error is below this share."""


@dataclass(frozen=True)
class Trial:
    """One session: refused, or by how many standard errors it is off."""

    fault: str
    seed: int
    refused: str | None
    flags: tuple[str, ...] = ()
    total_z: tuple[float, ...] = ()
    """By channel."""
    total_rel: tuple[float, ...] = ()
    total_rel_sd: tuple[float, ...] = ()
    decade_z: tuple[tuple[float, ...], ...] = ()
    """By channel, brightest decade first."""
    coefficients_held: dict[str, bool] = field(default_factory=dict)
    """Whether the 95 % interval holds what the light was made with; empty where the fit gives none."""


def run_frames_bench(
    *,
    seeds: int = 20,
    faults: Sequence[str] = tuple(FAULTS),
    setup: Setup = PLAIN,
    out: Path | None = None,
    progress: Progress | None = None,
) -> list[Trial]:
    """Measure sessions of every fault, `seeds` each; with `out` also write frames.json there."""
    truth = true_slice(setup)
    trials = []
    for number, fault in enumerate(faults):
        for seed in range(seeds):
            trials.append(trial(fault, seed, truth, setup))
            if progress:
                progress(fault, number * seeds + seed + 1, len(faults) * seeds)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "frames.json").write_text(json.dumps([asdict(each) for each in trials], indent=1) + "\n")
    return trials


def true_slice(setup: Setup) -> Slice:
    """What a camera without noise measures, with the totals that the light was made with."""
    bench = scene(setup)
    session = session_of(Path(), Camera(bench.sensor.layout), setup)
    assert session.geometry
    images = [
        Image(kind, _noiseless(light), bench.sensor.layout, ("G",), Surface(session.geometry, None))
        for kind, light in currents(setup).items()
    ]
    found = measure_slice(session, images[0], images[1], {}, Exposures(), SliceOptions())
    return replace(found, total_r=dict(zip("G", bench.radiance_factors(bench.sample), strict=True)))


def _noiseless(light: Array) -> Hdr:
    radiance = light.astype(np.float32)
    none = np.zeros(light.shape, np.uint8)
    return Hdr(radiance, np.square(_TRUTH_REL_SD * radiance), none.astype(np.uint16), none)


def trial(fault: str, seed: int, truth: Slice, setup: Setup, repeats: int = 1) -> Trial:
    """One session with a fault, measured."""
    with tempfile.TemporaryDirectory() as folder:
        session = write_session(Path(folder) / "session", FAULTS[fault], seed, setup, repeats)
        try:
            found = measure_session(session).slice
        except InputError as error:
            return Trial(fault, seed, str(error).split("session/", 1)[-1])
    assert found
    rel = [found.total_r[c] / truth.total_r[c] - 1 for c in found.total_r]
    sd = [found.total_r_sd[c] / truth.total_r[c] for c in found.total_r]
    z = np.divide(rel, sd)
    decades = tuple(decade_z(found.channels[c], truth.channels[c], found.scale_rel_sd or 0.0) for c in found.channels)
    held_ = coefficients_held(found, setup)
    return Trial(fault, seed, None, found.flags, tuple(z.tolist()), tuple(rel), tuple(sd), decades, held_)


def coefficients_held(found: Slice, setup: Setup) -> dict[str, bool]:
    """By coefficient, whether its 95 % interval holds the truth; empty where the fit gives none."""
    fitted, medium = fit_slice(found)["G"], scene(setup).sample.media["G"]
    if fitted.status not in ("converged", "upper_bound"):
        return {}
    intervals = {
        "sigma_a": (fitted.sigma_a_interval95_per_mm, medium.sigma_a),
        "sigma_sp": (fitted.sigma_sp_interval95_per_mm, medium.sigma_sp),
    }
    return {name: bool(low <= truth <= high) for name, ((low, high), truth) in intervals.items()}


def decade_z(found: ChannelSlice, truth: ChannelSlice, scale_rel_sd: float) -> tuple[float, ...]:
    """Departure of the mean of each decade of a curve over the error of that mean."""
    order = np.argsort(truth.r_mm)
    expected = np.interp(found.r_mm, truth.r_mm[order], truth.rd_per_mm2[order])
    share = expected / expected.max()
    judged = (share > _LEAST_SHARE) & (found.sd_per_mm2 < _CLEAR * expected)
    out = []
    for decade in range(round(-np.log10(_LEAST_SHARE))):
        here = judged & (share <= 10.0**-decade) & (share > 10.0 ** -(decade + 1))
        if here.any():
            weight = (expected / found.sd_per_mm2)[here] ** 2
            off = float(np.average((found.rd_per_mm2 / expected)[here] - 1, weights=weight))
            out.append(off / float(np.hypot(weight.sum() ** -0.5, scale_rel_sd)))
    return tuple(out)


def table(trials: Sequence[Trial]) -> str:
    """A line for each fault, as Markdown."""
    heads = (
        "sessions",
        "refused",
        "R held",
        "decades held",
        "σa held",
        "σs′ held",
        "no ±",
        "R off, median %",
        "stated %",
    )
    lines = [f"| fault | {' | '.join(heads)} | flags |", f"|---|{'---:|' * len(heads)}---|"]
    for fault in dict.fromkeys(t.fault for t in trials):
        own = [t for t in trials if t.fault == fault]
        kept = [t for t in own if t.refused is None]
        totals = np.abs([z for t in kept for z in t.total_z])
        decades = np.abs([z for t in kept for channel in t.decade_z for z in channel])
        off = 100 * np.median(np.abs([r for t in kept for r in t.total_rel])) if kept else np.nan
        stated = 100 * np.median([s for t in kept for s in t.total_rel_sd]) if kept else np.nan
        flags = sorted({flag for t in kept for flag in t.flags})
        held_ = [f"{100 * np.mean(z < Z95):.0f} %" if z.size else "" for z in (totals, decades)]
        fitted = [t.coefficients_held for t in kept if t.coefficients_held]
        held_ += [
            f"{100 * np.mean([each[name] for each in fitted]):.0f} %" if fitted else ""
            for name in ("sigma_a", "sigma_sp")
        ]
        lines.append(
            f"| {fault} | {len(own)} | {len(own) - len(kept)} | {' | '.join(held_)} | {len(kept) - len(fitted)} "
            f"| {off:.2f} | {stated:.2f} | {' '.join(flags)} |"
        )
    return "\n".join(lines)
