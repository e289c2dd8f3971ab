"""`bssrdf bench render`: error against time of points, walks, BRDF and volpath, each against the best truth there is.

Short seeded runs of all methods take turns in one process; times are CPU seconds, preparing included, compilation not.
A method's noise is the variance between its runs, which find the light under surfaces anew; its bias is its mean
against what is known in closed form (even sky, shadow's edge, white furnace), or against a long run of volpath, which
states its own error.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bssrdf.bench.render_cases import MATERIALS, METHODS, REFERENCE, Floats, RenderCase, cases
from bssrdf.bench.render_results import CaseResult, ResultRow, write_results
from bssrdf.bench.render_truth import cut_share
from bssrdf.errors import UsageError
from bssrdf.measure import Progress
from bssrdf.render import EPSILON, Stage, body_mask, find_medium, load_stage, render_pass
from bssrdf.session import make_folder

REFERENCE_SE = 0.003
_REFERENCE_SEED = 1_000_000
_LEAST_RUNS = 4
_TILES = 5
"""A side, over which pictures are averaged before their bias is told from noise."""


@dataclass(frozen=True)
class Effort:
    """How much is rendered for each case."""

    pixels: int = 64
    runs: int = 4
    warm: int = 1
    """Runs before those, for compilation."""
    samples: int = 16
    """Per pixel and run, of all but volpath."""
    mc_samples: int = 4
    reference_s: float = 60.0
    """CPU time for a reference, which stops before where the error of its mean is below REFERENCE_SE."""
    mc_depth: int = 1000
    materials: tuple[str, ...] = MATERIALS
    scenes: tuple[str, ...] | None = None


QUICK = Effort(12, 2, 0, 4, 2, 0.5, 40, ("Skin1",), ("edge", "furnace", "ball 1, matched"))


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
    """All methods in turns, then the reference where the truth is not known."""
    images: dict[str, list[Floats]] = {method: [] for method in case.methods}
    prepare_s: dict[str, list[float]] = {method: [] for method in case.methods}
    draw_s: dict[str, list[float]] = {method: [] for method in case.methods}
    for run in range(effort.runs + effort.warm):
        for method in case.methods:
            stage, prepared = _prepared(case, method, effort, run)
            began = time.process_time()
            image = _image(stage, _samples(method, effort), run)
            if run >= effort.warm:
                images[method].append(image)
                prepare_s[method].append(prepared)
                draw_s[method].append(time.process_time() - began)
    truth, cut = _truth(case, effort)
    mask = body_mask(load_stage(case.scene, METHODS[case.methods[0]]))
    rows = [
        replace(
            _row(case, method, np.stack(images[method]), truth, mask),
            samples=_samples(method, effort),
            prepare_s=float(np.median(prepare_s[method])),
            draw_s=float(np.median(draw_s[method])),
        )
        for method in case.methods
    ]
    return CaseResult(tuple(rows), case.truth is None, tuple(_relative_se(truth)), cut)


def _prepared(case: RenderCase, method: str, effort: Effort, seed: int) -> tuple[Stage, float]:
    """The scene anew, its light found from that seed, and the CPU time that took."""
    stage = load_stage(case.scene, replace(METHODS[method], mc_depth=effort.mc_depth, seed=seed))
    began = time.process_time()
    if hasattr(stage.integrator, "prepare"):
        stage.integrator.prepare(stage.scene, stage.scene.sensors()[0])
    return stage, time.process_time() - began


def _truth(case: RenderCase, effort: Effort) -> tuple[Floats, tuple[float, ...]]:
    """Images that are true in the mean, (n, h, w, 3), and the share of light that their longest paths cut off."""
    if case.truth is not None:
        return np.asarray(case.truth)[None], (0.0,) * 3
    stage = load_stage(case.scene, replace(METHODS[REFERENCE], mc_depth=effort.mc_depth))
    images: list[Floats] = []
    began = time.process_time()
    while len(images) < _LEAST_RUNS or (
        max(_relative_se(np.stack(images))) > REFERENCE_SE and time.process_time() - began < effort.reference_s
    ):
        images.append(_image(stage, effort.mc_samples, _REFERENCE_SEED + len(images)))
    stack = np.stack(images)
    return stack, _cut(case, effort, stack)


def _relative_se(images: Floats) -> Floats:
    """Of the mean of all images, by channel; 0 for what is known."""
    means = images.mean(axis=(1, 2))
    if len(means) == 1:
        return np.zeros(means.shape[1])
    return np.asarray(means.std(axis=0, ddof=1) / math.sqrt(len(means)) / np.maximum(means.mean(axis=0), 1e-30))


def _row(case: RenderCase, method: str, images: Floats, truth: Floats, mask: Any) -> ResultRow:
    """Without its times."""
    mean = images.mean(axis=(0, 1, 2))
    ratio = mean / truth.mean(axis=(0, 1, 2))
    error = ratio * np.hypot(_relative_se(images), _relative_se(truth))
    target = _target(_smooth(images, truth))
    noise = (images.var(axis=0, ddof=1) / target)[mask].mean()
    return ResultRow(
        case.scene_name,
        case.material,
        method,
        0,
        math.nan,
        math.nan,
        float(noise),
        _triple(ratio),
        _triple(error),
        _bias(_tiled(images), _tiled(truth)),
        _worst(images, truth),
    )


def _smooth(images: Floats, truth: Floats) -> Floats:
    """What pixels are compared with: the truth where it is known, else the picture's own mean over its runs."""
    return truth[0] if len(truth) == 1 else images.mean(axis=0)


