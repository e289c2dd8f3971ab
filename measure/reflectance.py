"""From two radiance images to R_d(r) and R: the sample's, and that of the reference under the same beam.

The reference tells what the beam carries: KΦ = Σ p A_px/ρ for its pixels p, each seeing the area A_px, and its
reflectance ρ. So R_d(r) = p(r)/KΦ [1/mm²], and R = Σ p A_px/KΦ of the sample. Lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.spot import Spot, find_spot
from bssrdf.calib.surface import Surface
from bssrdf.calib.tile_spread import beam_radius
from bssrdf.errors import InputError
from bssrdf.measure.merge import Hdr
from bssrdf.measure.pixels import ChannelPixels, mosaic_period, pixels_of
from bssrdf.measure.profile import Points, Profile, bin_edges, profile
from bssrdf.measure.tail import Estimate, Surroundings, Tail, fit_tail
from bssrdf.session.records import Array, ChannelSlice

_BAND_PX = 10
_OUTLINE_STEPS = 200
_GLARE_PASSES = 2
_GLARE_SD = 3.0
_GLARE_SHARE = 0.001
_BEYOND_REL_SD = 0.02
"""How far the form of the tail is right where no pixel tells it, as a share of the light there."""
_SPOT_SD_PX = 3.0
_SPOT_REACH_PX = 60
_RING_POINTS = 200
_SECOND_PEAK = 0.05
_SECOND_CONTRAST = 1.5


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

    @cached_property
    def pixels(self) -> dict[str, ChannelPixels]:
        """The pixels of each channel that is used."""
        return {channel: pixels_of(self.hdr, self.layout, channel) for channel in self.channels}

    @cached_property
    def aliasing(self) -> float:
        """How far a sum over one of four pixels of a mosaic is off, relative: by half the difference of its two greens.

        A spot that is narrow against the distance of the filters of one colour falls between them or on them.
        """
        greens = [divmod(place, 2) for place, letter in enumerate(self.layout) if letter == "G"]
        if len(self.layout) != 4 or len(greens) != 2:
            return 0.0
        usable = np.where(self.hdr.mask == 0, self.hdr.radiance, 0)
        first, second = (float(usable[row::2, column::2].sum(dtype=float)) for row, column in greens)
        return (first - second) / max(first + second, 1e-300)

    def is_saturated(self, channel: str) -> bool:
        """Whether some pixel of the channel is saturated in every exposure, hot ones left out."""
        return bool(self.pixels[channel].saturated.any())

    def outline(self, spot: Spot) -> tuple[Array, Array]:
        """The edge of the frame on the surface, (across, along) from the spot, once round."""
        height, width = self.hdr.radiance.shape[:2]
        way = np.linspace(0, 1, _OUTLINE_STEPS, endpoint=False)
        right, down = way * width - 0.5, way * height - 0.5
        x = np.concatenate([right, np.full_like(way, width - 0.5), right[::-1], np.full_like(way, -0.5), [-0.5]])
        y = np.concatenate([np.full_like(way, -0.5), down, np.full_like(way, height - 0.5), down[::-1], [-0.5]])
        return self.surface.centred(x, y, (spot.x_px, spot.y_px))


def locate(image: Image) -> Spot:
    """The spot, from all channels together; InputError where the beam misses the frame."""
    period = mosaic_period(image.layout)
    smooth = _smooth_brightness(image)
    row, column = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
    height, width = smooth.shape
    if min(row, column, height - 1 - row, width - 1 - column) < 2 * period:
        raise InputError(
            f"{image.name}: the brightest point ({column}, {row}) lies on the edge of the frame; "
            "bring the beam into the frame"
        )
    near = _SPOT_REACH_PX * period
    parts = []
    for pixels in image.pixels.values():
        used = pixels.good & (np.abs(pixels.x_px - column) < near) & (np.abs(pixels.y_px - row) < near)
        value = pixels.value[used]
        parts.append((pixels.x_px[used], pixels.y_px[used], value / value.max(initial=1e-300)))
    x, y, value = (np.concatenate(each) for each in zip(*parts, strict=True))
    return find_spot(x, y, value, (float(column), float(row)), _SPOT_SD_PX)


def beam_on_sample(own: Spot, on_tile: Spot, coplanar: bool) -> Spot:
    """Where the beam lands on the sample: at the spot seen there, or where it does on a tile in the same plane.

    Light runs outwards in the sample, so that a camera at an angle sees its spot drawn towards the camera: a slice
    through that centre is too bright, by some percent near the beam. A tile hardly scatters sideways.
    """
    return own._replace(x_px=on_tile.x_px, y_px=on_tile.y_px) if coplanar else own


def _smooth_brightness(image: Image) -> NDArray[np.float32]:
    """Mean of the channels around each pixel, bad pixels black."""
    radiance = np.where((image.hdr.mask == 0) & np.isfinite(image.hdr.radiance), image.hdr.radiance, 0)
    radiance = radiance if radiance.ndim == 2 else radiance.mean(axis=2)
    size = 2 * mosaic_period(image.layout) + 1
    blurred = cv2.blur(radiance.astype(np.float32), (size, size), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, np.float32)


def has_second_spot(image: Image, spot: Spot) -> bool:
    """Whether some place is as bright as a twentieth of the spot, and brighter than all of a ring nearer to it.

    Light scattered once is a bright line towards the camera, which falls off as everything else does.
    """
    smooth = _smooth_brightness(image)
    y_px, x_px = np.mgrid[: smooth.shape[0] : 2, : smooth.shape[1] : 2].astype(float)
    distance = np.hypot(*image.surface.centred(x_px.ravel(), y_px.ravel(), (spot.x_px, spot.y_px)))
    bright = smooth[::2, ::2].ravel()
    outwards = bright[np.argsort(distance)]
    rings = np.array_split(outwards, max(1, len(outwards) // _RING_POINTS))
    brightest = np.array([ring.max() for ring in rings])
    nearer = np.minimum.accumulate(brightest)
    return bool(np.any(brightest > np.maximum(_SECOND_PEAK * float(smooth.max()), _SECOND_CONTRAST * nearer)))


def spot_radius_mm(image: Image, spot: Spot) -> float:
    """1/e² radius of the spot's image on the surface, across the view."""
    column = 0 if image.surface.geometry.view_axis == "y" else 1
    sd_px = float(np.sqrt(spot.covariance_px2[column, column]))
    return 2 * sd_px * _footprint(image, spot)[0]


