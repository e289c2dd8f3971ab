"""The scenes by name, each with the material that the paper, or its nearest figure, has in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from bssrdf.errors import UsageError
from bssrdf.render.material import find_medium
from bssrdf.render.scenes.blocks import block, slab, texture
from bssrdf.render.scenes.figures import bust, face
from bssrdf.render.scenes.milk import milk
from bssrdf.render.scenes.record import Scene


class Entry(NamedTuple):
    """How a scene is built, and what it is made of if nothing else is asked for."""

    build: Callable[..., Scene]
    material: str
    g: float | None = None
    roughness: float = 0.0
    takes: tuple[str, ...] = ()
    """Options of its own."""


SCENES = {
    "slab": Entry(slab, "Marble", takes=("light",)),
    "block": Entry(block, "Marble"),
    "bust": Entry(bust, "Marble", takes=("mesh",)),
    "milk": Entry(milk, "Skimmilk"),
    "face": Entry(face, "Skin1", g=0.85, roughness=0.3, takes=("mesh",)),
    "texture": Entry(texture, "Marble", takes=("texture_path",)),
}


def build_scene(
    name: str,
    *,
    material: str | None = None,
    g: float | None = None,
    roughness: float | None = None,
    width_px: int | None = None,
    own: Mapping[str, Any] | None = None,
) -> Scene:
    """The scene of that name, of a published material or a fit; `own` are options that only some scenes take.

    Raises UsageError for a scene that is not there or does not take an option.
    """
    if name not in SCENES:
        raise UsageError(f'there is no scene "{name}"; use {", ".join(SCENES)}, or a Mitsuba .xml file')
    entry = SCENES[name]
    given = {key: value for key, value in (own or {}).items() if value is not None}
    for key in given.keys() - set(entry.takes):
        takers = [other for other, each in SCENES.items() if key in each.takes]
        raise UsageError(f"the scene {name} takes no {key.removesuffix('_path')}; {', '.join(takers)} does")
    if g is None and material is None:
        g = entry.g
    alpha = entry.roughness if roughness is None else roughness
    scene = entry.build(find_medium(material or entry.material, g=g), roughness=alpha, **given)
    if width_px is None:
        return scene
    width, height = scene.camera.pixels
    return replace(scene, camera=replace(scene.camera, pixels=(width_px, round(width_px * height / width))))