def _target(mean: Floats) -> Floats:
    """The denominator of relative errors, as in `render.compare`."""
    return np.square(mean) + EPSILON * np.square(mean.mean(axis=(0, 1)))


def _worst(images: Floats, truth: Floats) -> float:
    """Largest relative error of a column's mean, which noise hides least; NaN where the truth is not known."""
    if len(truth) > 1:
        return math.nan
    columns, known = images.mean(axis=(0, 1)), truth[0].mean(axis=0)
    return float(np.max(np.abs(columns / np.maximum(known, 1e-30) - 1)))


def _tiled(images: Floats) -> Floats:
    """Means over tiles, (runs, tiles, tiles, 3)."""
    runs, height, width, channels = images.shape
    high, wide = min(_TILES, height), min(_TILES, width)
    cut = images[:, : height // high * high, : width // wide * wide]
    return cut.reshape(runs, high, height // high, wide, width // wide, channels).mean(axis=(2, 4))


def _bias(images: Floats, truth: Floats) -> float:
    """relMSE less what the noise of both accounts for; may come out below 0."""
    target = truth.mean(axis=0)
    noise = images.var(axis=0, ddof=1) / len(images)
    if len(truth) > 1:
        noise = noise + truth.var(axis=0, ddof=1) / len(truth)
    return float(((np.square(images.mean(axis=0) - target) - noise) / _target(target)).mean())


def _cut(case: RenderCase, effort: Effort, reference: Floats) -> tuple[float, ...]:
    """From what half the depth loses, with the same seeds and hence the same paths."""
    half = load_stage(case.scene, replace(METHODS[REFERENCE], mc_depth=effort.mc_depth // 2))
    shorter = np.stack([_image(half, effort.mc_samples, _REFERENCE_SEED + run) for run in range(2)]).mean(
        axis=(0, 1, 2)
    )
    longer = reference[:2].mean(axis=(0, 1, 2))
    material = find_medium(case.material)
    albedo = [s / (s + a) for a, s in zip(material.sigma_a, material.sigma_s, strict=True)]
    return _triple((longer - shorter) / longer * [cut_share(each, effort.mc_depth) for each in albedo])


def _samples(method: str, effort: Effort) -> int:
    return effort.mc_samples if method == REFERENCE else effort.samples


def _image(stage: Stage, samples: int, seed: int) -> Floats:
    return render_pass(stage, samples, seed).astype(np.float64)


def _triple(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
