"""What is wrong with a total reflectance beyond noise, as relative standard errors: times, drift, speckle, the tile."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bssrdf.calib import Exposures
from bssrdf.measure.reflectance import TotalReflectance
from bssrdf.session.flags import Flag
from bssrdf.session.records import Array, Geometry, Reference, Session

_REFLECTANCE_REL_SD = 0.01
"""Of a tile whose certificate is not at hand: batches of sintered PTFE differ by about as much, and age more."""
_SCALE_REL_SD = 0.005
"""Of a scale read off a ruler in the picture: half a millimetre in a hundred."""
_VIEW_ANGLE_SD_DEG = 1.0
"""Of an angle set by eye and protractor."""
_NM_OF_CHANNEL = {"R": 630.0, "G": 532.0, "B": 465.0}


@dataclass(frozen=True)
class Timing:
    """The frames of one kind as they were merged, shortest first."""

    labels_s: tuple[float, ...]
    seconds: tuple[float, ...]
    flux_rel_sd: float
    """Relative scatter of the light between repeats."""
    hidden_dn: float = 0.0
    """Signal [DN] up to which the rounding of the data may show nothing."""

    def hidden(self) -> float:
        """The same as radiance [DN/s], in the longest exposure."""
        return self.hidden_dn / max(self.seconds)


def common_errors(
    back: TotalReflectance, incident: TotalReflectance, timing: Mapping[str, Timing], exposures: Exposures
) -> list[float]:
    """Independent relative errors of what the beam carries, as it is compared with the sample: of curve and total."""
    sample, reference = (
        exposure_shares(total.within.by_count, timing[kind].labels_s, timing[kind].seconds) if kind in timing else {}
        for kind, total in (("sample", back), ("reference", incident))
    )
    return [
        incident.sd / incident.light,
        exposures_rel_sd(sample, reference, exposures),
        *(kind.flux_rel_sd for kind in timing.values()),
    ]


def exposure_shares(light_by_count: Array, labels_s: Sequence[float], seconds: Sequence[float]) -> dict[float, float]:
    """How much of an image's light each exposure label decides, from its light by the number of frames used.

    `labels_s` and `seconds` are those of the frames, shortest first. A pixel used in n frames was bright enough to
    saturate the others, so it rests on the n shortest, on each by its share of their time.
    """
    shares = dict.fromkeys(labels_s, 0.0)
    for n, light in enumerate(light_by_count[1 : len(labels_s) + 1], 1):
        for label, t in zip(labels_s[:n], seconds[:n], strict=True):
            shares[label] += float(light) * t / sum(seconds[:n]) / float(light_by_count.sum())
    return shares


def exposures_rel_sd(sample: dict[float, float], reference: dict[float, float], exposures: Exposures) -> float:
    """Error of the ratio of two images' light by that of the exposure times which decide them."""
    shares = {"sample": sample, "reference": {label: -share for label, share in reference.items()}}
    difference = np.array([shares.get(kind, {}).get(label, 0.0) for kind, label in exposures.frames])
    return float(np.sqrt(max(difference @ exposures.covariance @ difference, 0.0)))


def speckle_rel_sd(spot_radius_mm: float, channel: str, session: Session) -> float:
    """Speckle of a laser spot on the tile: one over the root of the étendue in units of λ²."""
    assert session.geometry
    named = re.fullmatch(r"(\d+(?:\.\d+)?) ?nm", channel)
    wavelength_mm = 1e-6 * (float(named[1]) if named else _NM_OF_CHANNEL.get(channel, 550.0))
    area_mm2 = np.pi * spot_radius_mm**2 * np.cos(np.radians(session.geometry.view_angle_deg))
    solid_angle = np.pi / 4 * (session.camera.aperture_mm / session.geometry.distance_mm) ** 2
    return float(wavelength_mm / np.sqrt(area_mm2 * solid_angle))


def polarisation_rel_sd(incidence_deg: float, eta: float) -> float:
    """Relative sd of the flux that enters, of light polarised in a direction that is not known.

    Fresnel's two reflectances differ from their mean by ±d; over all directions the share that enters has the sd d/√2.
    """
    cos_i = math.cos(math.radians(incidence_deg))
    cos_t = math.sqrt(1 - (1 - cos_i**2) / eta**2)
    across = ((cos_i - eta * cos_t) / (cos_i + eta * cos_t)) ** 2
    along = ((cos_t - eta * cos_i) / (cos_t + eta * cos_i)) ** 2
    return (across - along) / 2 / (1 - (across + along) / 2) / math.sqrt(2)


class StatedErrors(NamedTuple):
    """Errors that no picture tells: as session.toml states them, else as assumed, with the flags that say so."""

    tile_rel_sd: float
    """Largest over the channels."""
    mm_rel_sd: float
    view_angle_sd_deg: float
    flags: list[str]


def stated_errors(tile: Reference, geometry: Geometry) -> StatedErrors:
    """The errors of tile, scale and view angle."""
    tile_rel_sd = None
    if tile.reflectance_sd is not None:
        tile_rel_sd = max(sd / value for sd, value in zip(tile.reflectance_sd, tile.reflectance, strict=True))
    stated = (tile_rel_sd, geometry.mm_per_px_rel_sd, geometry.view_angle_sd_deg)
    usual = (_REFLECTANCE_REL_SD, _SCALE_REL_SD, _VIEW_ANGLE_SD_DEG)
    raised = {
        Flag.REFLECTANCE_SD_ASSUMED: stated[0] is None,
        Flag.SCALE_SD_ASSUMED: stated[1] is None,
        Flag.VIEW_ANGLE_SD_ASSUMED: stated[2] is None,
    }
    of_tile, of_mm, of_angle = (b if a is None else a for a, b in zip(stated, usual, strict=True))
    return StatedErrors(of_tile, of_mm, of_angle, [flag for flag, is_raised in raised.items() if is_raised])
