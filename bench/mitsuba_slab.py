"""An exported Mitsuba file on a slab under an even sky, or under half of one. Lengths in mm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bssrdf.export.text import identifier

Floats = NDArray[np.float64]

CARD_MM = 0.01
"""Height of the card that shades half of the slab: nothing against any spread of light. The camera is under it."""


def render_slab(
    file: Path, name: str, *, edge: bool, half_mm: float, field_mm: float, pixels: int, samples: int, seed: int
) -> Floats:
    """Radiance seen from straight above, (rows, columns, 3); with `edge` only x > 0 lies under the sky."""
    import mitsuba as mi

    scene = mi.load_string(_scene(file, identifier(name), edge, half_mm, field_mm, pixels))
    return np.asarray(mi.render(scene, spp=samples, seed=seed), dtype=np.float64)


def _scene(file: Path, name: str, edge: bool, half: float, field: float, pixels: int) -> str:
    card = f"""
  <shape type="rectangle">
    <transform name="to_world"><scale x="{half / 2}" y="{half}"/><translate x="{-half / 2}" z="{CARD_MM}"/></transform>
    <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf></bsdf>
  </shape>"""
    return f"""<scene version="3.0.0">
  <include filename="{file.resolve()}"/>
  <emitter type="constant"/>{card if edge else ""}
  <shape type="cube">
    <transform name="to_world"><scale value="{half}"/><translate z="{-half}"/></transform>
    <ref id="{name}-surface"/>
    <ref name="interior" id="{name}-medium"/>
  </shape>
  <sensor type="orthographic">
    <float name="near_clip" value="{CARD_MM / 20}"/>
    <transform name="to_world">
      <scale x="{field / 2}" y="{field / 2}"/>
      <lookat origin="0, 0, {CARD_MM / 2}" target="0, 0, 0" up="0, 1, 0"/>
    </transform>
    <film type="hdrfilm">
      <integer name="width" value="{pixels}"/><integer name="height" value="{pixels}"/><rfilter type="box"/>
    </film>
  </sensor>
</scene>"""
