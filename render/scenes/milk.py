"""The paper's Fig. 10: a glass of milk on a marble table, lit from one side."""

from __future__ import annotations

from typing import Any

import numpy as np

from bssrdf.render.lathe import turned
from bssrdf.render.material import RenderMaterial, find_medium
from bssrdf.render.scenes.place import SKY, box, box_size, panel, sky, table
from bssrdf.render.scenes.record import Body, Scene, Viewpoint

RADIUS_MM = 20.0
"""At the foot; the glass widens upwards."""
FILL_MM = 58.0
_TABLE = (260.0, 260.0, 20.0)


def milk(material: RenderMaterial, **look: Any) -> Scene:
    """A glass of the material on a polished slab of marble, lit from the left.

    The glass itself is left out: milk meets air, as its coefficients have it.
    """
    foot = _TABLE[2] + 0.05
    glass = turned(np.add(_profile(), (0.0, foot)))
    size = 3 * FILL_MM * RADIUS_MM / (2 * (FILL_MM + RADIUS_MM))
    marble = Body(box((-_TABLE[0] / 2, -_TABLE[1] / 2, 0.0), _TABLE), find_medium("Marble"), box_size(_TABLE))
    lights = {"window": panel((-210.0, 10.0, 110.0), (0.0, 0.0, 45.0), (45.0, 60.0), radiance=12.0), SKY: sky(0.02)}
    camera = Viewpoint((25.0, -230.0, 120.0), (0.0, 0.0, 50.0), fov_deg=25.0)
    bodies = {"milk": Body(glass, material, size, **look), "marble": marble}
    return Scene("milk", bodies, lights, camera, {"floor": table(0.1)})


def _profile() -> np.ndarray:
    """Radius and height of the milk: a foot with a round edge, a wall that widens, a level top."""
    corner = np.linspace(-np.pi / 2, 0, 8)
    edge = 3.0
    wall = np.stack([np.linspace(RADIUS_MM, RADIUS_MM + 4, 24), np.linspace(edge, FILL_MM - 0.6, 24)], axis=1)
    turn = np.linspace(0, np.pi / 2, 6)
    return np.concatenate(
        [
            np.stack([np.linspace(0, RADIUS_MM - edge, 8, endpoint=False), np.zeros(8)], axis=1),
            np.stack([RADIUS_MM - edge + edge * np.cos(corner), edge + edge * np.sin(corner)], axis=1),
            wall[1:-1],
            np.stack([RADIUS_MM + 3.4 + 0.6 * np.cos(turn), FILL_MM - 0.6 + 0.6 * np.sin(turn)], axis=1),
            np.stack([np.linspace(RADIUS_MM + 3.4, 0, 9)[1:], np.full(8, FILL_MM)], axis=1),
        ]
    )
