"""The response curve of a camera whose files are not linear (JPEG, video), after Debevec and Malik 1997."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError

Array = NDArray[np.float64]
Image8 = NDArray[np.uint8]

_LEAST_EXPOSURES = 3
_TELLING = (25, 230)
"""Values by which pixels are chosen: neither in the dark nor near saturation."""
_SATURATED = 250
_SIDE = 16
"""OpenCV takes its pixels from a grid: it is given a square of this many pixels a side."""


@dataclass(frozen=True)
class Response:
    """Light by value, (256, channels), 255 at the value 255 of the brightest channel."""

    curve: Array

    @property
    def saturation(self) -> float:
        """Light from which on some channel is taken as clipped."""
        return float(self.curve[_SATURATED].min())

    def linearised(self, path: Path, frame: Image8) -> NDArray[np.float32]:
        """Light of each pixel of a frame (h, w) or (h, w, 3); InputError, naming its file, for another kind."""
        channels = frame.shape[2] if frame.ndim == 3 else 1
        if frame.dtype != np.uint8 or channels != self.curve.shape[1]:
            raise InputError(f"{path}: is not an 8-bit image of {self.curve.shape[1]} channels, as the first frame is")
        planes = [self.curve[plane, c] for c, plane in enumerate(np.moveaxis(np.atleast_3d(frame), 2, 0))]
        return np.stack(planes, axis=-1).reshape(frame.shape).astype(np.float32)


def fit_response(frames: Sequence[Image8], exposures_s: Sequence[float]) -> Response:
    """The response from 8-bit frames (h, w) or (h, w, 3) of one still scene; InputError where they tell too little."""
    if len(frames) < _LEAST_EXPOSURES:
        raise InputError(f"{len(frames)} exposures do not tell the response of a camera; give at least three")
    planes = [np.atleast_3d(frame) for frame in frames]
    channels = [_curve([plane[..., c] for plane in planes], exposures_s) for c in range(planes[0].shape[2])]
    curve = np.maximum.accumulate(np.stack(channels, axis=1))
    return Response(255 * curve / curve[-1].max())


def _curve(planes: Sequence[Image8], exposures_s: Sequence[float]) -> Array:
    """Light by value of one channel, from pixels that see as many levels of light as there are."""
    telling = np.sum([(plane > _TELLING[0]) & (plane < _TELLING[1]) for plane in planes], axis=0)
    pixels = np.flatnonzero(telling >= 2)
    if pixels.size < _SIDE**2:
        raise InputError(f"{pixels.size} pixels are well exposed in two frames; take exposures a stop or two apart")
    level = np.sum(planes, axis=0, dtype=int).ravel()[pixels]
    chosen = pixels[np.argsort(level)][np.linspace(0, pixels.size - 1, _SIDE**2).astype(int)]
    images = [cv2.merge([plane.ravel()[chosen].reshape(_SIDE, _SIDE)] * 3) for plane in planes]
    found = cv2.createCalibrateDebevec(_SIDE**2).process(images, np.asarray(exposures_s, np.float32))
    curve: Array = np.asarray(found, np.float64).reshape(256, 3)[:, 0]
    return curve / curve[128]
