"""From two radiance images to R_d(r) and R: the sample's, and that of the reference under the same beam.

The reference tells what the beam carries: KΦ = Σ p A_px/ρ for its pixels p, each seeing the area A_px, and its
reflectance ρ. So R_d(r) = p(r)/KΦ [1/mm²], and R = Σ p A_px/KΦ of the sample. Lengths in mm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import Spot
from bssrdf.errors import InputError
from bssrdf.measure.image import Image
from bssrdf.measure.pixels import mosaic_period
from bssrdf.measure.profile import Points, RadialProfile, bin_edges, profile
from bssrdf.measure.pyramid import Blocks
from bssrdf.measure.tail import (
    INNER_SHARE,
    LEAST_BINS,
    Boundary,
    Estimate,
    Surroundings,
    Tail,
    TailFit,
    fit_tail,
    most_beyond,
)
from bssrdf.session.records import Array, ChannelSlice

_BAND_PX = 10
_BLOCKS_IN_BAND = 16
"""Blocks across a band of a slice, at least."""
_GLARE_PASSES = 2
_FLOOR_SD = 2.0
"""What is less clear may be missed: its error in R is then that of the tail."""
_FITS = 3.0
"""χ² per degree of freedom up to which a tail has the form of diffusion: 0.3 to 1.4 on the bench, 50 and more where it
has not, and a floor would only make up for that."""
_GLARE_SHARE = 0.001
_FLOOR_COUNTS = 3.0
"""A bin whose own error is below this many errors of the floor feels it."""
_BEYOND_REL_SD = 0.02
"""How far the form of the tail is right where no pixel tells it, as a share of the light there."""


@dataclass(frozen=True)
class LightWithin:
    """The light of an image in one channel within the frame [DN/s · mm²]."""

    light: float
    variance: float
    frame_mm2: float
    profile: RadialProfile
    """Radiance over the distance from the spot, from the whole image."""
    by_count: Array
    """By the number of samples that were merged for its pixel."""


@dataclass(frozen=True)
class TotalReflectance:
    """All light of an image in one channel [DN/s · mm²], that beyond the frame included, and what it is made of."""

    light: float
    sd: float
    lost_fraction: float
    """Share of `light` that left the frame."""
    floor: Estimate
    """Veiling glare [DN/s] that was taken off every pixel."""
    within: LightWithin

    @property
    def profile(self) -> RadialProfile:
        """Radiance over the distance from the spot, from the whole image."""
        return self.within.profile


def light_within(image: Image, channel: str, spot: Spot) -> LightWithin:
    """Σ p A_px over the frame; pixels without a value count as their distance from the beam makes them."""
    blocks = blocks_of(image, channel, spot)
    across, along = image.surface.centred(blocks.x_px, blocks.y_px, (spot.x_px, spot.y_px))
    area = image.surface.pixel_area_mm2(blocks.x_px, blocks.y_px) * image.px_per_sample[channel]
    curve = radial_profile(image, channel, spot, blocks)
    missing = np.where(blocks.n > 0, blocks.value, curve.curve()(np.hypot(across, along)))
    inside = float(np.sum((blocks.light + blocks.n_missing * missing) * area))
    variance = float(np.sum(np.where(blocks.n > 0, blocks.variance, 0.0) * (blocks.n * area) ** 2))
    frame = float(np.sum((blocks.n + blocks.n_missing) * area))
    return LightWithin(inside, variance, frame, curve, light_by_count(image, channel))


def total_light(
    image: Image,
    spot: Spot,
    within: LightWithin,
    surroundings: Surroundings,
    *,
    glare: bool,
    per_light: float | None = None,
) -> TotalReflectance:
    """The light within the frame, with what the tail of the curve says of that outside.

    With `glare` a floor over the whole frame is taken for veiling glare and subtracted; `per_light` = 1/KΦ, where
    known, then helps to tell it from the sample's own light.
    """
    inside, curve, variance = within.light, within.profile, within.variance
    outline = image.outline(spot)

    def outside_of(tail: Tail) -> float:
        return tail.beyond(outline) - tail.floor * within.frame_mm2

    where = curve, float(np.hypot(*outline).min()), surroundings.boundary()
    holder = surroundings.holder
    fit = fit_tail(*where, with_floor=glare, holder=holder)
    if glare and per_light is not None:
        for _ in range(_GLARE_PASSES):
            if fit is not None:
                reflects = (inside + outside_of(fit.tail)) * per_light
                fit = _with_floor(where, surroundings, reflects)
    most, reach = most_beyond(*where[:2]), where[1]
    if fit is None and np.count_nonzero(curve.r > INNER_SHARE * reach) < LEAST_BINS:
        raise InputError(
            f"{image.name}: the frame ends {reach:.2g} mm from the spot, too near to tell the light beyond it; take a "
            "larger part of the frame"
        )
    if fit is None:
        sd = float(np.sqrt(variance + (most / 2) ** 2)) if np.isfinite(most) else np.inf
        return TotalReflectance(inside, sd, 0.0, Estimate(0.0, 0.0), within)
    outside = fit.estimate(outside_of)
    beyond = fit.tail.beyond(outline)
    light = inside + outside.value
    outside_sd = min(outside.sd, most)
    sd = float(np.sqrt(variance + outside_sd**2 + (_BEYOND_REL_SD * beyond) ** 2))
    return TotalReflectance(light, sd, beyond / light, fit.estimate(lambda tail: tail.floor), within)


def evident_floor(
    image: Image, spot: Spot, surroundings: Surroundings, total: TotalReflectance, per_light: float
) -> Estimate | None:
    """The even floor [DN/s], of either sign, that lies under the tail of a curve clear of its error; None if none."""
    reflects = total.light * per_light
    where = total.profile, float(np.hypot(*image.outline(spot)).min()), surroundings.boundary()
    fit = _with_floor(where, surroundings, reflects)
    floor = fit.estimate(lambda tail: tail.floor) if fit is not None and fit.chi2 <= _FITS else None
    return floor if floor and abs(floor.value) > _FLOOR_SD * floor.sd else None


def _with_floor(
    where: tuple[RadialProfile, float, Boundary], surroundings: Surroundings, reflects: float
) -> TailFit | None:
    """The tail over a floor, told apart by what the total says of the attenuation, as far as it does."""
    rel_sd = surroundings.attenuation_rel_sd(reflects)
    attenuation = surroundings.attenuation_by_mfp(reflects) if np.isfinite(rel_sd) else None
    holder = surroundings.holder
    return fit_tail(*where, with_floor=True, attenuation=attenuation, attenuation_rel_sd=rel_sd, holder=holder)


def doubted(total: TotalReflectance, without: TotalReflectance, floor: Estimate) -> tuple[TotalReflectance, bool]:
    """The total with a floor that stays in it as its error, and whether that is a notable share of the light.

    `without` it is another total: the light beyond the frame, which the floor feigns, is another too.
    """
    light = abs(total.light - without.light)
    wider = replace(total, floor=Estimate(0.0, abs(floor.value)), sd=float(np.hypot(total.sd, light)))
    return wider, light > _GLARE_SHARE * total.light


def rounded(total: TotalReflectance, hidden: float, image: Image, spot: Spot) -> TotalReflectance:
    """The total with the error that rounding makes where a pixel shows no more than `hidden` [DN/s].

    There anything from nothing to that may be lost, about half of it, by all pixels alike; and not more than is under
    a curve that falls on as the inverse square of the distance, slower than diffusion has it.
    """
    across, along = image.outline(spot)
    frame = abs(float(np.trapezoid(along, across)))
    shown = float(total.profile.r[total.profile.value > hidden].max(initial=0.0))
    farthest = max(float(np.hypot(across, along).max()), shown)
    falling = 2 * np.pi * shown**2 * np.log(farthest / max(shown, 1e-3 * farthest))
    lost = hidden * min(max(frame - np.pi * shown**2, 0.0) / 2, falling)
    floor_sd = float(np.hypot(total.floor.sd, hidden / 2))
    return replace(total, floor=Estimate(total.floor.value, floor_sd), sd=float(np.hypot(total.sd, lost)))


def light_by_count(image: Image, channel: str) -> Array:
    """Light of the channel's good pixels by the number of samples that were merged for each."""
    parts = [grid.light_by_count for grid in image.grid_summaries(channel)]
    longest = max(map(len, parts))
    return np.asarray(sum(np.pad(part, (0, longest - len(part))) for part in parts))


