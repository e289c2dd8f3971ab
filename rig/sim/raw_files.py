"""Frames as files of a camera: DNG as a raw camera makes it."""

from __future__ import annotations

import io
from fractions import Fraction

import numpy as np
import tifffile
from numpy.typing import NDArray

from bssrdf.rig.sim.sensor import SimSensor

_FILTER = {"R": 0, "G": 1, "B": 2}
_COLOUR_FILTER_ARRAY = 32803
_IDENTITY_MATRIX = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
_D65 = 21


def dng_bytes(dn: NDArray[np.uint16], sensor: SimSensor, exposure_s: float, iso: int = 100) -> bytes:
    """A DNG (Adobe DNG 1.4, uncompressed) of a raw frame, with its exposure time and ISO as EXIF tags."""
    exposure = Fraction(exposure_s).limit_denominator(10_000)
    pattern = bytes(_FILTER[channel] for channel in sensor.layout)
    tags = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, pattern, True),  # CFAPattern
        (33434, "2I", 1, (exposure.numerator, exposure.denominator), True),  # ExposureTime
        (34855, "H", 1, iso, True),  # ISOSpeedRatings
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50707, "B", 4, bytes([1, 1, 0, 0]), True),  # DNGBackwardVersion
        (50708, "s", 0, "bssrdf simulated camera", True),  # UniqueCameraModel
        (50714, "H", 1, sensor.black_dn, True),  # BlackLevel
        (50717, "I", 1, sensor.white_dn, True),  # WhiteLevel
        (50721, "2i", 9, _IDENTITY_MATRIX, True),  # ColorMatrix1
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # AsShotNeutral
        (50778, "H", 1, _D65, True),  # CalibrationIlluminant1
    ]
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, dn, photometric=_COLOUR_FILTER_ARRAY, extratags=tags, metadata=None, software="bssrdf")
    return buffer.getvalue()
