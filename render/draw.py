"""Draws a picture in passes of their own seeds, which give its noise, until it is as good as asked or time is up."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.render.picture import EPSILON, Picture, Pixels, Progress, Stage, load_stage, render_pass
from bssrdf.render.plugins import RenderOptions
from bssrdf.render.scenes.record import Scene

SAMPLES_PER_PASS = 8
MOST_SAMPLES = 256
"""Where noise falls so slowly that a goal is out of reach."""
_LEAST_PASSES = 2
"""Fewer do not tell their scatter."""


@dataclass(frozen=True)
class Goal:
    """When a picture is done: after `samples` per pixel where given, at that noise, or when the time is up."""

    noise: float = 0.02
    """Of pixels of translucent bodies: root mean square, relative."""
    samples: int | None = None
    time_s: float | None = None
    """In all, preparing included; alone, all of it is used."""


@dataclass(frozen=True)
class Quality:
    """A goal, and how finely the light under surfaces is found for it."""

    goal: Goal
    light_samples: int
    walks: int


QUALITIES = {
    "draft": Quality(Goal(noise=0.06), light_samples=2, walks=8),
    "final": Quality(Goal(noise=0.02), light_samples=5, walks=16),
}


@dataclass
class _Passes:
    """Mean and variance of passes so far (Welford)."""

    mean: NDArray[np.float64]
    squares: NDArray[np.float64]
    count: int = 0

    def add(self, image: Pixels) -> None:
        self.count += 1
        step = image - self.mean
        self.mean += step / self.count
        self.squares += step * (image - self.mean)

    def variance(self) -> NDArray[np.float64]:
        """Of the mean."""
        return self.squares / max(self.count - 1, 1) / self.count


def render(
    scene: Scene | Path,
    options: RenderOptions,
    goal: Goal = Goal(),
    *,
    seed: int = 0,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> Picture:
    """Render the scene until the goal is met; `say` is told what is left to do once that is known."""
    began = time.perf_counter()
    stage = load_stage(scene, options)
    if say is not None and stage.chosen:
        say(f"auto: {stage.chosen}")
    prepare_s = _prepare(stage, progress)
    size = SAMPLES_PER_PASS if goal.samples is None else max(1, min(SAMPLES_PER_PASS, goal.samples // 2))
    wanted = None if goal.samples is None else max(2, round(goal.samples / size))
    on_bodies = body_mask(stage)
    passes = _Passes(np.zeros(()), np.zeros(()))
    times: list[float] = []
    noise = math.inf
    while not _is_done(passes.count, wanted, noise, goal, began, times):
        if progress is not None:
            progress(f"{stage.name}, {options.model}", passes.count, _expected(passes.count, wanted, noise, goal))
        start = time.perf_counter()
        image = render_pass(stage, size, seed * 100_003 + passes.count)
        if passes.count == 0:
            passes = _Passes(np.zeros(image.shape), np.zeros(image.shape))
        passes.add(image)
        times.append(time.perf_counter() - start)
        noise = relative_noise(passes.mean, passes.variance(), on_bodies) if passes.count >= 2 else math.inf
        if say is not None and wanted is None and passes.count == _LEAST_PASSES:
            say(_forecast(passes.count, size, noise, goal, prepare_s, times))
    if not np.any(passes.mean):
        warnings.warn(f"{stage.name}: the picture is black; no light reaches what the camera sees", stacklevel=2)
    compile_s = max(0.0, times[0] - float(np.median(times[1:])))
    return Picture(
        passes.mean.astype(np.float32),
        passes.variance().astype(np.float32),
        size * passes.count,
        sum(times) - compile_s,
        compile_s,
        prepare_s,
        noise,
    )


def _prepare(stage: Stage, progress: Progress | None) -> float:
    """Time to find the light under surfaces, where the integrator does so."""
    began = time.perf_counter()
    if hasattr(stage.integrator, "prepare"):
        stage.integrator.prepare(stage.scene, stage.scene.sensors()[0], progress)
    return time.perf_counter() - began


def _is_done(count: int, wanted: int | None, noise: float, goal: Goal, began: float, times: list[float]) -> bool:
    if wanted is not None:
        return count >= wanted
    if count < _LEAST_PASSES:
        return False
    if goal.time_s is not None:
        return time.perf_counter() - began + min(times) > goal.time_s
    return noise <= goal.noise or count * SAMPLES_PER_PASS >= MOST_SAMPLES


def _expected(count: int, wanted: int | None, noise: float, goal: Goal) -> int:
    """Passes in all."""
    if wanted is not None:
        return wanted
    if count < _LEAST_PASSES or goal.noise == 0:
        return max(count + 1, _LEAST_PASSES)
    return max(count + 1, math.ceil(count * (noise / goal.noise) ** 2))


def _forecast(count: int, size: int, noise: float, goal: Goal, prepare_s: float, times: list[float]) -> str:
    told = f"prepared in {prepare_s:.1f} s; noise {noise:.1%} after {count * size} samples per pixel"
    if goal.noise == 0 or noise <= goal.noise:
        return told
    left = _expected(count, None, noise, goal) - count
    return f"{told}; {goal.noise:.0%} takes {left * size} more, {left * min(times):.0f} s"


def relative_noise(mean: NDArray[Any], variance: NDArray[Any], where: NDArray[np.bool_]) -> float:
    """Root mean square of the relative standard error of pixels, those far below the mean held to a tenth of it."""
    lit = where & (mean.max(axis=2) > 0)
    if not lit.any():
        return 0.0
    target = np.square(mean[lit]) + EPSILON * np.square(mean[lit].mean(axis=0))
    return float(np.sqrt((variance[lit] / np.maximum(target, 1e-30)).mean()))


def body_mask(stage: Stage) -> NDArray[np.bool_]:
    """Pixels in whose middle a translucent body is seen, (h, w); all where none is."""
    import mitsuba as mi

    from bssrdf.render.medium import Media

    sensor = stage.scene.sensors()[0]
    width, height = (int(each) for each in sensor.film().crop_size())
    x, y = ((np.arange(n, dtype=np.float32) + 0.5) / n for n in (width, height))
    middles = mi.Point2f(np.tile(x, height), np.repeat(y, width))
    ray, _ = sensor.sample_ray(0, 0.5, middles, mi.Point2f(0.5))
    hit = stage.scene.ray_intersect(ray)
    media = Media(stage.scene)
    seen = mi.Bool(False)
    for shape in media.shapes or [shape for shape in stage.scene.shapes() if shape.interior_medium() is not None]:
        seen |= hit.is_valid() & (hit.shape == mi.ShapePtr(shape))
    mask = np.resize(np.array(seen, bool), height * width).reshape(height, width)
    return mask if mask.any() else np.ones_like(mask)
