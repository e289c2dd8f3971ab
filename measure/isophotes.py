"""Does the picture agree with the stated view? The isophotes of a round spot, as the surface's map has them, tell.

Where view angle and axis are right they are circles but for the exit law, which a white table knows. Where they are
not, lengths along the view are off by a factor e^aspect against those across, and the isophotes are ellipses:
ln L ∝ ½ |d ln L/d ln r| aspect cos 2φ, φ the azimuth from the plane of view. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from bssrdf.calib import Spot, Surface
from bssrdf.errors import InputError
from bssrdf.measure.image import Image
from bssrdf.measure.reflectance import TotalReflectance, blocks_of
from bssrdf.measure.tail import Surroundings
from bssrdf.session.flags import Flag
from bssrdf.session.records import Array, Session
from bssrdf.transport import second_harmonic, shipped

LEAST_VIEW_DEG = 15.0
"""A view nearer to the normal foreshortens by less than 4 %."""
MOST_INCIDENCE_DEG = 5.0
"""A beam farther from the normal draws the light out by itself."""
_RING = 1.15
"""Outer over inner radius of a ring."""
_INNER_MFP = 2.5
"""Mean free paths from the beam at which light scattered once has gone, and the table's harmonic holds to 10 %."""
_INNER_SPOTS = 3.0
_CORE_SPOTS = (0.7, 1.5)
_INNER_FOOTPRINTS = 6.0
_DISH_SHARE = 0.7
"""Of the inner radius of a dish: farther out its wall shapes the light."""
_LEAST_TOTAL = 0.05
"""A darker sample shows little but light scattered once, whose isophotes are a line."""
_LEAST_POINTS = 40
_HARMONIC_REL_SD, _HARMONIC_SD = 0.2, 0.01
"""How far the exit law's harmonic is right: for another g, another mean free path, and as simulated light shows."""
_CORE_SD = 0.05
"""How round a beam is taken to be."""
_RING_SD = 0.1
"""A ring that tells its aspect worse than this tells nothing."""
_STEEPEST = 100.0
"""−d ln L/d ln r that no light reaches while it can be seen: noise about 0 seems to, and to any height."""
_STEPS, _LARGEST_STEP, _SMALL_STEP = 6, 0.5, 0.02
_BEYOND = 0.5
"""Share of the light by whose radius a length is told: farther out it leaves the frame."""
_CLEAR_SD, _CLEAR_STATED = 3.0, 2.0
_SWAP_SD = 5.0


class Aspect(NamedTuple):
    """How far isophotes are drawn out: ln of the ratio along and across the view, and at 45° to it; their error."""

    along: float
    oblique: float
    sd: float


class Isophotes(NamedTuple):
    """What the isophotes say: by image where they could be read, and the flags that follow."""

    aspects: dict[str, Aspect]
    flags: list[str]

    def told(self, view_angle_deg: float) -> dict[str, dict[str, float]]:
        """As numbers for provenance: the aspect, and the view angle that would make it 1."""
        return {
            name: {"aspect": float(np.exp(each.along)), "aspect_rel_sd": each.sd}
            | ({} if (angle := view_angle_by(each, view_angle_deg)) is None else {"view_angle_deg": angle})
            for name, each in self.aspects.items()
        }


def view_angle_by(aspect: Aspect, stated_deg: float) -> float | None:
    """The view angle that would make circles of the isophotes; None where none can."""
    cosine = float(np.cos(np.radians(stated_deg)) * np.exp(aspect.along))
    return float(np.degrees(np.arccos(cosine))) if cosine <= 1 else None


class Expected(NamedTuple):
    """What is known before the isophotes are looked at."""

    session: Session
    around: Surroundings
    spot_mm: float
    """1/e² radius of the spot as it looks."""
    channel: str
    """The one that is looked at."""
    totals: tuple[TotalReflectance, TotalReflectance]
    """Of sample and tile."""
    total_r: float
    view_angle_sd_deg: float


def look_at_isophotes(view: Expected, images: tuple[Image, Image], spots: tuple[Spot, Spot]) -> Isophotes:
    """Hold sample and tile against the stated view; InputError where both say that the axis is the other one."""
    geometry, incidence_deg = view.session.geometry, view.session.beam.incidence_deg
    assert geometry
    if geometry.view_angle_deg < LEAST_VIEW_DEG or incidence_deg > MOST_INCIDENCE_DEG:
        return _unchecked({})
    sample, tile = _both_aspects(view, images, spots)
    if sample and tile:
        _refuse_other_axis(view, images, spots, (sample, tile))
    aspects = {image.name: each for image, each in zip(images, (sample, tile), strict=True) if each is not None}
    stated_sd = float(np.tan(np.radians(geometry.view_angle_deg)) * np.radians(view.view_angle_sd_deg))
    if sample is None:
        tile_off = tile is not None and _is_off(tile, stated_sd)
        raised = {Flag.ASPECT_OFF: tile_off, Flag.GEOMETRY_UNCHECKED: not tile_off}
        return Isophotes(aspects, [flag for flag, is_raised in raised.items() if is_raised])
    return Isophotes(aspects, _flags(sample, tile, geometry.view_angle_deg, stated_sd))


