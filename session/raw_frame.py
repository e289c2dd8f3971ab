"""One frame as its file holds it: what every reader of image files gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.session.records import Card

MACHINE_VISION_REL_SD = 1e-3
"""Of an exposure that a machine-vision or microscope program wrote; a camera's EXIF is a rounded label."""


@dataclass(frozen=True)
class RawFrame:
    """A frame as the camera made it, and what its file says about it."""

    data: NDArray[Any]
    """uint8, uint16 or float32 [DN], (h, w) of a mosaic or a mono camera, or (h, w, 3) RGB."""
    card: Card = field(default_factory=Card)
    exposure_s: float | None = None
    """From the file's own metadata."""
    exposure_rel_sd: float | None = None
    """None: unknown, as of a rounded label."""
    utc: str | None = None
    masked_dn: tuple[float, ...] | None = None
    """Mean of the optically black pixels [DN], by place in the pattern, where the file has them."""

    @property
    def layout(self) -> str | None:
        """2×2 colour filter pattern at the first pixel, "mono" or "rgb"; None where the file does not tell."""
        return self.card.layout

    @property
    def black(self) -> float | NDArray[np.float64] | None:
        """[DN]; of a mosaic (2, 2), by place in the pattern; of RGB by channel."""
        return by_place(self.card.black)

    @property
    def white(self) -> float | None:
        """[DN], the lowest of the channels."""
        return None if self.card.white is None else min(self.card.white)


def by_place(levels: Sequence[float] | None) -> float | NDArray[np.float64] | None:
    """Levels of a card in the shape that they have in the frame."""
    if levels is None or len(levels) == 1:
        return None if levels is None else float(levels[0])
    return np.array(levels, np.float64).reshape((2, 2) if len(levels) == 4 else -1)
