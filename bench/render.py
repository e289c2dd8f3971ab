"""`bssrdf bench render`: noise and model bias of BRDF, BSSRDF and Monte Carlo, apart.

Short seeded runs of all methods take turns in one process, so that a busy machine slows them alike; compilation is
timed apart. The noise of a method is the variance between its runs, times their time; its bias is its mean against a
reference of its own seeds.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.render_cases import MATERIALS, METHODS, REFERENCE, Case, cases
from bssrdf.bench.render_truth import cut_share, sky_radiance
from bssrdf.render.compare import EPSILON
from bssrdf.render.material import RenderMaterial, find_medium
from bssrdf.render.picture import Stage, load_stage, render_pass
from bssrdf.session.atomic import make_folder

Progress = Callable[[str, int, int], None]
Floats = NDArray[np.float64]
KNOWN = ("terms", "terms, paper", "Monte Carlo table")
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


@dataclass(frozen=True)
class Row:
    """One method on one case; triples are by channel."""

    scene: str
    material: str
    method: str
    samples: int
    seconds: float
    """Median of a run."""
    compile_s: float
    variance: float
    """Of a pixel of one run, over the mean's square."""
    mean: tuple[float, ...]
    ratio: tuple[float, ...]
    """Of the means, to the reference."""
    ratio_se: tuple[float, ...]
    rel_mse_bias: float
    """relMSE of tiles less the noise of this method and of the reference; ε = 0.01 mean²."""

    @property
    def cost(self) -> float:
        """Variance × time [s]."""
        return self.variance * self.seconds


@dataclass(frozen=True)
class CaseResult:
    """The methods on one case, and how good its reference is."""

    rows: tuple[Row, ...]
    reference: str
    cut: tuple[float, ...]
    """Relative share of the light that the reference's longest path cuts off, estimated; by channel."""
    known: dict[str, tuple[float, ...]]
    """Means that are known without rendering."""


def run_render_bench(
    out: Path | None, *, effort: Effort = Effort(), progress: Progress | None = None
) -> list[CaseResult]:
    """Measure every case; write render.json, render.md and render.png into `out` where it is given."""
    todo = list(cases(effort.pixels, materials=effort.materials, only=effort.scenes))
    results = []
    for number, case in enumerate(todo):
        if progress is not None:
            progress(f"{case.scene_name}, {case.material}", number, len(todo))
        results.append(measure(case, effort))
        if out is not None:
            make_folder(out)
            write_results(out, results, effort)
    return results


def measure(case: Case, effort: Effort) -> CaseResult:
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


def _row(case: Case, method: str, images: Floats, reference: Floats) -> Row:
    """Without its times."""
    mean = images.mean(axis=(0, 1, 2))
    ratio = mean / reference.mean(axis=(0, 1, 2))
    error = ratio * np.hypot(_relative_se(images), _relative_se(reference))
    return Row(
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


def _cut(case: Case, effort: Effort, reference: Floats) -> tuple[float, ...]:
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


def _known(case: Case) -> dict[str, tuple[float, ...]]:
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


def table(results: list[CaseResult]) -> str:
    """A line a case and method; under a case what is known about its reference."""
    lines = [
        "| scene | material | method | s a run | compile s | variance × s | over bssrdf exact | mean ratio R, G, B "
        "| ± | relMSE of the bias |",
        "|---|---|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for result in results:
        exact = next(row for row in result.rows if row.method == "bssrdf exact")
        lines += [
            f"| {row.scene} | {row.material} | {row.method} | {row.seconds:.3f} | {row.compile_s:.1f} | {row.cost:.3g} "
            f"| {row.cost / exact.cost:.3g} | {_numbers(row.ratio, '.3f')} | {max(row.ratio_se):.3f} "
            f"| {row.rel_mse_bias:.3g} |"
            for row in result.rows
        ]
    return "\n".join([*lines, "", *_notes(results)])


def _notes(results: list[CaseResult]) -> list[str]:
    lines = []
    for result in results:
        row = result.rows[0]
        name = f"{row.scene}, {row.material}"
        if result.reference == REFERENCE:
            lines.append(
                f"- {name}: paths longer than the reference's carry {_numbers(result.cut, '.2%')} of its light"
            )
        if result.known:
            lines.append(f"- {name}: {_known_text(result)}")
    return lines


def _known_text(result: CaseResult) -> str:
    """Rendered over closed form, and the closed forms over Monte Carlo of a half space, which no path cuts off."""
    exact = np.array(_mean_of(result, "bssrdf exact"))
    terms, paper, truth = (np.array(result.known[key]) for key in KNOWN)
    return (
        f"bssrdf exact over the closed form of its terms {_numbers(exact / terms, '.4f')}; that sum over Monte Carlo "
        f"{_numbers(terms / truth, '.3f')}, with the paper's exit lobe {_numbers(paper / truth, '.3f')}"
    )


def _mean_of(result: CaseResult, method: str) -> tuple[float, ...]:
    return next(row.mean for row in result.rows if row.method == method)


def _numbers(values: Iterable[float], form: str) -> str:
    return " ".join(format(value, form) for value in values)


def write_results(out: Path, results: list[CaseResult], effort: Effort) -> None:
    """render.json, render.md and render.png."""
    document = {"effort": asdict(effort), "cases": [_document(result) for result in results]}
    (out / "render.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    (out / "render.md").write_text(table(results) + "\n", encoding="utf-8")
    _plot(out / "render.png", results)


def _document(result: CaseResult) -> dict[str, Any]:
    rows = [asdict(row) | {"variance_x_time": row.cost} for row in result.rows]
    return asdict(result) | {"rows": rows}


def _plot(path: Path, results: list[CaseResult]) -> None:
    """relMSE against time, one panel a scene, for its first material: noise falls with time, bias stays."""
    from matplotlib.figure import Figure

    first = {result.rows[0].scene: result for result in reversed(results)}
    columns = min(3, len(first))
    rows = math.ceil(len(first) / columns)
    figure = Figure(figsize=(3.8 * columns, 2.9 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True)
    seconds = np.geomspace(0.01, 1000, 60)
    for axes, result in zip(panels.flat, reversed(first.values()), strict=False):
        for row in result.rows:
            bias = 0.0 if row.method == result.reference else max(row.rel_mse_bias, 0.0)
            axes.loglog(seconds, bias + row.cost / seconds, label=row.method)
        axes.set_title(f"{result.rows[0].scene}, {result.rows[0].material}", fontsize=9)
        axes.set_xlabel("seconds")
        axes.set_ylabel("relMSE")
    panels.flat[0].legend(fontsize=7)
    for axes in panels.flat[len(first) :]:
        axes.set_axis_off()
    figure.savefig(path, dpi=110)