def _unchecked(aspects: dict[str, Aspect]) -> Isophotes:
    raised = {Flag.GEOMETRY_UNCHECKED: True}
    return Isophotes(aspects, list(raised))


def _both_aspects(
    view: Expected, images: tuple[Image, Image], spots: tuple[Spot, Spot]
) -> tuple[Aspect | None, Aspect | None]:
    """Of sample and tile. The tile's, whose light needs no model, says where to look for the sample's."""
    tile = _of_tile(view, images[1], spots[1])
    return _of_sample(view, images[0], spots[0], tile.along if tile else 0.0), tile


def _of_sample(view: Expected, image: Image, spot: Spot, start: float) -> Aspect | None:
    if view.total_r < _LEAST_TOTAL:
        return None
    around, material = view.around, view.session.material
    mfp, q = mean_free_path(view.totals[0], view.total_r, around)
    mfp *= float(np.exp(-start / 2))  # it was found where the map has lengths along the view wrong by e^start
    dish = np.inf if material is None or material.width_mm is None else _DISH_SHARE * material.width_mm / 2

    def harmonic(r: Array) -> Array:
        return second_harmonic(shipped(), around.eta, around.g, q, r / mfp, around.view_angle_deg)

    radii = (max(_INNER_MFP * mfp, _INNER_SPOTS * view.spot_mm), dish)
    return aspect_of(image, view.channel, spot, radii, harmonic, start)


def _of_tile(view: Expected, image: Image, spot: Spot) -> Aspect | None:
    """By the light that the tile spreads, else by the core of the spot, as far as the beam is round."""
    skirt = aspect_of(image, view.channel, spot, (_INNER_SPOTS * view.spot_mm, np.inf), np.zeros_like)
    if skirt is not None:
        return skirt
    inner, outer = (share * view.spot_mm for share in _CORE_SPOTS)
    core = aspect_of(image, view.channel, spot, (inner, outer), np.zeros_like)
    return core and core._replace(sd=float(np.hypot(core.sd, _CORE_SD)))


def _refuse_other_axis(
    view: Expected, images: tuple[Image, Image], spots: tuple[Spot, Spot], stated: tuple[Aspect, Aspect]
) -> None:
    if any(_misfit(each) < _SWAP_SD for each in stated):
        return
    other = _both_aspects(view, (_other_axis(images[0]), _other_axis(images[1])), spots)
    if all(b is not None and _misfit(a) - _misfit(b) > _SWAP_SD for a, b in zip(stated, other, strict=True)):
        axis = images[0].surface.geometry.view_axis
        drawn = " and ".join(f"{np.exp(each.along):.2f}" for each in stated)
        raise InputError(
            f'{view.session.path / "session.toml"}: [geometry] view_axis = "{axis}" does not go with the picture, in '
            f"which the isophotes of sample and tile are drawn out {drawn} to 1 along it; write the other axis"
        )


def _flags(sample: Aspect, tile: Aspect | None, view_angle_deg: float, stated_sd: float) -> list[str]:
    def is_off(each: Aspect) -> bool:
        return _is_off(each, stated_sd)

    agree = tile is not None and max(abs(sample.along - tile.along), abs(sample.oblique - tile.oblique)) < (
        _CLEAR_SD * float(np.hypot(sample.sd, tile.sd))
    )
    of_view = abs(sample.along) > abs(sample.oblique) and view_angle_by(sample, view_angle_deg) is not None
    raised = {
        Flag.VIEW_ANGLE_OFF: is_off(sample) and agree and of_view,
        Flag.ASPECT_OFF: (is_off(sample) and (tile is None or (agree and not of_view)))
        or (tile is not None and is_off(tile) and not agree),
        Flag.ANISOTROPIC: is_off(sample) and tile is not None and not agree and not is_off(tile),
    }
    return [flag for flag, is_raised in raised.items() if is_raised]


def _is_off(aspect: Aspect, stated_sd: float) -> bool:
    size = float(np.hypot(aspect.along, aspect.oblique))
    return size > _CLEAR_SD * aspect.sd and size > _CLEAR_STATED * stated_sd


def _misfit(aspect: Aspect) -> float:
    return abs(aspect.along) / aspect.sd


def _other_axis(image: Image) -> Image:
    geometry = image.surface.geometry
    other = replace(geometry, view_axis="x" if geometry.view_axis == "y" else "y")
    return replace(image, surface=Surface(other, image.surface.distortion))


