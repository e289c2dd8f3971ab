"""The scenes of `bssrdf bench render`, sized in the distance over which light spreads in the green channel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from bssrdf.render import HALF_ALBEDO, RenderMaterial, RenderOptions, find_medium, spread_mm
from bssrdf.render.scenes.blocks import slab
from bssrdf.render.scenes.figures import bust
from bssrdf.render.scenes.place import panel, sky
from bssrdf.render.scenes.record import Body, Scene, Viewpoint

MATERIALS = ("Marble", "Skimmilk", "Skin1", "Ketchup", "Spectralon", HALF_ALBEDO)
RADII = (1.0, 3.0, 10.0, 30.0)
"""Of the balls, in units of the spread: R σtr, where there is absorption."""
METHODS = {
    "brdf": RenderOptions("brdf"),
    "points": RenderOptions("bssrdf"),
    "walks": RenderOptions("bssrdf", method="walks"),
    "mc": RenderOptions("mc"),
}
REFERENCE = "mc"


@dataclass(frozen=True)
class RenderCase:
    """A scene of one material, and the methods that can render it."""

    scene_name: str
    material: str
    scene: Scene
    methods: tuple[str, ...]
    reference: str
    """The method whose long run the others are scored against."""


def cases(
    pixels: int, *, materials: tuple[str, ...] = MATERIALS, only: tuple[str, ...] | None = None
) -> Iterator[RenderCase]:
    """Every scene of every material, at `pixels` a side; `only` those scenes."""
    for name in materials:
        material = find_medium(name)
        for scene_name, scene in _scenes(material).items():
            if only is not None and scene_name not in only:
                continue
            small = replace(scene, camera=replace(scene.camera, pixels=(pixels, pixels)))
            methods = tuple(method for method in METHODS if not (scene.narrow_light and method == REFERENCE))
            yield RenderCase(scene_name, name, small, methods, "points" if scene.narrow_light else REFERENCE)


def _scenes(material: RenderMaterial) -> dict[str, Scene]:
    spread = spread_mm(material)
    wide, green = max(spread), spread[1]
    half_space: dict[str, Any] = {"side_mm": 60 * wide, "thickness_mm": 20 * wide}
    found = {f"slab, {light}": slab(material, light=light, **half_space) for light in ("sky", "edge")}
    found["slab, beam"] = slab(material, light="beam", side_mm=max(60 * green, 10.0), thickness_mm=20 * wide)
    found |= {f"ball {radius:g}": ball(material, radius * green) for radius in RADII}
    found["thin slab"] = slab(material, light="sky", side_mm=40 * green, thickness_mm=green)
    found["bust"] = bust(material)
    return found


def ball(material: RenderMaterial, radius_mm: float) -> Scene:
    """A ball lit from one side by a panel, seen from the front."""

    def at(x: float, y: float, z: float) -> tuple[float, float, float]:
        return radius_mm * x, radius_mm * y, radius_mm * z

    body = Body({"type": "sphere", "radius": radius_mm}, material, radius_mm)
    lights = {
        "panel": panel(at(3.0, -0.5, 1.0), at(0, 0, 0), (1.2 * radius_mm, 1.2 * radius_mm), 10.0),
        "sky": sky(0.02),
    }
    width = 2 * math.sqrt(0.5) * radius_mm  # inside the outline: no pixel of the background
    camera = Viewpoint(at(0, -6.0, 0), at(0, 0, 0), width_mm=width)
    return Scene("ball", {"ball": body}, lights, camera)
