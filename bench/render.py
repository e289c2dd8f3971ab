"""`bssrdf bench render`: noise and model bias of BRDF, BSSRDF and Monte Carlo, apart.

Short seeded runs of all methods take turns in one process, so that a busy machine slows them alike; compilation is
timed apart. The noise of a method is the variance between its runs, times their time; its bias is its mean against a
reference of its own seeds.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.render_cases import MATERIALS, METHODS, REFERENCE, RenderCase, cases
from bssrdf.bench.render_results import KNOWN, CaseResult, ResultRow, write_results
from bssrdf.bench.render_truth import cut_share, sky_radiance
from bssrdf.errors import UsageError
from bssrdf.measure import Progress
from bssrdf.render import EPSILON, RenderMaterial, Stage, find_medium, load_stage, render_pass
from bssrdf.session import make_folder

Floats = NDArray[np.float64]
REFERENCE_SE = 0.003
_REFERENCE_SEED = 1_000_000
_LEAST_RUNS = 4
_TILES = 5
"""A side, over which pictures are averaged before their bias is told from noise."""


@dataclass(frozen=True)
class Effort:
    """How much is rendered for each case."""

    pixels: int = 40
    runs: int = 5
    samples: int = 48
    """A pixel and run, of brdf and bssrdf."""
    mc_samples: int = 4
    reference_s: float = 15.0
    """Time for a reference, which stops before where the error of its mean is below REFERENCE_SE."""
    mc_depth: int = 1000
    materials: tuple[str, ...] = MATERIALS
    scenes: tuple[str, ...] | None = None


QUICK = Effort(8, 3, 4, 2, 0.5, 40, ("Marble",), ("slab, sky", "ball 3"))


def run_render_bench(
    out: Path | None, *, effort: Effort = Effort(), progress: Progress | None = None
) -> list[CaseResult]:
    """Measure every case; write render.json, render.md and render.png into `out` where it is given."""
    todo = list(cases(effort.pixels, materials=effort.materials, only=effort.scenes))
    unknown = set(effort.scenes or ()) - {case.scene_name for case in todo}
    if unknown:
        names = dict.fromkeys(case.scene_name for case in cases(effort.pixels, materials=MATERIALS[:1]))
        raise UsageError(f'there is no scene "{min(unknown)}" in the bench; use {"; ".join(names)}')
    results = []
    for number, case in enumerate(todo):
        if progress is not None:
            progress(f"{case.scene_name}, {case.material}", number, len(todo))
        results.append(measure(case, effort))
        if out is not None:
            make_folder(out)
            write_results(out, results, asdict(effort))
    return results


def measure(case: RenderCase, effort: Effort) -> CaseResult:
    """All methods in turns, then the reference."""
    stages, compile_s = {}, {}
    for method in case.methods:
        began = time.perf_counter()
        stages[method] = load_stage(case.scene, replace(METHODS[method], mc_depth=effort.mc_depth))
        render_pass(stages[method], _samples(method, effort), seed=0)
        compile_s[method] = time.perf_counter() - began
    images: dict[str, list[Floats]] = {method: [] for method in case.methods}
    times: dict[str, list[float]] = {method: [] for method in case.methods}
    for run in range(effort.runs):
        for method, stage in stages.items():
            began = time.perf_counter()
            images[method].append(_image(stage, _samples(method, effort), run + 1))
            times[method].append(time.perf_counter() - began)
    reference = _reference(stages[case.reference], _samples(case.reference, effort), effort.reference_s)
    rows = []
    for method in case.methods:
        row = _row(case, method, np.stack(images[method]), reference)
        seconds = float(np.median(times[method]))
        rows.append(
            replace(row, samples=_samples(method, effort), seconds=seconds, compile_s=compile_s[method] - seconds)
        )
    cut = _cut(case, effort, reference) if case.reference == REFERENCE else (math.nan,) * 3
    return CaseResult(tuple(rows), case.reference, cut, _known(case))


def _reference(stage: Stage, samples: int, limit_s: float) -> Floats:
    """Images of seeds of their own, until their mean is sure or the time is up."""
    images: list[Floats] = []
    began = time.perf_counter()
    while True:
        images.append(_image(stage, samples, _REFERENCE_SEED + len(images)))
        if len(images) < _LEAST_RUNS:
            continue
        stack = np.stack(images)
        if max(_relative_se(stack)) < REFERENCE_SE or time.perf_counter() - began > limit_s:
            return stack


def _relative_se(images: Floats) -> Floats:
    """Of the mean of all images, by channel."""
    means = images.mean(axis=(1, 2))
    return np.asarray(means.std(axis=0, ddof=1) / math.sqrt(len(means)) / np.maximum(means.mean(axis=0), 1e-30))


def _row(case: RenderCase, method: str, images: Floats, reference: Floats) -> ResultRow:
    """Without its times."""
    mean = images.mean(axis=(0, 1, 2))
    ratio = mean / reference.mean(axis=(0, 1, 2))
    error = ratio * np.hypot(_relative_se(images), _relative_se(reference))
    return ResultRow(
        case.scene_name,
        case.material,
        method,
        0,
        math.nan,
        math.nan,
        float((images.var(axis=0, ddof=1).mean(axis=(0, 1)) / np.square(mean)).mean()),
        _triple(mean),
        _triple(ratio),
        _triple(error),
        _bias(_tiled(images), _tiled(reference)),
    )


def _tiled(images: Floats) -> Floats:
    """Means over tiles, (runs, tiles, tiles, 3)."""
    runs, height, width, channels = images.shape
    high, wide = min(_TILES, height), min(_TILES, width)
    cut = images[:, : height // high * high, : width // wide * wide]
    return cut.reshape(runs, high, height // high, wide, width // wide, channels).mean(axis=(2, 4))


def _bias(images: Floats, reference: Floats) -> float:
    """relMSE less what the noise of both accounts for; may come out below 0."""
    target = reference.mean(axis=0)
    noise = images.var(axis=0, ddof=1) / len(images) + reference.var(axis=0, ddof=1) / len(reference)
    denominator = np.square(target) + EPSILON * np.square(target.mean(axis=(0, 1)))
    return float(((np.square(images.mean(axis=0) - target) - noise) / denominator).mean())


def _cut(case: RenderCase, effort: Effort, reference: Floats) -> tuple[float, ...]:
    """From what half the depth loses, with the same seeds and hence the same paths."""
    half = load_stage(case.scene, replace(METHODS[REFERENCE], mc_depth=effort.mc_depth // 2))
    count = _samples(REFERENCE, effort)
    shorter = np.stack([_image(half, count, _REFERENCE_SEED + run) for run in range(2)]).mean(axis=(0, 1, 2))
    longer = reference[:2].mean(axis=(0, 1, 2))
    material = find_medium(case.material)
    shares = [cut_share(albedo, effort.mc_depth) for albedo in _albedo(material)]
    return _triple((longer - shorter) / longer * shares)


def _albedo(material: RenderMaterial) -> list[float]:
    return [s / (s + a) for a, s in zip(material.sigma_a, material.sigma_s, strict=True)]


def _known(case: RenderCase) -> dict[str, tuple[float, ...]]:
    if case.scene_name != "slab, sky":
        return {}
    material = find_medium(case.material)
    (terms, truth), (printed, _) = sky_radiance(material), sky_radiance(material, paper=True)
    return dict(zip(KNOWN, map(_triple, (terms, printed, truth)), strict=True))


def _samples(method: str, effort: Effort) -> int:
    return effort.mc_samples if method == "mc" else effort.samples


def _image(stage: Stage, samples: int, seed: int) -> Floats:
    return render_pass(stage, samples, seed).astype(np.float64)


def _triple(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