def blocks_of(image: Image, channel: str, spot: Spot) -> Blocks:
    """Every pixel of the channel once, in blocks that grow with the distance from the spot."""
    parts = [pyramid.all_around((spot.x_px, spot.y_px)) for pyramid in image.pyramids[channel]]
    return Blocks(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def _points(image: Image, blocks: Blocks, spot: Spot) -> Points:
    good = Blocks(*(field[blocks.n > 0] for field in blocks))
    across, along = image.surface.centred(good.x_px, good.y_px, (spot.x_px, spot.y_px))
    return Points(across, along, good.value, good.variance, good.n)


def radial_profile(image: Image, channel: str, spot: Spot, blocks: Blocks | None = None) -> RadialProfile:
    """Radiance over the distance from the spot, from the whole image."""
    points = _points(image, blocks_of(image, channel, spot) if blocks is None else blocks, spot)
    footprint = image.footprint(spot)
    step = max(footprint) * mosaic_period(image.layout)
    edges = bin_edges(step, float(np.hypot(points.across, points.along).max()))
    return profile(points, edges, footprint, None)


def usual_band_mm(image: Image, spot: Spot) -> float:
    """Full width of the slice along the view where none is given."""
    return float(_BAND_PX * image.footprint(spot)[0])


def slice_profiles(image: Image, channel: str, spot: Spot, band_mm: float) -> dict[int, RadialProfile]:
    """Radiance along the slice on its two sides (−1, +1), within a band of the full width `band_mm`."""
    centre, footprint = (spot.x_px, spot.y_px), image.footprint(spot)
    reach = 1.5 * max(footprint) / min(footprint)

    def in_band(x: Array, y: Array, side_px: float) -> NDArray[np.bool_]:
        along = image.surface.centred(x, y, centre)[1]
        return np.abs(along) <= band_mm / 2 + reach * side_px * footprint[1]

    most = band_mm / footprint[1] / _BLOCKS_IN_BAND
    parts = [pyramid.around(centre, in_band, most) for pyramid in image.pyramids[channel]]
    blocks = Blocks(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
    points = _points(image, blocks, spot)
    step = footprint[0] * mosaic_period(image.layout)
    sides: dict[int, RadialProfile] = {}
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


def channel_slice(profiles: dict[int, RadialProfile], floor: Estimate, per_light: float) -> ChannelSlice:
    """Rows of slice.csv: profiles above the floor of glare times `per_light` = 1/KΦ; side 0 stands for both."""
    parts = sorted(profiles.items())

    def joined(name: str) -> Array:
        return np.concatenate([getattr(part, name) for _, part in parts])

    side = np.concatenate([np.full(len(part.value), side, np.int8) for side, part in parts])
    own: Array = joined("sd")
    # The floor's error is common to all bins, a row's error is taken as its own: so that their mean keeps it, times √n.
    own = np.asarray(joined("sd"), float)
    in_common = max(1, int(np.count_nonzero(own < _FLOOR_COUNTS * floor.sd))) ** 0.5
    return ChannelSlice(
        joined("r"),
        (joined("value") - floor.value) * per_light,
        np.hypot(own, in_common * floor.sd) * per_light,
        joined("r_lo"),
        joined("r_hi"),
        side if side.any() else None,
    )
