"""What colour the measured total reflectance has under daylight D65, where the channels have a colour space."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bssrdf.session.records import Colour

_VISIBLE_NM = (440.0, 640.0)
"""Bands must reach from here to here for a colour to be told."""
_FEWEST_BANDS = 5
_BAND = re.compile(r"(\d+(?:\.\d+)?) ?nm")


class Swatch(NamedTuple):
    """A colour for the screen."""

    srgb: str
    """#rrggbb"""
    how: str


def swatch(total_r: Mapping[str, float], colour: Colour | None) -> Swatch | str:
    """The colour of R by channel, or in words why there is none.

    Channels R, G, B go through the session's [colour] matrix, X, Y, Z as they are, bands such as 633nm through the
    2° observer. colour-science does the rest.
    """
    known = {name: value for name, value in total_r.items() if np.isfinite(value)}
    bands = {float(match[1]): value for name, value in known.items() if (match := _BAND.fullmatch(name))}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # colour-science warns of optional packages
        import colour as science

        if {"R", "G", "B"} <= known.keys():
            if colour is None:
                return (
                    "no swatch: R, G and B are the camera's own, and session.toml has no [colour]; "
                    "make one with `bssrdf calibrate colour`"
                )
            linear = np.array(colour.matrix) @ np.array([known[name] for name in "RGB"])
            return Swatch(_hex(science.cctf_encoding(np.clip(linear, 0, 1))), "by the session's [colour]")
        if {"X", "Y", "Z"} <= known.keys():
            xyz = np.array([known[name] for name in "XYZ"])
            return Swatch(_hex(science.XYZ_to_sRGB(xyz)), "X, Y, Z as they are")
        if len(bands) >= _FEWEST_BANDS and min(bands) <= _VISIBLE_NM[0] and max(bands) >= _VISIBLE_NM[1]:
            spectrum = science.SpectralDistribution(bands).extrapolate(science.SpectralShape(360, 780, 1))
            spectrum = spectrum.interpolate(science.SpectralShape(360, 780, 1))
            xyz = science.sd_to_XYZ(spectrum, illuminant=science.SDS_ILLUMINANTS["D65"]) / 100
            return Swatch(_hex(science.XYZ_to_sRGB(xyz)), f"from {len(bands)} bands, the 2° observer")
    return f"no swatch: the channels {', '.join(total_r) or '–'} have no colour space"


def _hex(srgb: Any) -> str:
    return "#" + "".join(f"{round(255 * value):02x}" for value in np.clip(srgb, 0, 1))
