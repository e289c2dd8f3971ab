"""The response curve of a camera whose files are not linear (JPEG, video), after Debevec and Malik 1997."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError

_LEAST_EXPOSURES = 3


def response_curve(frames: Sequence[NDArray[np.uint8]], exposures_s: Sequence[float]) -> NDArray[np.float64]:
    """Relative light for each of the 256 values, (256,) or (256, 3), 1 at value 128.

    `frames` are 8-bit images (h, w) or (h, w, 3) of one still scene. InputError for fewer than three of them.
    """
    if len(frames) < _LEAST_EXPOSURES:
        raise InputError(f"{len(frames)} exposures do not tell the response of a camera; give at least three")
    if frames[0].dtype != np.uint8:
        raise InputError(f"frames of {frames[0].dtype} have no response curve to be found; only 8-bit files have")
    flat = frames[0].ndim == 2
    images = [cv2.merge([frame] * 3) if flat else frame for frame in frames]
    found = cv2.createCalibrateDebevec().process(images, np.asarray(exposures_s, np.float32))
    curve: NDArray[np.float64] = np.asarray(found).astype(np.float64).reshape(256, 3)
    relative = curve / curve[128]
    return relative[:, 0] if flat else relative


def linearised(frame: NDArray[np.uint8], curve: NDArray[np.float64]) -> NDArray[np.float32]:
    """Relative light of each pixel of a frame, by its response curve."""
    if curve.ndim == 1:
        return np.asarray(curve[frame], np.float32)
    return np.stack([curve[frame[..., channel], channel] for channel in range(3)], axis=-1).astype(np.float32)
