"""Where the slice was laid: spot, slice, band, an isophote and what was saturated, on the pixels of the picture."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import Spot, Surface
from bssrdf.measure.image import Image, beam_on_sample
from bssrdf.measure.pixels import grids_of
from bssrdf.session.records import Array, Session, Slice

Points = NDArray[np.float64]
"""(n, 2): x and y in pixels of the frame."""

_TURNS = 96
_NEWTON = 8
_ISOPHOTE_SHARE = 0.4
"""Of the slice's reach: far enough out to be seen, near enough to lie in the frame."""
_SHOWN_DECADES = 4.0
"""Of light that a picture spans from white to black: beyond is mostly noise."""


@dataclass(frozen=True)
class Marks:
    """What is drawn over one image, by its own pixels."""

    spot_px: Points
    """The 1/e² ellipse of the spot."""
    centre_px: tuple[float, float]
    slice_px: Points
    """From the slice's farthest point on one side to that on the other; empty for a radial average."""
    band_px: Points
    """Corners of the band that was averaged; empty likewise."""
    isophote_px: Points
    """An ellipse as the light's isophotes were found to be; empty where they were not looked at."""
    isophote_mm: float
    saturated: Mapping[str, int]
    """Pixels saturated in every exposure, by channel."""
    pixels: Mapping[str, int]
    """All pixels, by channel."""


def marks_of(session: Session, images: Mapping[str, Image], curve: Slice | None) -> dict[str, Marks]:
    """By kind of image; the slice is drawn on the sample alone."""
    spots = {kind: image.spot for kind, image in images.items()}
    coplanar = bool(session.reference and session.reference.coplanar)
    marks = {}
    for kind, image in images.items():
        centre = spots[kind]
        if kind == "sample" and "reference" in spots:
            centre = beam_on_sample(image, centre, spots["reference"], coplanar=coplanar)
        marks[kind] = _marks(image, spots[kind], centre, curve if kind == "sample" else None, _aspect(curve, kind))
    return marks


def _aspect(curve: Slice | None, kind: str) -> float | None:
    seen: Any = (curve.provenance.get("isophotes", {}) if curve else {}).get(kind)
    return float(seen["aspect"]) if isinstance(seen, Mapping) and "aspect" in seen else None


def _marks(image: Image, spot: Spot, centre: Spot, curve: Slice | None, aspect: float | None) -> Marks:
    where, surface = (centre.x_px, centre.y_px), image.surface
    turn = np.linspace(0, 2 * np.pi, _TURNS)
    long, short, angle = spot.ellipse_px()
    x, y = long * np.cos(turn), short * np.sin(turn)
    ellipse = np.stack([spot.x_px + x * np.cos(angle) - y * np.sin(angle),
                        spot.y_px + x * np.sin(angle) + y * np.cos(angle)], axis=1)  # fmt: skip
    line = band = isophote = np.zeros((0, 2))
    reach = _reach(curve) if curve is not None else (0.0, 0.0)
    if curve is not None and curve.azimuth == "perpendicular":
        across = np.linspace(-reach[0], reach[1], _TURNS)
        line = on_image(surface, where, across, np.zeros_like(across))
        half = (curve.band_mm or 0.0) / 2
        ends = np.array([-reach[0], reach[1], reach[1], -reach[0]])
        band = on_image(surface, where, ends, np.array([-half, -half, half, half]))
    radius = _ISOPHOTE_SHARE * max(reach) if max(reach) > 0 else 3 * image.footprint(spot)[0] * long
    if aspect is not None:
        isophote = on_image(surface, where, radius * np.cos(turn), radius * aspect * np.sin(turn))
    return Marks(
        ellipse,
        where,
        line,
        band,
        isophote,
        float(radius),
        {name: sum(grid.n_saturated for grid in image.grid_summaries(name)) for name in image.channels},
        {
            name: sum(math.prod(grid.shape) for grid in grids_of(image.hdr, image.layout, name))
            for name in image.channels
        },
    )


def _reach(curve: Slice) -> tuple[float, float]:
    """How far the slice goes on its two sides [mm]."""
    reach = {-1: 0.0, 1: 0.0}
    for part in curve.channels.values():
        far = part.r_mm if part.r_hi_mm is None else part.r_hi_mm
        for side in reach:
            here = np.ones(len(far), bool) if part.side is None else part.side == side
            reach[side] = max(reach[side], float(far[here].max(initial=0.0)))
    return reach[-1], reach[1]


def on_image(surface: Surface, centre_px: tuple[float, float], across_mm: Array, along_mm: Array) -> Points:
    """Image points (n, 2) that see the surface (across, along) [mm] from what `centre_px` sees: Newton's method."""
    x, y = (np.full(np.shape(across_mm), each, float) for each in centre_px)
    for _ in range(_NEWTON):
        miss = np.stack(surface.centred(x, y, centre_px)) - np.stack([across_mm, along_mm])
        by_x = np.stack(surface.centred(x + 0.5, y, centre_px)) - np.stack(surface.centred(x - 0.5, y, centre_px))
        by_y = np.stack(surface.centred(x, y + 0.5, centre_px)) - np.stack(surface.centred(x, y - 0.5, centre_px))
        determinant = by_x[0] * by_y[1] - by_x[1] * by_y[0]
        x = x - (miss[0] * by_y[1] - miss[1] * by_y[0]) / determinant
        y = y - (by_x[0] * miss[1] - by_x[1] * miss[0]) / determinant
    return np.stack([x, y], axis=1)


def picture(image: Image, white: Mapping[str, float]) -> NDArray[np.uint8]:
    """The image as it is shown, (h, w, 3) RGB: demosaicked cell by cell, light in the logarithm, made small.

    `white` is the light by channel that is to look white, such as the reference's; for one channel it is grey.
    """
    names = [name for name in "RGB" if name in white] if set("RGB") <= set(white) else list(white)[:1]
    planes = [_small(image, name) / np.float32(max(white[name], 1e-300)) for name in names]
    rgb = np.stack(planes if len(planes) == 3 else planes * 3, axis=-1)
    light = np.maximum(rgb.max(axis=2), 0)
    top = float(np.percentile(light, 99.98)) or 1.0
    floor = top / 10**_SHOWN_DECADES
    shown = np.log1p(light / floor) / np.log1p(top / floor)
    hue = rgb / np.maximum(light, np.float32(1e-30))[..., None]
    return np.asarray(np.clip(255 * np.clip(hue, 0, 1) ** (1 / 2.2) * shown[..., None], 0, 255), np.uint8)


def saturation_map(image: Image) -> NDArray[np.bool_]:
    """Which points of `picture` hold a pixel that is saturated in every exposure, in any channel."""
    parts = [grid.clipped for channel in image.channels for grid in image.grid_summaries(channel)]
    return np.asarray(np.any(parts, axis=0))


def light_of(image: Image) -> dict[str, float]:
    """Sum of the good pixels' light by channel: of a reference, what makes white."""
    return {
        channel: float(np.mean([grid.light_by_count.sum() for grid in image.grid_summaries(channel)]))
        for channel in image.channels
    }


def _small(image: Image, channel: str) -> NDArray[np.float32]:
    """One channel, its colours averaged over a cell, at display size."""
    return np.asarray(np.mean([grid.display for grid in image.grid_summaries(channel)], axis=0), np.float32)