def beam_on_tile(image: Image, spot: Spot, view_angle_deg: float) -> Estimate:
    """1/e² radius of the beam [mm] from its spot on the tile, less the tile's own spread; the channels' mean."""
    core, footprint = spot_radius_mm(image, spot), _footprint(image, spot)
    found = [
        beam_radius(*_points(image, channel, spot), footprint, core, view_angle_deg)
        for channel in image.channels
        if not image.is_saturated(channel)
    ]
    if not found:
        return Estimate(core, core)
    weights = np.array([each.sd_mm**-2 for each in found])
    radii = np.array([each.radius_mm for each in found])
    mean = float(np.average(radii, weights=weights))
    scatter = float(np.sqrt(np.average((radii - mean) ** 2, weights=weights)))
    return Estimate(mean, max(scatter, min(each.sd_mm for each in found)))


@dataclass(frozen=True)
class Total:
    """All light of an image in one channel [DN/s · mm²], that beyond the frame included, and what it is made of."""

    light: float
    sd: float
    lost_fraction: float
    """Share of `light` that left the frame."""
    floor: Estimate
    """Veiling glare [DN/s] that was taken off every pixel."""
    profile: Profile
    """Radiance over the distance from the spot, from the whole image."""
    light_by_count: Array
    """Light within the frame by the number of samples that were merged for its pixel."""


