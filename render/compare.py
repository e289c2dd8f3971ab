"""One scene by every model: pictures side by side, their difference, errors and times."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bssrdf.render.draw import Goal, render
from bssrdf.render.picture import EPSILON, Picture, Pixels, Progress, exposure, shown, write_pictures
from bssrdf.render.plugins import Model, RenderOptions
from bssrdf.render.scenes.record import Scene
from bssrdf.session import atomic_write

TILES = 24
"""A side, over which bias is told from noise and differences are drawn."""
_NOISIEST = 1.0
"""Range of the difference's colour scale, relative to the reference."""


@dataclass(frozen=True)
class Score:
    """A picture against the reference, over the pixels that the reference lights."""

    model: Model
    samples: int
    seconds: float
    compile_s: float
    prepare_s: float
    mean: float
    mean_ratio: float
    mean_ratio_se: float
    rel_mse: float
    """Of pixels, the noise of both pictures included."""
    rel_mse_bias: float
    """Of tiles, less the noise that their variances account for; may come out below 0."""


def compare_models(
    scene: Scene | Path,
    options: RenderOptions,
    models: tuple[Model, ...],
    *,
    goal: Goal,
    mc_samples: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[dict[Model, Picture], list[Score]]:
    """Render by each model, and score against the last one, which is the reference.

    mc takes `mc_samples` per pixel, or as many as the model before it did.
    """
    pictures: dict[Model, Picture] = {}
    for model in models:
        if model == "mc":
            goal = Goal(samples=mc_samples or max(picture.samples for picture in pictures.values()))
        pictures[model] = render(scene, replace(options, model=model), goal, seed=seed, progress=progress)
    reference = pictures[models[-1]]
    return pictures, [score(model, picture, reference) for model, picture in pictures.items()]


def score(model: Model, picture: Picture, reference: Picture) -> Score:
    """relMSE with ε = 0.01 mean², and the ratio of the means with its standard error."""
    mean, target = float(picture.radiance.mean()), float(reference.radiance.mean())
    same = picture is reference
    ratio = mean / target if target > 0 else math.nan
    errors = [_relative_se(each) for each in (picture, reference)]
    tile = _tile_side(reference.radiance)
    smooth = tiled(reference.radiance, tile)
    denominator = np.square(smooth) + EPSILON * target**2
    whole = np.repeat(np.repeat(denominator, tile, axis=0), tile, axis=1)
    difference = picture.radiance - reference.radiance
    squares = np.square(difference[: whole.shape[0], : whole.shape[1]]) / whole
    noise = tiled(picture.variance + reference.variance, tile) / tile**2
    bias = 0.0 if same else float(((np.square(tiled(difference, tile)) - noise) / denominator).mean())
    return Score(
        model,
        picture.samples,
        picture.seconds,
        picture.compile_s,
        picture.prepare_s,
        mean,
        ratio,
        0.0 if same else ratio * math.hypot(*errors),
        float(squares.mean()),
        bias,
    )


def tiled(image: Pixels, tile: int) -> Pixels:
    """Means over squares of `tile` pixels a side; what is left over at the sides is cut off."""
    high, wide = image.shape[0] // tile, image.shape[1] // tile
    cut = image[: high * tile, : wide * tile]
    return np.asarray(cut.reshape(high, tile, wide, tile, -1).mean(axis=(1, 3)), np.float32)


def _tile_side(image: Pixels) -> int:
    return max(1, min(image.shape[:2]) // TILES)


def scores_text(scores: list[Score]) -> str:
    """A table, one line a model."""
    lines = [
        "| model | samples | prepare s | seconds | mean | of the reference | relMSE | of the bias |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {each.model} | {each.samples} | {each.prepare_s:.1f} | {each.seconds:.1f} | {each.mean:.5g} | "
        f"{each.mean_ratio:.4f} ± {each.mean_ratio_se:.4f} | {each.rel_mse:.4g} | {each.rel_mse_bias:.4g} |"
        for each in scores
    ]
    return "\n".join(lines)


def write_comparison(
    folder: Path, pictures: Mapping[Model, Picture], scores: list[Score], provenance: Mapping[str, Any]
) -> None:
    """Fill the folder: a picture of each model as EXR and PNG, compare.png and compare.json."""
    for model, picture in pictures.items():
        write_pictures(folder / model, picture, {**provenance, "model": model})
    draw_comparison(folder / "compare.png", {model: picture.radiance for model, picture in pictures.items()})
    document = {"provenance": dict(provenance), "scores": [asdict(each) for each in scores]}
    with atomic_write(folder / "compare.json") as part:
        part.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def draw_comparison(path: Path, images: Mapping[Model, Pixels]) -> None:
    """All pictures at one exposure, and under each its relative difference from the last, by tiles."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    *others, reference = images
    factor = max(exposure(image) for image in images.values())
    rows = 2 if others else 1
    figure = Figure(figsize=(3.2 * len(images), 3.0 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, len(images), squeeze=False)
    for axes in panels.flat:
        axes.set_axis_off()
    for axes, (model, image) in zip(panels[0], images.items(), strict=True):
        axes.imshow(shown(image, factor))
        axes.set_title(model)
    target = _grey_tiles(images[reference])
    for axes, model in zip(panels[-1], others, strict=False):
        difference = (_grey_tiles(images[model]) - target) / np.sqrt(target**2 + EPSILON * target.mean() ** 2)
        drawn = axes.imshow(difference, cmap="RdBu_r", vmin=-_NOISIEST, vmax=_NOISIEST)
        axes.set_title(f"{model} / {reference} − 1")
    if others:
        figure.colorbar(drawn, ax=panels[-1], shrink=0.8)
    _write(figure, path)


def _grey_tiles(image: Pixels) -> Pixels:
    return tiled(image, _tile_side(image)).mean(axis=2)


def _write(figure: Any, path: Path) -> None:
    save: Callable[..., None] = figure.savefig
    with atomic_write(path) as part:
        save(part, dpi=110, format="png")


def _relative_se(picture: Picture) -> float:
    """Of the mean over all pixels, which are independent."""
    mean = float(picture.radiance.mean())
    return math.sqrt(float(picture.variance.sum())) / picture.radiance.size / mean if mean > 0 else math.nan
