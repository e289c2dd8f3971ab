"""What else can be wrong with a total reflectance, as relative standard errors: exposure times, drift, speckle."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from bssrdf.calib.frame_model import Exposures
from bssrdf.session.records import Array, Session

_NM_OF_CHANNEL = {"R": 630.0, "G": 532.0, "B": 465.0}


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
