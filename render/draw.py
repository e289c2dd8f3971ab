"""Draws a picture in passes until it is as good as asked or time is up: all of it first, then where noise is left."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bssrdf.render.passes import Mask, Passes
from bssrdf.render.picture import Picture, Progress, Stage, load_stage, render_pass, render_pixels
from bssrdf.render.plugins import RenderOptions
from bssrdf.render.scenes.record import Scene

SAMPLES_PER_PASS = 4
MOST_SAMPLES = 256
"""Where noise falls so slowly that a goal is out of reach."""
_AT_ONCE = 16
"""Samples over all pixels, for memory. Few pixels may take as many: a pass costs a fifth of a second to begin."""
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
    on_bodies = body_mask(stage)
    passes = Passes(*on_bodies.shape)
    times: list[float] = []
    while (todo := _todo(passes, size, on_bodies, goal, began, times)) is not None:
        if progress is not None:
            done, left = passes.samples.sum(), todo.left
            progress(f"{stage.name}, {options.model}", int(done / on_bodies.size), int((done + left) / on_bodies.size))
        start = time.perf_counter()
        _draw(stage, passes, todo, seed * 100_003 + passes.count)
        times.append(time.perf_counter() - start)
        if say is not None and goal.samples is None and passes.count == _LEAST_PASSES:
            say(_forecast(passes, on_bodies, goal, prepare_s, times))
    if not np.any(passes.mean):
        warnings.warn(f"{stage.name}: the picture is black; no light reaches what the camera sees", stacklevel=2)
    compile_s = max(0.0, times[0] - times[1])
    return Picture(
        passes.mean,
        passes.variance(),
        round(float(passes.samples.mean())),
        sum(times) - compile_s,
        compile_s,
        prepare_s,
        passes.noise(on_bodies),
    )


class _Todo(NamedTuple):
    """The next pass: samples per pixel, of which pixels, None for all; and samples that are left in all."""

    samples: int
    where: Mask | None
    left: float


def _prepare(stage: Stage, progress: Progress | None) -> float:
    """Time to find the light under surfaces, where the integrator does so."""
    began = time.perf_counter()
    if hasattr(stage.integrator, "prepare"):
        stage.integrator.prepare(stage.scene, stage.scene.sensors()[0], progress)
    return time.perf_counter() - began


def _todo(passes: Passes, size: int, on_bodies: Mask, goal: Goal, began: float, times: list[float]) -> _Todo | None:
    """The next pass, None where the goal is met."""
    pixels = on_bodies.size
    if goal.samples is not None:
        left = max(2, round(goal.samples / size)) - passes.count
        return _Todo(size, None, left * size * pixels) if left > 0 else None
    if passes.count < _LEAST_PASSES:
        return _Todo(size, None, (_LEAST_PASSES - passes.count) * size * pixels)
    if goal.time_s is not None:
        rest = (goal.time_s - (time.perf_counter() - began)) / min(times)
        return _Todo(size, None, math.ceil(rest) * size * pixels) if rest >= 1 else None
    if passes.noise(on_bodies) <= goal.noise:
        return None
    return _of_noisy_pixels(passes, on_bodies, goal)


def _of_noisy_pixels(passes: Passes, on_bodies: Mask, goal: Goal) -> _Todo | None:
    """More samples where the goal is not met: twice as many as meet it, were all noise known and there."""
    excess = passes.excess(on_bodies, goal.noise)
    where = (excess > 1) & (passes.samples < MOST_SAMPLES)
    if not where.any():
        return None
    had, chosen = passes.samples[where], np.count_nonzero(where)
    left = np.minimum(excess[where] * had, MOST_SAMPLES) - had
    enough = 2 * (passes.noise(on_bodies) / goal.noise) ** 2 - 1
    samples = min(left.mean(), enough * had.mean(), _AT_ONCE * on_bodies.size / chosen)
    side = max(math.isqrt(int(samples)), math.isqrt(SAMPLES_PER_PASS))
    return _Todo(side**2, where, float(left.sum()))


def _draw(stage: Stage, passes: Passes, todo: _Todo, seed: int) -> None:
    if todo.where is None:
        passes.add(render_pass(stage, todo.samples, seed), todo.samples)
    elif stage.scene.sensors()[0].film().rfilter().is_box_filter():
        passes.add(render_pixels(stage, todo.where, todo.samples, seed), todo.samples, todo.where)
    else:  # neighbours share samples
        passes.add(render_pass(stage, SAMPLES_PER_PASS, seed), SAMPLES_PER_PASS)


def _forecast(passes: Passes, on_bodies: Mask, goal: Goal, prepare_s: float, times: list[float]) -> str:
    drawn, noise = float(passes.samples.mean()), passes.noise(on_bodies)
    told = f"prepared in {prepare_s:.1f} s; noise {noise:.1%} after {drawn:.0f} samples per pixel"
    todo = None if noise <= goal.noise or goal.noise == 0 else _of_noisy_pixels(passes, on_bodies, goal)
    if todo is None:
        return told
    left = todo.left / on_bodies.size
    return f"{told}; {goal.noise:.0%} takes up to {left:.0f} more, {left * min(times) * passes.count / drawn:.0f} s"


def body_mask(stage: Stage) -> Mask:
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
