"""Images that another tool has merged: linear, of unknown exposure and noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from bssrdf.errors import InputError
from bssrdf.measure.merge import NO_DATA, Hdr, Plane
from bssrdf.measure.pixels import mosaic_period
from bssrdf.session.frame_files import read_linear_image
from bssrdf.session.records import Camera, Frame, Session

_NEIGHBOURHOOD = 9
_BRIGHT_EDGE = 0.05
"""Share of the brightest pixel: what leaves a spot's surroundings at this level is more than is put back."""


def read_elsewhere(
    session: Session, frames: Sequence[Frame], rel_sd: float | None = None
) -> tuple[dict[str, Hdr], Camera]:
    """The images of kind sample_hdr and reference_hdr as sample and reference, and the camera with their layout.

    `rel_sd` is the relative error of a pixel, where it is known; else the scatter tells it.
    """
    images: dict[str, Hdr] = {}
    camera = session.camera
    for frame in frames:
        kind, _, suffix = frame.kind.partition("_")
        if suffix != "hdr":
            continue
        if kind in images or any(other.kind == kind for other in frames):
            raise InputError(f"{frame.file}: is one of several images of the {kind}; leave one in frames.csv")
        radiance = read_linear_image(session.path / frame.file)
        _check_light_is_inside(frame, radiance)
        layout = "rgb" if radiance.ndim == 3 else session.camera.layout or frame.card.layout or "mono"
        if images and layout != camera.layout:
            raise InputError(
                f"{frame.file}: has the layout {layout}, the image before {camera.layout}; merge both alike"
            )
        camera = replace(camera, layout=layout)
        images[kind] = _with_variance(radiance, mosaic_period(layout), rel_sd)
    return images, camera


def _check_light_is_inside(frame: Frame, radiance: Plane) -> None:
    """InputError where it is bright beside pixels without data: the data window of the file cuts off the spot."""
    light = radiance if radiance.ndim == 2 else radiance.sum(2)
    usable = np.isfinite(light)
    beside = usable & (cv2.dilate((~usable).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    if beside.any() and light[beside].max() > _BRIGHT_EDGE * light[usable].max():
        raise InputError(f"{frame.file}: its data window cuts through the spot; save the whole picture")


def _with_variance(radiance: Plane, period: int, rel_sd: float | None) -> Hdr:
    """The image with its variance, given or by its own scatter; pixels that are no number have no data."""
    usable = np.isfinite(radiance)
    numbers = np.nan_to_num(radiance, posinf=0.0, neginf=0.0)
    return Hdr(
        np.where(usable, radiance, np.float32(np.nan)),
        scatter_variance(numbers, period) if rel_sd is None else np.square(np.float32(rel_sd) * numbers),
        usable.astype(np.uint16),
        np.where(usable, np.uint8(0), np.uint8(NO_DATA)),
    )


def scatter_variance(image: Plane, period: int) -> Plane:
    """Variance of the noise by how far pixels lie from the mean of their four neighbours of the same colour."""
    around = np.zeros((2 * period + 1, 2 * period + 1), np.float32)
    around[[0, -1, period, period], [period, period, 0, -1]] = 0.25
    residual = image - cv2.filter2D(image, cv2.CV_32F, around, borderType=cv2.BORDER_REFLECT_101)
    square = np.square(residual) / np.float32(1 + 1 / 4)
    size = _NEIGHBOURHOOD * period
    mean = cv2.blur(square, (size, size), borderType=cv2.BORDER_REFLECT_101)
    return np.maximum(np.asarray(mean, np.float32), 0)  # its running sum rounds below 0 beside a bright spot
