"""A merged image with the way it is read: its channels, its surface, where the beam's spot lies in it and how wide."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import Spot, Surface, find_spot, radius_on_tile
from bssrdf.errors import InputError
from bssrdf.measure.hdr import Planes
from bssrdf.measure.pixels import grids_of, mosaic_period
from bssrdf.measure.pyramid import Blocks, Pyramid
from bssrdf.measure.summary import GridSummary, Summary, overview_side, summary_of
from bssrdf.measure.tail import Estimate
from bssrdf.session.records import Array

_OUTLINE_STEPS = 200
_SPOT_SD_PX = 3.0
_WINDOW = 60
"""Half width, in pixels of a colour, in which a spot's shape is found: wider spots by blocks of as many pixels."""
_WINDOW_SPOTS = 2.5
"""At least so many 1/e² radii: the weight is below e^-10 there."""
_CORE_BLOCKS = 8
"""Blocks to the radius of a spot's core: finer ones tell its width no better."""
_CORE_REACH = 5.0
_RING_POINTS = 200
_APART_SPOTS = 0.25
"""Radii of the spot on the tile by which that on the sample may lie beside it: both are symmetric across the view."""
_SECOND_PEAK = 0.05
_SECOND_CONTRAST = 1.5


@dataclass(frozen=True)
class Image:
    """A radiance image and the way it is read."""

    name: str
    """How to call it in an error."""
    hdr: Planes
    layout: str
    channels: tuple[str, ...]
    """Those to be used."""
    surface: Surface
    known: Summary | None = None
    """Of the image, where it was stored."""

    @cached_property
    def summary(self) -> Summary:
        """What the image tells without its pixels."""
        places = {grid.place for channel in self.channels for grid in grids_of(self.hdr, self.layout, channel)}
        if self.known is not None and places <= self.known.grids.keys():
            return self.known
        return summary_of(self.hdr, self.layout, self.channels)

    def grid_summaries(self, channel: str) -> tuple[GridSummary, ...]:
        """Of the grids of a channel."""
        return tuple(self.summary.grids[grid.place] for grid in grids_of(self.hdr, self.layout, channel))

    @cached_property
    def pyramids(self) -> dict[str, tuple[Pyramid, ...]]:
        """The pixels of each channel that is used."""
        return {
            channel: tuple(
                Pyramid(grid, self.summary.grids[grid.place].levels)
                for grid in grids_of(self.hdr, self.layout, channel)
            )
            for channel in self.channels
        }

    @cached_property
    def px_per_sample(self) -> dict[str, float]:
        """Pixels of the frame for each one of a channel: 4 for red on a Bayer mosaic."""
        return {name: mosaic_period(self.layout) ** 2 / len(grids) for name, grids in self.pyramids.items()}

    @cached_property
    def overview(self) -> tuple[NDArray[np.float32], int]:
        """Mean of the channels around each point of a smaller image, bad pixels black, and its pixels' side [px]."""
        return self.summary.overview, overview_side(self.hdr.shape, self.layout)

    @cached_property
    def spot(self) -> Spot:
        """The beam's spot, from all channels together; InputError where the beam misses the frame."""
        return _located(self)

    def aliasing(self, channel: str) -> float:
        """How far a sum over one of four pixels of a mosaic is off, relative: by half the difference of its two greens.

        A spot that is narrow against the distance of the filters of one colour falls between them or on them, most
        along the view, which makes it narrower: so a colour shares the sign of the green in its row, or column.
        """
        if len(self.layout) != 4 or self.layout.count("G") != 2 or self.layout.count(channel) != 1:
            return 0.0
        first, _ = grids_of(self.hdr, self.layout, "G")
        (own,) = grids_of(self.hdr, self.layout, channel)
        along = 1 if self.surface.geometry.view_axis == "y" else 0
        sign = 1.0 if own.first_px[along] == first.first_px[along] else -1.0
        one, two = (float(green.light_by_count.sum()) for green in self.grid_summaries("G"))
        return sign * (one - two) / max(one + two, 1e-300)

    def is_saturated(self, channel: str) -> bool:
        """Whether some pixel of the channel is saturated in every exposure, hot ones left out."""
        return any(grid.n_saturated > 0 for grid in self.grid_summaries(channel))

    def outline(self, spot: Spot) -> tuple[Array, Array]:
        """The edge of the frame on the surface, (across, along) from the spot, once round."""
        height, width = self.hdr.shape[:2]
        way = np.linspace(0, 1, _OUTLINE_STEPS, endpoint=False)
        right, down = way * width - 0.5, way * height - 0.5
        x = np.concatenate([right, np.full_like(way, width - 0.5), right[::-1], np.full_like(way, -0.5), [-0.5]])
        y = np.concatenate([np.full_like(way, -0.5), down, np.full_like(way, height - 0.5), down[::-1], [-0.5]])
        return self.surface.centred(x, y, (spot.x_px, spot.y_px))

    def footprint(self, spot: Spot) -> tuple[float, float]:
        """Width of a pixel on the surface at the spot, across the view and along it."""
        x, y = np.array([spot.x_px]), np.array([spot.y_px])
        widths = np.hypot(*self.surface.jacobian(x, y))[:, 0]
        return (widths[0], widths[1]) if self.surface.geometry.view_axis == "y" else (widths[1], widths[0])

    def window(self, channel: str, centre_px: tuple[float, float], half_px: float, k: int = 0) -> Blocks:
        """The channel's good blocks of 2^k pixels of its grid a side, in a square about a point."""
        parts = [pyramid.window(centre_px, half_px, k) for pyramid in self.pyramids[channel]]
        every = Blocks(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
        return Blocks(*(field[every.n > 0] for field in every))


def _located(image: Image) -> Spot:
    small, side = image.overview
    row, column = np.unravel_index(int(np.argmax(small)), small.shape)
    period = mosaic_period(image.layout)
    x_px, y_px = ((place + 0.5) * side - 0.5 for place in (float(column), float(row)))
    height, width = image.hdr.shape[:2]
    if min(x_px, y_px, width - 1 - x_px, height - 1 - y_px) < 2 * period:
        raise InputError(
            f"{image.name}: the brightest point ({x_px:.0f}, {y_px:.0f}) lies on the edge of the frame; "
            "bring the beam into the frame"
        )
    spot, sd_px, k = None, max(_SPOT_SD_PX, side / 2), 0
    while spot is None or _WINDOW_SPOTS * spot.ellipse_px()[0] > _WINDOW * period * 2**k < max(width, height):
        k += spot is not None
        spot = _spot_in(image, (x_px, y_px), _WINDOW * period * 2**k, k, sd_px)
    return spot


def _spot_in(image: Image, centre_px: tuple[float, float], half_px: float, k: int, sd_px: float) -> Spot:
    parts = []
    for channel in image.channels:
        near = image.window(channel, centre_px, half_px, k)
        parts.append((near.x_px, near.y_px, near.value / near.value.max(initial=1e-300)))
    x, y, value = (np.concatenate(each) for each in zip(*parts, strict=True))
    return find_spot(x, y, value, centre_px, max(sd_px, 2.0**k * mosaic_period(image.layout)))


def beam_on_sample(image: Image, own: Spot, on_tile: Spot, *, coplanar: bool) -> Spot:
    """Where the beam lands on the sample: at the spot seen there, or, along the view, as on a tile in the same plane.

    Light runs outwards in the sample, so that a camera at an angle sees its spot drawn towards the camera: a slice
    through that centre is too bright, by some percent near the beam. A tile hardly scatters sideways.
    """
    if not coplanar:
        return own
    seen_along_y = image.surface.geometry.view_axis == "y"
    return own._replace(y_px=on_tile.y_px) if seen_along_y else own._replace(x_px=on_tile.x_px)


def check_beam_stayed(image: Image, own: Spot, on_tile: Spot) -> None:
    """InputError where the sample's spot lies so far from that on a coplanar tile that beam or surface was moved."""
    x, y = np.array([own.x_px]), np.array([own.y_px])
    across, along = (abs(float(each[0])) for each in image.surface.centred(x, y, (on_tile.x_px, on_tile.y_px)))
    most = max(_APART_SPOTS * spot_radius_mm(image, on_tile), image.footprint(own)[0])
    if across > most or along > most + 2 * spot_radius_mm(image, own):
        raise InputError(
            f"{image.name}: its spot lies {across:.2g} mm across the view and {along:.2g} mm along it from that on the "
            "tile, which are in one plane by [reference] coplanar; take both again with the beam at rest, or set it to "
            "false"
        )


def has_second_spot(image: Image, spot: Spot) -> bool:
    """Whether some place is as bright as a twentieth of the spot, and brighter than all of a ring nearer to it.

    Light scattered once is a bright line towards the camera, which falls off as everything else does.
    """
    small, side = image.overview
    row, column = np.mgrid[: small.shape[0] : 2, : small.shape[1] : 2].astype(float)
    x_px, y_px = ((place.ravel() + 0.5) * side - 0.5 for place in (column, row))
    distance = np.hypot(*image.surface.centred(x_px, y_px, (spot.x_px, spot.y_px)))
    outwards = small[::2, ::2].ravel()[np.argsort(distance)]
    rings = np.array_split(outwards, max(1, len(outwards) // _RING_POINTS))
    brightest = np.array([ring.max() for ring in rings])
    nearer = np.minimum.accumulate(brightest)
    return bool(np.any(brightest > np.maximum(_SECOND_PEAK * float(small.max()), _SECOND_CONTRAST * nearer)))


def spot_radius_mm(image: Image, spot: Spot) -> float:
    """1/e² radius of the spot's image on the surface, across the view."""
    column = 0 if image.surface.geometry.view_axis == "y" else 1
    sd_px = float(np.sqrt(spot.covariance_px2[column, column]))
    return 2 * sd_px * image.footprint(spot)[0]


def beam_on_tile(image: Image, spot: Spot, view_angle_deg: float) -> Estimate:
    """1/e² radius of the beam [mm] from its spot on the tile, less the tile's own spread; the channels' mean."""
    core, footprint = spot_radius_mm(image, spot), image.footprint(spot)
    period, centre = mosaic_period(image.layout), (spot.x_px, spot.y_px)
    k = max(0, int(np.log2(max(core / footprint[0] / period / _CORE_BLOCKS, 1.0))))
    block = (footprint[0], footprint[1]) if k == 0 else (2**k * period * footprint[0], 2**k * period * footprint[1])
    found = []
    for channel in image.channels:
        if image.is_saturated(channel):
            continue
        near = image.window(channel, centre, _CORE_REACH * core / min(footprint), k)
        across, along = image.surface.centred(near.x_px, near.y_px, centre)
        found.append(radius_on_tile(across, along, near.value, near.variance, block, core, view_angle_deg))
    if not found:
        return Estimate(core, core)
    weights = np.array([each.sd_mm**-2 for each in found])
    radii = np.array([each.radius_mm for each in found])
    mean = float(np.average(radii, weights=weights))
    scatter = float(np.sqrt(np.average((radii - mean) ** 2, weights=weights)))
    return Estimate(mean, max(scatter, min(each.sd_mm for each in found)))
