"""Saturated pixels that are not the beam's spot: a glint of the lamp on a wet surface, a grain of salt."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from bssrdf.measure.hdr import HOT, NO_DATA, SATURATED, Hdr
from bssrdf.measure.image import Image
from bssrdf.measure.pixels import mosaic_period

_OF_SPOT = 2.0
"""Radii of the spot (1/e²) within which what is saturated is the spot: the curve is steepest there."""
_MOST_SHARE = 1e-3
"""Of the frame's pixels: more of them are a second beam or a lamp, and no glint."""
_HALO_PX = 3
"""Pixels of a colour over which a lens spreads a glint that is as bright as the spot or brighter."""


def without_glints(image: Image) -> tuple[Image, int]:
    """The image with its glints left out, and how many pixels of them are saturated; itself where there is none."""
    if not 0 < image.summary.n_saturated <= _MOST_SHARE * math.prod(image.hdr.shape[:2]):
        return image, 0
    mask = image.hdr.mask
    saturated = (mask & (SATURATED | HOT)) == SATURATED
    flat = saturated.any(axis=2) if saturated.ndim == 3 else saturated
    reach = _HALO_PX * mosaic_period(image.layout)
    pixels: Any = flat.astype(np.uint8)
    _, pieces = cv2.connectedComponents(cv2.dilate(pixels, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)))
    rows, columns = np.nonzero(flat)
    distance = np.hypot(columns - image.spot.x_px, rows - image.spot.y_px)
    near = distance < max(_OF_SPOT * image.spot.ellipse_px()[0], reach)
    glint = (pieces > 0) & ~np.isin(pieces, pieces[rows[near], columns[near]])
    if not glint.any():
        return image, 0
    glint_or_channel = glint[..., None] if mask.ndim == 3 else glint
    left_out = np.where(glint_or_channel, (mask | NO_DATA) & np.uint8(0xFF ^ SATURATED), mask)
    hdr = Hdr(image.hdr.radiance, image.hdr.variance, image.hdr.count, left_out)
    return replace(image, hdr=hdr, known=None), int(np.count_nonzero(flat & glint))
