"""From the two images of a session to its slice: the curve, the totals, their errors and flags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bssrdf.calib import Exposures, Spot
from bssrdf.errors import InputError
from bssrdf.holding import Held, held
from bssrdf.measure.glints import without_glints
from bssrdf.measure.image import (
    Image,
    beam_on_sample,
    beam_on_tile,
    check_beam_stayed,
    has_second_spot,
    spot_radius_mm,
)
from bssrdf.measure.isophotes import Expected, Isophotes, look_at_isophotes
from bssrdf.measure.pixels import channel_names
from bssrdf.measure.profile import RadialProfile
from bssrdf.measure.reflectance import (
    TotalReflectance,
    channel_slice,
    doubted,
    evident_floor,
    light_within,
    rounded,
    slice_profiles,
    total_light,
    usual_band_mm,
)
from bssrdf.measure.tail import Estimate, Surroundings
from bssrdf.measure.total_errors import Timing, common_errors, polarisation_rel_sd, speckle_rel_sd, stated_errors
from bssrdf.session.flags import Flag, meaning_of
from bssrdf.session.records import SAMPLE_KEYS, TOTAL_R_MAX, ChannelSlice, Geometry, Material, Reference, Session, Slice

_TILE_ETA = 1.35
"""Sintered PTFE."""
_MAX_LOST = 0.02
_DISAGREE_REL = 0.02
_DISAGREE_PER_SINE = 0.6
"""Light runs outwards: across the view less is seen than on average, by up to this times the squared sine inside."""
_LEAST_BINS = 10
_CORE_LOW, _CORE_HIGH = 0.9, 1.4
"""The spot on a tile looks as wide as the beam or somewhat wider: within these its own spread need not be fitted."""
_SURE_SD = 6.0
"""Of a floor below 0: the light of a white tile in a small frame departs from the form of diffusion by 3 to 4."""
_SPOT_SD, _SPOT_REL = 3.0, 0.2
_ALIASED = 0.003
"""Of the light of a colour, missed or seen twice between the filters: as much as a good tile is uncertain by."""
_EXPLAIN = (
    Flag.GLARE,
    Flag.DRIFT,
    Flag.EXPOSURE_LABELS_OFF,
    Flag.EXPOSURE_RATIOS_DISAGREE,
    Flag.BLACK_OFFSET,
    Flag.NONLINEAR,
    Flag.SATURATED,
    Flag.WHITE_BELOW_STATED,
    Flag.WHITE_UNSEEN,
)
"""Flags of causes that can make an R of a white beyond white."""


@dataclass(frozen=True)
class SliceOptions:
    """How to read the images. Lengths in mm."""

    radial: bool = False
    glare: bool = False
    band_mm: float | None = None
    """Full width of the slice along the view; ten pixels if None."""


def measure_slice(
    session: Session,
    sample: Image,
    reference: Image,
    timing: Mapping[str, Timing],
    exposures: Exposures,
    options: SliceOptions,
    found: Sequence[str] = (),
) -> Slice:
    """The slice of a session, in the camera's own convention; InputError where no channel can be measured.

    `found` are the flags that the frames raised, for the case that they explain what cannot be.
    `timing` and `exposures` are of the brackets that were merged here; images merged elsewhere have none.
    """
    material, geometry, tile = _tables(session)
    (sample, on_sample), (reference, on_tile) = without_glints(sample), without_glints(reference)
    spots = sample.spot, reference.spot
    angles = geometry.view_angle_deg, session.beam.incidence_deg
    around = Surroundings(max(material.eta, 1.0), max(material.g or 0.0, 0.0), *angles, _held(session, material))
    around_tile = Surroundings(_TILE_ETA, 0.0, *angles)
    beam = beam_on_sample(sample, *spots, coplanar=tile.coplanar)
    flags = _image_flags(session, sample, reference, spots)
    flags += [Flag.GLINT] if on_sample or on_tile else []
    given_mm = session.beam.spot_radius_mm
    radius = Estimate(given_mm, 0.0) if given_mm else beam_on_tile(reference, spots[1], geometry.view_angle_deg)
    core_mm = spot_radius_mm(reference, spots[1])
    if given_mm and not _CORE_LOW * given_mm < core_mm < _CORE_HIGH * given_mm:
        flags += _spot_flags(given_mm, beam_on_tile(reference, spots[1], geometry.view_angle_deg))
    band_mm = options.band_mm or usual_band_mm(sample, beam)
    hidden = {kind: timing[kind].hidden() if kind in timing else 0.0 for kind in ("sample", "reference")}
    channels: dict[str, ChannelSlice] = {}
    totals: dict[str, float] = {}
    totals_sd: dict[str, float] = {}
    lost: dict[str, float] = {}
    scale_rel_sd = [0.0]
    seen: dict[float, tuple[str, tuple[TotalReflectance, TotalReflectance]]] = {}
    for channel in sample.channels:
        if reference.is_saturated(channel):
            continue
        rho = reflectance_of(tile, channel, session, sample)
        incident, under_tile = _light(
            reference, channel, spots[1], around_tile, options, hidden["reference"], reflects=rho
        )
        per_light = rho / incident.light
        back, floors = _light(sample, channel, beam, around, options, hidden["sample"], per_light=per_light)
        flags += [*under_tile, *floors]
        profiles = {0: back.profile} if options.radial else slice_profiles(sample, channel, beam, band_mm)
        channels[channel] = channel_slice(profiles, back.floor, per_light)
        lost[channel] = back.lost_fraction
        common = common_errors(back, incident, timing, exposures)
        of_sample, of_tile = sample.aliasing(channel), reference.aliasing(channel)
        common.append(max(abs(of_tile), abs(of_sample - of_tile)))  # of the curve, and of the total
        if session.beam.kind == "laser":
            common.append(speckle_rel_sd(radius.value, channel, session))
        if session.beam.polarised:
            common.append(polarisation_rel_sd(session.beam.incidence_deg, around.eta))
        scale_rel_sd.append(float(np.linalg.norm(common)))
        if not sample.is_saturated(channel):
            totals[channel] = _plausible(back.light * per_light, channel, session, (*found, *flags))
            totals_sd[channel] = totals[channel] * float(np.hypot(back.sd / back.light, scale_rel_sd[-1]))
        if channel in totals:
            seen[totals[channel]] = (channel, (back, incident))
        differ = any(_disagree(side, back.profile, around) for side in profiles.values())
        raised = {
            Flag.LIGHT_LOST: max(back.lost_fraction, incident.lost_fraction) > _MAX_LOST,
            Flag.SLICE_RADIAL_DISAGREE: differ and not options.radial,
            Flag.NARROW_SPOT: common[-1] > _ALIASED,
        }
        flags += [flag for flag, is_raised in raised.items() if is_raised]
    tile_rel_sd, mm_rel_sd, view_angle_sd_deg, assumed = stated_errors(tile, geometry)
    flags += assumed + [Flag.ROUGH_FINISH] * (material.finish == "rough")
    isophotes = Isophotes({}, [Flag.GEOMETRY_UNCHECKED])
    if seen:
        wide = max(radius.value, core_mm)
        brightest = max(seen)
        view = Expected(session, around, wide, *seen[brightest], brightest, view_angle_sd_deg)
        isophotes = look_at_isophotes(view, (sample, reference), (beam, spots[1]))
    flags += isophotes.flags
    if tile.coplanar:
        check_beam_stayed(sample, *spots)
    if not channels:
        raise InputError(f"{reference.name}: every channel is saturated at the spot; add shorter exposures")
    return Slice(
        channels=channels,
        eta=material.eta,
        flux="incident",
        exit="fresnel",
        view_angle_deg=geometry.view_angle_deg,
        view_angle_sd_deg=view_angle_sd_deg,
        azimuth="mean" if options.radial else "perpendicular",
        band_mm=None if options.radial else band_mm,
        incidence_deg=session.beam.incidence_deg,
        total_r=totals,
        total_r_sd=totals_sd,
        material=material.name,
        g=material.g,
        **{key: getattr(material, key) for key in SAMPLE_KEYS},
        spot_radius_mm=radius.value,
        spot_radius_sd_mm=radius.sd or None,
        lost_fraction=lost,
        scale_rel_sd=float(np.hypot(max(scale_rel_sd), tile_rel_sd)),
        mm_rel_sd=mm_rel_sd,
        flags=tuple(dict.fromkeys(flags)),
        provenance={"isophotes": isophotes.told(geometry.view_angle_deg)} if isophotes.aspects else {},
    )


def _held(session: Session, material: Material) -> Held:
    """How the sample is held, as the fit will take it; InputError where that is impossible."""
    of_beam = {key: getattr(session.beam, key) for key in ("incidence_deg", "spot_radius_mm")}
    of_sample = {key: getattr(material, key) for key in SAMPLE_KEYS}
    return held(Slice({}, material.eta, "incident", "fresnel", **of_beam, **of_sample))


def _light(
    image: Image,
    channel: str,
    spot: Spot,
    around: Surroundings,
    options: SliceOptions,
    hidden: float,
    *,
    reflects: float = 0.0,
    per_light: float = 0.0,
) -> tuple[TotalReflectance, list[str]]:
    """All light of an image in a channel, what an even floor under it does allowed for, and the flags of that.

    1/KΦ is `per_light`, or what makes the light of a surface that `reflects` so much. Glare only adds: a floor surely
    below 0 is that of darks brighter than black in the frames, and goes; any other stays, unless it was asked for, and
    is doubted.
    """
    within = light_within(image, channel, spot)
    total = total_light(image, spot, within, around, glare=False)
    if hidden > 0:
        return rounded(total, hidden, image, spot), [Flag.COARSE_STEPS]
    per_light = per_light or reflects / total.light
    if options.glare:
        return total_light(image, spot, within, around, glare=True, per_light=per_light), []
    floor = evident_floor(image, spot, around, total, per_light)
    if floor is None:
        return total, []
    without = total_light(image, spot, within, around, glare=True, per_light=per_light)
    if floor.value < -_SURE_SD * floor.sd:
        return without, [Flag.BLACK_OFFSET]
    total, notable = doubted(total, without, floor)
    return total, [Flag.GLARE] if notable and floor.value > 0 else []


def _plausible(total: float, channel: str, session: Session, found: Sequence[str]) -> float:
    """The total; InputError, with what was found, where no surface can be as bright, or as dark."""
    if not 0 < total <= TOTAL_R_MAX:
        told = [meaning_of(flag).partition(":")[0] for flag in dict.fromkeys(found) if flag in _EXPLAIN]
        asked = "was the reference lit by the same beam, and is its reflectance right?"
        reason = f"mend what the frames show: {'; '.join(told)}" if told else asked
        raise InputError(
            f"{session.path}: R = {total:.4g} in channel {channel} is beyond what a sample can reflect; {reason}"
        )
    return total


def _tables(session: Session) -> tuple[Material, Geometry, Reference]:
    """The tables that a slice needs; InputError where one is missing."""
    for name in ("material", "geometry", "reference"):
        if getattr(session, name) is None:
            raise InputError(f"{session.path / 'session.toml'}: has no [{name}]; add it, or measure with --hdr-only")
    assert session.material
    assert session.geometry
    assert session.reference
    return session.material, session.geometry, session.reference


def _image_flags(session: Session, sample: Image, reference: Image, spots: tuple[Spot, Spot]) -> list[str]:
    raised = {
        Flag.SECOND_SPOT: any(has_second_spot(*pair) for pair in zip((sample, reference), spots, strict=True)),
        Flag.SATURATED: any(image.is_saturated(c) for image in (sample, reference) for c in sample.channels),
        Flag.SPECKLE: session.beam.kind == "laser",
        Flag.POLARISED: session.beam.polarised and session.beam.incidence_deg > 0,
    }
    return [flag for flag, is_raised in raised.items() if is_raised]


def _spot_flags(given_mm: float, on_tile: Estimate) -> list[str]:
    raised = {Flag.SPOT_DIFFERS: abs(on_tile.value - given_mm) > max(_SPOT_SD * on_tile.sd, _SPOT_REL * given_mm)}
    return [flag for flag, is_raised in raised.items() if is_raised]


def _disagree(side: RadialProfile, everywhere: RadialProfile, around: Surroundings) -> bool:
    """Whether one side of the slice departs from the whole image by more than noise, a few percent and the exit law."""
    clear = (side.value > 10 * side.sd) & (side.r < everywhere.r[-1])
    if clear.sum() < _LEAST_BINS:
        return False
    departure = side.value[clear] / everywhere.curve()(side.r[clear]) - 1
    noise = np.median(side.sd[clear] / side.value[clear])
    exit_law = _DISAGREE_PER_SINE * (np.sin(np.radians(around.view_angle_deg)) / around.eta) ** 2
    return bool(np.median(np.abs(departure)) > np.hypot(_DISAGREE_REL, 2 * noise) + exit_law)


def reflectance_of(tile: Reference, channel: str, session: Session, image: Image) -> float:
    """The tile's radiance factor in a channel: one value for all, one for each channel, or one for each used."""
    values = tile.reflectance
    every = channel_names(image.layout, session.beam)
    if len(values) == 1:
        return values[0]
    for names in (every, image.channels):
        if len(values) == len(names):
            return values[names.index(channel)]
    raise InputError(
        f"{session.path / 'session.toml'}: [reference] reflectance has {len(values)} values for the {len(every)} "
        f"channels {', '.join(every)}; give one for each"
    )
