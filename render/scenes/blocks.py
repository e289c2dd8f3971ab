"""Flat-sided scenes: a slab under several lights, a cube in a laser beam, a tile whose coefficients vary."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError, UsageError
from bssrdf.render.material import RenderMaterial
from bssrdf.render.scenes.place import SKY, beam, box, box_size, moved, paint, panel, sky, table
from bssrdf.render.scenes.record import Body, Maps, Plugin, Scene, Viewpoint

LIGHTS = ("beam", "edge", SKY)
BEAM_RADIUS_MM = 0.25
BLOCK_MM = 40.0
"""The paper's cube."""
TILE_MM = 60.0
_MAP_PX = 256
_VEINS_SEED = 5


def slab(
    material: RenderMaterial, *, light: str = "beam", side_mm: float = 60.0, thickness_mm: float = 30.0, **look: Any
) -> Scene:
    """A slab seen from straight above, under a narrow `beam`, an even `sky`, or a lamp shaded by a card's `edge`."""
    if light not in LIGHTS:
        raise UsageError(f'light "{light}" is not one of {", ".join(LIGHTS)}')
    sides = (side_mm, side_mm, thickness_mm)
    body = Body(box((-side_mm / 2, -side_mm / 2, -thickness_mm), sides), material, box_size(sides), **look)
    camera = Viewpoint((0.0, 0.0, side_mm / 200), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), width_mm=side_mm / 3)
    lights: dict[str, dict[str, Plugin]] = {
        "beam": {"beam": beam((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), BEAM_RADIUS_MM, flux=1.0)},
        "edge": {"lamp": panel((0.0, -side_mm, side_mm), (0.0, 0.0, 0.0), (0.3 * side_mm,) * 2, radiance=10.0)},
        SKY: {SKY: sky(1.0)},
    }
    card = {"card": _card(side_mm)} if light == "edge" else {}
    return Scene("slab", {"slab": body}, lights[light], camera, card, narrow_light=light == "beam")


def _card(side_mm: float) -> Plugin:
    """Black, close over the half x < 0; the camera looks from below it."""
    return {
        "type": "rectangle",
        "to_world": moved((-side_mm / 2, 0.0, side_mm / 100), (side_mm / 2, side_mm, 1.0)),
        "bsdf": {"type": "twosided", "bsdf": paint(0.0)},
    }


def block(material: RenderMaterial, **look: Any) -> Scene:
    """The paper's Fig. 8: a cube, and a beam that enters it beside an edge."""
    side = BLOCK_MM
    sides = (side, side, side)
    body = Body(box((-side / 2, -side / 2, 0.0), sides), material, box_size(sides), **look)
    spot = (-side / 2 + 3.0, -side / 2, side - 12.0)
    lights = {
        "laser": beam((100.0, -1000.0, 300.0), spot, 0.8, flux=100.0),
        "window": panel((0.0, 80.0, 220.0), (0.0, 0.0, 25.0), (50.0, 50.0), radiance=0.12, colour=(0.75, 0.9, 1.2)),
        SKY: sky(0.003),
    }
    camera = Viewpoint((-82.0, -100.0, 72.0), (-3.0, -3.0, 17.0), fov_deg=26.0)
    furniture = {"table": table(paint(0.0))}  # else light of the spot comes back by it, found by one path in a million
    return Scene("block", {"block": body}, lights, camera, furniture, narrow_light=True, white_percentile=97.0)


def texture(material: RenderMaterial, *, texture_path: Path | None = None, **look: Any) -> Scene:
    """A tile whose albedo an image scales, or veins without one; lit from low on one side."""
    maps = _maps(material, _image(texture_path) if texture_path else _veins())
    sides = (TILE_MM, TILE_MM, 12.0)
    body = Body(box((-TILE_MM / 2, -TILE_MM / 2, 0.0), sides), material, box_size(sides), maps=maps, **look)
    lights = {"panel": panel((-70.0, 30.0, 60.0), (0.0, 0.0, 0.0), (25.0, 25.0), radiance=9.0), SKY: sky(0.2)}
    camera = Viewpoint((0.0, -90.0, 110.0), (0.0, 0.0, 6.0), fov_deg=30.0)
    return Scene("texture", {"tile": body}, lights, camera, {"table": table(paint(0.3))})


def _maps(material: RenderMaterial, tone: NDArray[np.float32]) -> Maps:
    """Coefficients at the material's 1/σt′, absorbing more where `tone` (h, w, 3), from 0 to 1, is dark."""
    sigma_a, sigma_sp = np.array(material.sigma_a), np.array(material.sigma_sp)
    moved = np.square(1 - np.clip(tone, 0, 1)) * sigma_sp / 4
    return Maps((sigma_a + moved).astype(np.float32), (sigma_sp - moved).astype(np.float32))


def _image(path: Path) -> NDArray[np.float32]:
    """An image file as values from 0 to 1, shape (h, w, 3)."""
    from bssrdf.session import read_image

    if not path.is_file():
        raise InputError(f"{path}: there is no such texture; check the path, or leave --texture out for veins")
    data = read_image(path).data
    scale = float(np.iinfo(data.dtype).max) if np.issubdtype(data.dtype, np.integer) else 1.0
    values = (data[..., :3] if data.shape[2] >= 3 else data[..., :1]).astype(np.float32) / scale
    return np.broadcast_to(values, (*values.shape[:2], 3))


def _veins() -> NDArray[np.float32]:
    """Dark veins on white, the same at every run."""
    rng = np.random.default_rng(_VEINS_SEED)
    x, y = np.meshgrid(np.linspace(0, 1, _MAP_PX), np.linspace(0, 1, _MAP_PX))
    warp = np.zeros_like(x)
    for octave in range(1, 5):
        kx, ky = rng.normal(0, 2.0**octave / 2, 2)
        warp += 0.6**octave * np.sin(2 * np.pi * (kx * x + ky * y + rng.uniform()))
    dark = np.exp(-np.square(np.sin(3 * np.pi * (x + 0.6 * y + 0.5 * warp)) / 0.15))
    return (1 - dark[..., None] * [0.8, 0.9, 1.0]).astype(np.float32)
