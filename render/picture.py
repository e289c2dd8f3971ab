"""Pictures and their noise, written as EXR and PNG, and the scenes that they are drawn from."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.render.plugins import RenderOptions, integrator, scene_dict
from bssrdf.render.scenes.record import Scene
from bssrdf.render.variant import cause, use_variant
from bssrdf.session import atomic_write

Pixels = NDArray[np.float32]
Progress = Callable[[str, int, int], None]
PROVENANCE = "bssrdf:provenance"
EPSILON = 0.01
"""Of the mean square, in the denominator of relative errors, so that dark pixels do not count for all."""
WHITE_PERCENTILE = 99.0
"""Of the lit pixels: the one that comes out just below white."""


@dataclass(frozen=True)
class Picture:
    """Radiance (h, w, 3) in linear sRGB, and the variance of each value from the scatter of the passes."""

    radiance: Pixels
    variance: Pixels
    samples: int
    """A pixel."""
    seconds: float
    """Of all passes, without the compilation that the first one holds."""
    compile_s: float
    prepare_s: float = 0.0
    """To find the light under surfaces before anything is drawn."""
    noise: float = math.nan
    """Of pixels of translucent bodies: root mean square of their relative standard error."""


class Stage(NamedTuple):
    """A scene that Mitsuba has loaded, and how it is rendered."""

    name: str
    scene: Any
    integrator: Any
    chosen: str = ""
    """How the light under surfaces is found, and why, where that was left open."""


def load_stage(scene: Scene | Path, options: RenderOptions, colour: Literal["rgb", "mono"] = "rgb") -> Stage:
    """One of our scenes, or a Mitsuba XML file; InputError where Mitsuba is missing, refuses it, or it has no light."""
    use_variant(colour)
    import mitsuba as mi

    from bssrdf.render.faults import faults, unit_faults
    from bssrdf.render.integrator import register

    register()
    name = str(scene) if isinstance(scene, Path) else f"scene {scene.name}"
    if isinstance(scene, Path) and not scene.is_file():
        raise InputError(f"{name}: is not there; check the path")
    try:
        loaded = mi.load_file(str(scene)) if isinstance(scene, Path) else mi.load_dict(scene_dict(scene, options))
        options, chosen = _with_method(loaded, options)
        stage = Stage(name, loaded, mi.load_dict(integrator(options)), chosen)
    except RuntimeError as error:
        raise InputError(f"{name}: {cause(error)}") from error
    if not loaded.emitters():
        raise InputError(f"{name}: has no light; add an emitter")
    if options.model != "mc":
        for line in faults(loaded) + (unit_faults(loaded) if isinstance(scene, Path) else []):
            warnings.warn(line, stacklevel=2)
    return stage


def _with_method(loaded: Any, options: RenderOptions) -> tuple[RenderOptions, str]:
    from bssrdf.render.choose import choose_method

    if options.model != "bssrdf" or options.method != "auto":
        return options, ""
    method, reason = choose_method(loaded)
    return replace(options, method=method), f"{method} ({reason})"


def render_pass(stage: Stage, samples: int, seed: int) -> Pixels:
    """One image (h, w, 3)."""
    import mitsuba as mi

    image = mi.render(stage.scene, integrator=stage.integrator, spp=samples, seed=seed)
    return np.array(image, dtype=np.float32)[..., :3]


def render_pixels(stage: Stage, where: NDArray[np.bool_], samples: int, seed: int) -> Pixels:
    """Some pixels of the image, (k, 3), those of `where` (h, w), as a box filter sees them."""
    import mitsuba as mi

    sensor = stage.scene.sensors()[0]
    sampler = sensor.sampler().fork()
    sampler.set_sample_count(samples)
    samples = sampler.sample_count()  # as the sampler fills a pixel
    sampler.set_samples_per_wavefront(samples)
    row, column = (np.repeat(index.astype(np.float32), samples) for index in np.nonzero(where))
    sampler.seed(seed, len(row))
    height, width = where.shape
    place = (mi.Vector2f(column, row) + sampler.next_2d()) / mi.Vector2f(width, height)
    ray, weight = sensor.sample_ray(0.0, sampler.next_1d(), mi.Point2f(place), sampler.next_2d())
    found = stage.integrator.sample(stage.scene, sampler, mi.RayDifferential3f(ray))[0]
    return np.array(mi.unpolarized_spectrum(found * weight), np.float32).reshape(3, -1, samples).mean(axis=2).T


def exposure(radiance: Pixels, percentile: float = WHITE_PERCENTILE) -> float:
    """Factor that brings the bright parts of a picture just below white."""
    luminance = radiance @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    lit = luminance[luminance > 1e-3 * max(float(luminance.max()), 1e-30)]
    return 0.8 / float(np.percentile(lit, percentile)) if lit.size else 1.0


def shown(radiance: Pixels, factor: float) -> NDArray[np.uint8]:
    """8-bit sRGB of linear radiance times a factor."""
    linear = np.clip(np.nan_to_num(radiance) * factor, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * encoded), dtype=np.uint8)


def write_pictures(
    stem: Path, picture: Picture, provenance: Mapping[str, Any], white_percentile: float = WHITE_PERCENTILE
) -> tuple[Path, Path]:
    """Write stem.exr, parts `radiance` and `variance`, and stem.png to look at; both hold the provenance."""
    from bssrdf.session import write_exr, write_png

    exr, png = stem.with_name(stem.name + ".exr"), stem.with_name(stem.name + ".png")
    attributes = {PROVENANCE: json.dumps(provenance)}
    with atomic_write(exr) as part:
        write_exr(part, [("radiance", picture.radiance), ("variance", picture.variance)], attributes)
    factor = exposure(picture.radiance, white_percentile)
    with atomic_write(png) as part:
        write_png(part, shown(picture.radiance, factor), {PROVENANCE: json.dumps({**provenance, "exposure": factor})})
    return exr, png
