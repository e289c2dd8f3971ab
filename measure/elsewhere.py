"""Images that another tool has merged: linear, of unknown exposure and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from bssrdf.errors import InputError
from bssrdf.measure.merge import NO_DATA, Hdr, Plane
from bssrdf.measure.pixels import mosaic_period
from bssrdf.session.hdr_exr import read_linear_image
from bssrdf.session.records import Camera, Frame, Session

_NEIGHBOURHOOD = 9


def read_elsewhere(session: Session, frames: Sequence[Frame]) -> tuple[dict[str, Hdr], Camera]:
    """The images of kind sample_hdr and reference_hdr as sample and reference, and the camera with their layout."""
    images: dict[str, Hdr] = {}
    camera = session.camera
    for frame in frames:
        kind, _, suffix = frame.kind.partition("_")
        if suffix != "hdr":
            continue
        if kind in images or any(other.kind == kind for other in frames):
            raise InputError(f"{frame.file}: is one of several images of the {kind}; leave one in frames.csv")
        radiance = read_linear_image(session.path / frame.file)
        layout = "rgb" if radiance.ndim == 3 else camera.layout or "mono"
        camera = replace(camera, layout=layout)
        images[kind] = _with_scatter(radiance, mosaic_period(layout))
    return images, camera


def _with_scatter(radiance: Plane, period: int) -> Hdr:
    """The image with the variance that its own scatter shows; pixels that are no number have no data."""
    usable = np.isfinite(radiance)
    return Hdr(
        np.where(usable, radiance, np.float32(np.nan)),
        scatter_variance(np.nan_to_num(radiance, posinf=0.0, neginf=0.0), period),
        usable.astype(np.uint8),
        np.where(usable, np.uint8(0), np.uint8(NO_DATA)),
    )


def scatter_variance(image: Plane, period: int) -> Plane:
    """Variance of the noise by how far pixels lie from the mean of their four neighbours of the same colour."""
    around = np.zeros((2 * period + 1, 2 * period + 1), np.float32)
    around[[0, -1, period, period], [period, period, 0, -1]] = 0.25
    residual = image - cv2.filter2D(image, cv2.CV_32F, around, borderType=cv2.BORDER_REFLECT_101)
    square = np.square(residual) / np.float32(1 + 1 / 4)
    size = _NEIGHBOURHOOD * period
    return np.asarray(cv2.blur(square, (size, size), borderType=cv2.BORDER_REFLECT_101), np.float32)