def mean_free_path(total: TotalReflectance, total_r: float, around: Surroundings) -> tuple[float, float]:
    """1/σt′ [mm] and q = √(1 − α′), by R and by the radius beyond which half of the light leaves."""
    loss, kappa = around.loss(total_r), around.attenuation(total_r)
    rings = total.profile.value * np.pi * (total.profile.r_hi**2 - total.profile.r_lo**2)
    beyond = 1 - np.cumsum(rings) / total.light
    radius = float(np.interp(-_BEYOND, -beyond, total.profile.r_hi))
    x = np.geomspace(0.01, 300, 2000)
    share = np.zeros_like(x)
    for depth in (1.0, 1 + 4 / 3 * around.boundary().a):
        distance = np.hypot(x, depth)
        share += np.exp(-kappa * (distance - depth)) * depth / distance * np.exp(-kappa * (depth - 1))
    share /= 1 + np.exp(-kappa * 4 / 3 * around.boundary().a)
    return radius / float(np.interp(-_BEYOND, -share, x)), float(np.sqrt(loss))


def aspect_of(
    image: Image,
    channel: str,
    spot: Spot,
    radii: tuple[float, float],
    harmonic: Callable[[Array], Array],
    start: float = 0.0,
) -> Aspect | None:
    """The aspect of the isophotes between two radii; None where no whole ring there is clear of noise.

    `harmonic` is what the exit law makes of it, at radii. Large aspects are found in steps, each from rings drawn by
    the aspect before.
    """
    blocks = blocks_of(image, channel, spot)
    good = blocks.n > 0
    across, along = image.surface.centred(blocks.x_px[good], blocks.y_px[good], (spot.x_px, spot.y_px))
    outline, footprint = image.outline(spot), max(image.footprint(spot))
    found, drawn = None, start
    for _ in range(_STEPS):
        back = float(np.exp(-drawn))
        reach = float(np.hypot(outline[0], outline[1] * back).min())
        edges = _edges(max(radii[0], _INNER_FOOTPRINTS * footprint * max(1.0, back)), min(radii[1], reach))
        step = _aspect(across, along * back, blocks.value[good], blocks.n[good], edges, harmonic)
        if step is None:
            break
        drawn += float(np.clip(step.along, -_LARGEST_STEP, _LARGEST_STEP))
        found = step._replace(along=drawn)
        if abs(step.along) < _SMALL_STEP:
            break
    return found


def _edges(inner: float, outer: float) -> Array:
    n = max(0, int(np.log(max(outer / inner, 1.0)) / np.log(_RING)))
    return np.asarray(inner * _RING ** np.arange(n + 1))


def _aspect(
    across: Array, along: Array, value: Array, n: Array, edges: Array, harmonic: Callable[[Array], Array]
) -> Aspect | None:
    """The aspect to first order, from the rings between the edges."""
    r = np.hypot(across, along)
    found = []
    for low, high in pairwise(edges):
        here = (r >= low) & (r < high)
        ring = _ring(across[here], along[here], value[here], n[here], float(np.sqrt(low * high)))
        if ring is not None:
            found.append(ring)
    if not found:
        return None
    middle, slope, along_2, oblique_2, noise = np.array(found).T
    expected = harmonic(middle)
    to_aspect = 2 / slope
    weight = 1 / ((noise * to_aspect) ** 2 + _HARMONIC_SD**2)
    systematic = np.hypot(_HARMONIC_REL_SD * expected, _HARMONIC_SD) * to_aspect
    mean, oblique = (float(np.average(each * to_aspect, weights=weight)) for each in (along_2 - expected, oblique_2))
    statistical = float(np.sqrt(np.sum((weight * noise * to_aspect) ** 2)) / weight.sum())
    return Aspect(mean, oblique, float(np.hypot(statistical, np.average(systematic, weights=weight))))


def _ring(across: Array, along: Array, value: Array, n: Array, middle: float) -> tuple[float, ...] | None:
    """Radius, −d ln L/d ln r, second harmonics along and at 45°, and their noise; None where these are not clear."""
    if len(value) < _LEAST_POINTS:
        return None
    r = np.hypot(across, along)
    cosine, sine, log_r, weight = along / r, across / r, np.log(r / middle), np.sqrt(n)
    terms = [np.ones_like(r), log_r, log_r**2, cosine, sine, cosine**2 - sine**2, 2 * cosine * sine]
    columns = np.stack(terms, axis=1) * weight[:, None]
    inverse = np.linalg.inv(columns.T @ columns)
    slope = 0.0
    for _ in range(3):
        level = value * np.exp(slope * log_r)
        solved = inverse @ (columns.T @ (level * weight))
        if not solved[0] > 0:
            return None
        slope -= float(solved[1] / solved[0])
        if abs(slope) > _STEEPEST:
            return None
    left = level * weight - columns @ solved
    covariance = inverse * float(left @ left) / (len(left) - len(solved))
    noise = float(np.sqrt(covariance[5, 5]) / solved[0])
    if not (slope > 0.3 and noise * 2 / slope < _RING_SD):
        return None
    return middle, slope, float(solved[5] / solved[0]), float(solved[6] / solved[0]), noise
