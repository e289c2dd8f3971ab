"""From two radiance images to R_d(r) and R: the sample's, and that of the reference under the same beam.

The reference tells what the beam carries: KΦ = Σ p A_px/ρ for its pixels p, each seeing the area A_px, and its
reflectance ρ. So R_d(r) = p(r)/KΦ [1/mm²], and R = Σ p A_px/KΦ of the sample. Lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from bssrdf.calib.spot import Spot, find_spot
from bssrdf.calib.surface import Surface
from bssrdf.errors import InputError
from bssrdf.measure.merge import Hdr
from bssrdf.measure.pixels import ChannelPixels, mosaic_period, pixels_of
from bssrdf.measure.profile import Points, Profile, bin_edges, profile
from bssrdf.session.records import Array, ChannelSlice

_BAND_PX = 10
_SPOT_SD_PX = 3.0


@dataclass(frozen=True)
class Image:
    """A radiance image and the way it is read."""

    name: str
    """How to call it in an error."""
    hdr: Hdr
    layout: str
    channels: tuple[str, ...]
    """Those to be used."""
    surface: Surface

    def pixels(self, channel: str) -> ChannelPixels:
        return pixels_of(self.hdr, self.layout, channel)


def locate(image: Image) -> Spot:
    """The spot, from all channels together; InputError where the beam misses the frame."""
    period = mosaic_period(image.layout)
    brightness = np.nan_to_num(image.hdr.radiance, nan=0.0)
    brightness[image.hdr.mask != 0] = 0
    brightness = brightness if brightness.ndim == 2 else brightness.mean(axis=2)
    smooth = cv2.blur(brightness, (2 * period + 1, 2 * period + 1), borderType=cv2.BORDER_REPLICATE)
    row, column = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
    height, width = smooth.shape
    if min(row, column, height - 1 - row, width - 1 - column) < 2 * period:
        raise InputError(
            f"{image.name}: the brightest point ({column}, {row}) lies on the edge of the frame; "
            "bring the beam into the frame"
        )
    every = [image.pixels(channel) for channel in image.channels]
    x, y = (np.concatenate([getattr(p, axis)[p.good] for p in every]) for axis in ("x_px", "y_px"))
    value = np.concatenate([p.value[p.good] / p.value[p.good].max() for p in every])
    return find_spot(x, y, value, (float(column), float(row)), _SPOT_SD_PX)


@dataclass(frozen=True)
class Total:
    """Light of an image [DN/s · mm²] with its standard error."""

    light: float
    sd: float


def total_light(image: Image, channel: str, spot: Spot) -> Total:
    """Σ p A_px over the frame; pixels without a value count as their distance from the beam makes them."""
    pixels = image.pixels(channel)
    across, along = image.surface.centred(pixels.x_px, pixels.y_px, (spot.x_px, spot.y_px))
    area = image.surface.pixel_area_mm2(pixels.x_px, pixels.y_px) * pixels.px_per_sample
    value = pixels.value.copy()
    bad = ~pixels.good
    if bad.any():
        around = radial_profile(image, channel, spot).curve()
        value[bad] = around(np.hypot(across[bad], along[bad]))
    variance = np.where(pixels.good, pixels.variance, 0.0)
    return Total(float(value @ area), float(np.sqrt(variance @ area**2)))


def _points(image: Image, channel: str, spot: Spot) -> Points:
    pixels = image.pixels(channel)
    good = pixels.good
    across, along = image.surface.centred(pixels.x_px[good], pixels.y_px[good], (spot.x_px, spot.y_px))
    return Points(across, along, pixels.value[good], pixels.variance[good])


def _footprint(image: Image, spot: Spot) -> tuple[float, float]:
    """Width of a pixel on the surface at the spot, across the view and along it."""
    x, y = np.array([spot.x_px]), np.array([spot.y_px])
    widths = np.hypot(*image.surface.jacobian(x, y))[:, 0]
    return (widths[0], widths[1]) if image.surface.geometry.view_axis == "y" else (widths[1], widths[0])


def radial_profile(image: Image, channel: str, spot: Spot) -> Profile:
    """Radiance over the distance from the spot, from the whole image."""
    points = _points(image, channel, spot)
    footprint = _footprint(image, spot)
    step = max(footprint) * mosaic_period(image.layout)
    edges = bin_edges(step, float(np.hypot(points.across, points.along).max()))
    return profile(points, edges, footprint, None)


def slice_profiles(image: Image, channel: str, spot: Spot, band_mm: float | None) -> dict[int, Profile]:
    """Radiance along the slice on its two sides (−1, +1), within a band of the full width `band_mm`."""
    points = _points(image, channel, spot)
    footprint = _footprint(image, spot)
    band = band_mm or _BAND_PX * footprint[0]
    step = footprint[0] * mosaic_period(image.layout)
    sides = {}
    for side in (-1, 1):
        here = (side * points.across > 0) & (np.abs(points.along) <= band / 2)
        if not here.any():
            continue
        half = Points(*(field[here] for field in points))
        sides[side] = profile(half, bin_edges(step, float(np.abs(half.across).max())), footprint, band)
    return sides


def channel_slice(profiles: dict[int, Profile], per_light: float) -> ChannelSlice:
    """Rows of slice.csv: profiles times `per_light` = 1/KΦ; side 0 stands for both."""
    parts = sorted(profiles.items())

    def joined(name: str) -> Array:
        return np.concatenate([getattr(part, name) for _, part in parts])

    side = np.concatenate([np.full(len(part.value), side, np.int8) for side, part in parts])
    return ChannelSlice(
        joined("r"),
        joined("value") * per_light,
        joined("sd") * per_light,
        joined("r_lo"),
        joined("r_hi"),
        side if side.any() else None,
    )