def total_light(
    image: Image, channel: str, spot: Spot, surroundings: Surroundings, *, glare: bool, per_light: float | None = None
) -> Total:
    """Σ p A_px over the frame, with what the tail of the curve says of the light outside.

    Pixels without a value count as their distance from the beam makes them. With `glare` a floor over the whole frame
    is taken for veiling glare and subtracted; `per_light` = 1/KΦ, where known, then helps to tell it from the sample's
    own light.
    """
    pixels = image.pixels[channel]
    across, along = image.surface.centred(pixels.x_px, pixels.y_px, (spot.x_px, spot.y_px))
    area = image.surface.pixel_area_mm2(pixels.x_px, pixels.y_px) * pixels.px_per_sample
    curve = radial_profile(image, channel, spot)
    value = np.where(pixels.good, pixels.value, 0.0)
    if not pixels.good.all():
        value[~pixels.good] = curve.curve()(np.hypot(across, along)[~pixels.good])
    inside = float(value @ area)
    variance = float(np.where(pixels.good, pixels.variance, 0.0) @ area**2)
    by_count = np.bincount(pixels.count, value * area).astype(float)

    outline = image.outline(spot)
    frame = float(area.sum())

    def outside_of(tail: Tail) -> float:
        return tail.beyond(outline) - tail.floor * frame

    reach, boundary = float(np.hypot(*outline).min()), surroundings.boundary()
    fit = fit_tail(curve, reach, boundary, with_floor=glare)
    if glare and per_light is not None:
        for _ in range(_GLARE_PASSES):
            if fit is not None:
                attenuation = surroundings.attenuation((inside + outside_of(fit.tail)) * per_light)
                fit = fit_tail(curve, reach, boundary, with_floor=True, attenuation=attenuation)
    if fit is None:
        return Total(inside, float(np.sqrt(variance)), 0.0, Estimate(0.0, 0.0), curve, by_count)
    outside = fit.estimate(outside_of)
    beyond = fit.tail.beyond(outline)
    light = inside + outside.value
    sd = float(np.sqrt(variance + outside.sd**2 + (_BEYOND_REL_SD * beyond) ** 2))
    return Total(light, sd, beyond / light, fit.estimate(lambda tail: tail.floor), curve, by_count)


def glare_is_evident(image: Image, spot: Spot, surroundings: Surroundings, total: Total, per_light: float) -> bool:
    """Whether an even floor lies under the tail of a curve, clear of its error and of a share of the light."""
    outline = image.outline(spot)
    attenuation = surroundings.attenuation(total.light * per_light)
    fit = fit_tail(
        total.profile,
        float(np.hypot(*outline).min()),
        surroundings.boundary(),
        with_floor=True,
        attenuation=attenuation,
    )
    if fit is None:
        return False
    floor = fit.estimate(lambda tail: tail.floor)
    frame = abs(float(np.trapezoid(outline[1], outline[0])))
    return floor.value > _GLARE_SD * floor.sd and floor.value * frame > _GLARE_SHARE * total.light


def _points(image: Image, channel: str, spot: Spot) -> Points:
    pixels = image.pixels[channel]
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


def usual_band_mm(image: Image, spot: Spot) -> float:
    """Full width of the slice along the view where none is given."""
    return float(_BAND_PX * _footprint(image, spot)[0])


def slice_profiles(image: Image, channel: str, spot: Spot, band_mm: float) -> dict[int, Profile]:
    """Radiance along the slice on its two sides (−1, +1), within a band of the full width `band_mm`."""
    points = _points(image, channel, spot)
    footprint = _footprint(image, spot)
    step = footprint[0] * mosaic_period(image.layout)
    sides: dict[int, Profile] = {}
    for side in (-1, 1):
        here = (side * points.across > 0) & (np.abs(points.along) <= band_mm / 2)
        if not here.any():
            continue
        half = Points(*(field[here] for field in points))
        sides[side] = profile(half, bin_edges(step, float(np.abs(half.across).max())), footprint, band_mm)
    if not sides:
        raise InputError(
            f"{image.name}: no pixel of channel {channel} lies in a band of {band_mm:g} mm; widen --band-mm"
        )
    return sides


def channel_slice(profiles: dict[int, Profile], floor: Estimate, per_light: float) -> ChannelSlice:
    """Rows of slice.csv: profiles above the floor of glare times `per_light` = 1/KΦ; side 0 stands for both."""
    parts = sorted(profiles.items())

    def joined(name: str) -> Array:
        return np.concatenate([getattr(part, name) for _, part in parts])

    side = np.concatenate([np.full(len(part.value), side, np.int8) for side, part in parts])
    return ChannelSlice(
        joined("r"),
        (joined("value") - floor.value) * per_light,
        np.hypot(joined("sd"), floor.sd) * per_light,
        joined("r_lo"),
        joined("r_hi"),
        side if side.any() else None,
    )
