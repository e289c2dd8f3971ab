"""A glass of milk on a table."""

from __future__ import annotations

from typing import Any

import numpy as np

from bssrdf.render.material import RenderMaterial
from bssrdf.render.scenes.lathe import bend, ring, straight, turned
from bssrdf.render.scenes.place import POLISHED, SKY, paint, panel, sky, table, wall
from bssrdf.render.scenes.record import Body, Plugin, Scene, Thing, Viewpoint
from bssrdf.render.surface_nets import Points

GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
BASE_MM, FILL_MM, RIM_MM = 2.0, 80.0, 85.0
"""Heights: the glass's solid foot, the milk's level, the rim."""
WALL_MM = 1.6
_DAYLIGHT = (0.85, 1.0, 1.2)
"""Of a window to the north."""
_GAP = 0.02
"""Between milk and glass, so that no two surfaces coincide [mm]."""


def milk(material: RenderMaterial, **look: Any) -> Scene:
    """A glass of the material on a table, lit by a window from the left: one half is in its light, one in shadow.

    Foot and rim are glass. Between them milk takes the place of the wall that it wets: of light that meets glass from
    milk hardly any is reflected, so that its boundary is that with air, for which its coefficients hold.
    """
    body = turned(_milk())
    lights = {
        "window": panel((-250.0, -50.0, 190.0), (0.0, 0.0, 45.0), (90.0, 90.0), radiance=8.0, colour=_DAYLIGHT),
        SKY: sky(0.03),
    }
    camera = Viewpoint((30.0, -270.0, 150.0), (0.0, 0.0, 44.0), fov_deg=24.0)
    furniture: dict[str, Plugin | Thing] = {
        "foot": Thing(turned(_foot()), GLASS),
        "rim": Thing(ring(_rim()), GLASS),
        "table": table(POLISHED),
        "wall": wall((0.0, 420.0, 0.0), paint(0.06, 0.08, 0.11)),
    }
    return Scene("milk", {"milk": Body(body, material, body.size(), **look)}, lights, camera, furniture)


def _radius(height: float) -> float:
    """Outside, of a tumbler that widens upwards."""
    return 25.0 + 6.0 * height / RIM_MM


def _milk() -> Points:
    """Radius and height: a bottom on the foot, a side for the wall, a level top."""
    low, high, edge = BASE_MM + _GAP, FILL_MM, 0.4
    bottom, top = _radius(low), _radius(high)
    return np.concatenate(
        [
            [[0.0, low]],
            straight((0.0, low), (bottom - edge, low), 12),
            bend((bottom - edge, low + edge), edge, -90, 0),
            straight((bottom, low + edge), (top, high - edge), 40),
            bend((top - edge, high - edge), edge, 0, 90),
            straight((top - edge, high), (0.0, high), 14),
            [[0.0, high]],
        ]
    )


def _foot() -> Points:
    high, edge = BASE_MM, 1.2
    bottom, top = _radius(0.0), _radius(high)
    return np.concatenate(
        [
            [[0.0, 0.05]],
            straight((0.0, 0.05), (bottom - edge, 0.05), 6),
            bend((bottom - edge, 0.05 + edge), edge, -90, 0),
            bend((top - 0.2, high - 0.2), 0.2, 0, 90),
            straight((top - 0.2, high), (0.0, high), 6),
            [[0.0, high]],
        ]
    )


def _rim() -> Points:
    """The wall above the milk."""
    low, half = FILL_MM + _GAP, WALL_MM / 2
    outside, above = _radius(low), _radius(RIM_MM)
    return np.concatenate(
        [
            bend((outside - WALL_MM + 0.1, low + 0.1), 0.1, 180, 270, 3),
            bend((outside - 0.1, low + 0.1), 0.1, -90, 0, 3),
            straight((outside, low + 0.1), (above, RIM_MM - half), 6),
            bend((above - half, RIM_MM - half), half, 0, 180, 11),
            straight((above - WALL_MM, RIM_MM - half), (outside - WALL_MM, low + 0.1), 6),
        ]
    )
