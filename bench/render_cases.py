"""The scenes of `bssrdf bench render`, sized in the distance over which light spreads in the green channel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.render_truth import edge_radiance, sky_radiance
from bssrdf.render import HALF_ALBEDO, RenderMaterial, RenderOptions, find_medium, spread_mm
from bssrdf.render.scenes.blocks import slab
from bssrdf.render.scenes.figures import bust
from bssrdf.render.scenes.place import SKY, box, box_size, moved, paint, panel, sky
from bssrdf.render.scenes.record import Body, Scene, Viewpoint

Floats = NDArray[np.float64]
MATERIALS = ("Marble", "Skimmilk", "Skin1", "Ketchup", "Spectralon", HALF_ALBEDO)
RADII = (1.0, 3.0, 10.0)
"""Of the balls, in units of the spread: R σtr, where there is absorption."""
METHODS = {
    "brdf": RenderOptions("brdf"),
    "points": RenderOptions("bssrdf", method="points"),
    "walks": RenderOptions("bssrdf", method="walks"),
    "volpath": RenderOptions("mc"),
}
REFERENCE = "volpath"
FURNACE = RenderMaterial("white", (0.0, 0.0, 0.0), (1.0, 1.2, 1.5), 1.5)
FURNACE_MM = 4.0


@dataclass(frozen=True)
class RenderCase:
    """A scene of one material, the methods that can render it, and what it should show."""

    scene_name: str
    material: str
    scene: Scene
    methods: tuple[str, ...]
    truth: Floats | None = None
    """Radiance (height, width, 3); without it a long run of volpath stands for it."""


def cases(
    pixels: int, *, materials: tuple[str, ...] = MATERIALS, only: tuple[str, ...] | None = None
) -> Iterator[RenderCase]:
    """Every scene of every material, at `pixels` a side; `only` those scenes."""
    found = [case for name in materials for case in _of_material(find_medium(name), pixels)]
    for case in [_furnace(pixels), *found]:
        if only is None or case.scene_name in only:
            yield case


def _of_material(material: RenderMaterial, pixels: int) -> Iterator[RenderCase]:
    wide, green = max(spread_mm(material)), spread_mm(material)[1]
    flat = slab(material, light="sky", side_mm=60 * wide, thickness_mm=20 * wide)
    evenly = np.broadcast_to(sky_radiance(material), (pixels, pixels, 3))
    yield RenderCase("sky", material.name, _sized(flat, pixels), ("brdf", "points", "walks", "volpath"), evenly)
    scene = _sized(edge(material, wide, 8 * green), pixels)
    places = ((np.arange(pixels) + 0.5) / pixels - 0.5) * 8 * green
    truth = np.broadcast_to(edge_radiance(material, places), (pixels, pixels, 3))
    yield RenderCase("edge", material.name, scene, ("brdf", "points"), truth)
    for radius in RADII:
        matched = replace(material, eta=1.0)
        yield RenderCase(
            f"ball {radius:g}, matched", material.name, _sized(ball(matched, radius * green), pixels), tuple(METHODS)
        )
    for radius in RADII:
        yield RenderCase(
            f"ball {radius:g}", material.name, _sized(ball(material, radius * green), pixels), tuple(METHODS)
        )
    yield RenderCase("bust", material.name, _sized(bust(material), pixels), tuple(METHODS))


def _furnace(pixels: int) -> RenderCase:
    """A ball that absorbs nothing, under an even sky: it shows the sky."""
    body = Body({"type": "sphere", "radius": FURNACE_MM}, FURNACE, FURNACE_MM)
    camera = Viewpoint((0, -6 * FURNACE_MM, 0), (0, 0, 0), width_mm=math.sqrt(2) * FURNACE_MM)
    scene = Scene("furnace", {"ball": body}, {SKY: sky(1.0)}, camera)
    return RenderCase("furnace", "white", _sized(scene, pixels), ("points", "walks"), np.ones((pixels, pixels, 3)))


def _sized(scene: Scene, pixels: int) -> Scene:
    return replace(scene, camera=replace(scene.camera, pixels=(pixels, pixels)))


def edge(material: RenderMaterial, spread: float, width_mm: float) -> Scene:
    """A half space under light along its normal, half of it shaded by a card; the camera looks from below the card."""
    side, deep = 60 * spread, 20 * spread
    body = Body(box((-side / 2, -side / 2, -deep), (side, side, deep)), material, box_size((side, side, deep)))
    card = {"type": "rectangle", "to_world": moved((-side, 0.0, side), (side, 2 * side, 1.0)), "bsdf": paint(0.0)}
    sun = {"type": "directional", "direction": [0.0, 0.0, -1.0], "irradiance": {"type": "rgb", "value": [1.0] * 3}}
    camera = Viewpoint((0.0, 0.0, side / 4), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), width_mm=width_mm)
    return Scene("edge", {"slab": body}, {"sun": sun}, camera, {"card": card}, narrow_light=True)


def ball(material: RenderMaterial, radius_mm: float) -> Scene:
    """A ball lit from one side by a panel, seen from the front."""

    def at(x: float, y: float, z: float) -> tuple[float, float, float]:
        return radius_mm * x, radius_mm * y, radius_mm * z

    body = Body({"type": "sphere", "radius": radius_mm}, material, radius_mm)
    lights = {
        "panel": panel(at(3.0, -0.5, 1.0), at(0, 0, 0), (1.2 * radius_mm, 1.2 * radius_mm), 10.0),
        SKY: sky(0.02),
    }
    width = 2 * math.sqrt(0.5) * radius_mm  # inside the outline: no pixel of the background
    camera = Viewpoint(at(0, -6.0, 0), at(0, 0, 0), width_mm=width)
    return Scene("ball", {"ball": body}, lights, camera)
