"""The scene as it goes into the page: pictures as WebP, marks as points of an SVG over them."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.measure import Image, Marks, images_of, light_of, marks_of, picture, saturation_map
from bssrdf.report.evidence import Evidence
from bssrdf.report.tiles import Saturation

_QUALITY = 82
_RED = (48, 59, 255, 255)
"""BGRA of the mask of saturated pixels."""


class ScenePicture(NamedTuple):
    """One image with its marks, in pixels of the frame."""

    kind: str
    title: str
    width: int
    height: int
    picture: str
    """A data URL."""
    mask: str
    """Likewise; empty where nothing is saturated."""
    stroke: float
    spot: str
    slice: str
    band: str
    isophote: str
    isophote_mm: str
    note: str


class Scenes(NamedTuple):
    """The pictures, and what they tell in words and numbers."""

    pictures: list[ScenePicture]
    marks: dict[str, Marks]
    saturation: list[Saturation]
    laid: str


def scenes_of(evidence: Evidence) -> Scenes | str:
    """The pictures of sample and reference, or in words why there are none."""
    if evidence.merged is None or evidence.session is None:
        return evidence.missing.get("images", "there is no image")
    if evidence.session.geometry is None:
        return "session.toml has no [geometry], so that nothing can be drawn on the picture"
    curve = evidence.pieces[0].curve if evidence.pieces else None
    try:
        images = images_of(evidence.session, evidence.merged)
        marks = marks_of(evidence.session, images, curve)
    except InputError as error:
        return str(error)
    white = light_of(images["reference"]) if "reference" in images else dict.fromkeys(images["sample"].channels, 1.0)
    pictures = [_picture(kind, image, marks[kind], white) for kind, image in images.items()]
    saturation = [
        Saturation(kind, channel, count, count / marks[kind].pixels[channel])
        for kind in images
        for channel, count in marks[kind].saturated.items()
    ]
    return Scenes(pictures, marks, saturation, _laid(marks["sample"], curve) if "sample" in marks else "")


def _picture(kind: str, image: Image, marks: Marks, white: dict[str, float]) -> ScenePicture:
    height, width = image.hdr.shape[:2]
    shown, clipped = picture(image, white), saturation_map(image)
    mask = ""
    if clipped.any():
        rgba = np.zeros((*clipped.shape, 4), np.uint8)
        rgba[clipped] = _RED
        mask = _data_url(".png", rgba, [])
    counted = sum(marks.saturated.values())
    note = f"spot at ({marks.centre_px[0]:.1f}, {marks.centre_px[1]:.1f}) px; " + (
        f"{counted} pixels saturated in every exposure" if counted else "no pixel saturated in every exposure"
    )
    return ScenePicture(
        kind,
        "Sample" if kind == "sample" else "Reference tile",
        width,
        height,
        _data_url(".webp", shown[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, _QUALITY]),
        mask,
        max(width, height) / 450,
        _points(marks.spot_px),
        _points(marks.slice_px),
        _points(marks.band_px),
        _points(marks.isophote_px),
        f"{marks.isophote_mm:.3g}",
        note,
    )


def _laid(marks: Marks, curve: object) -> str:
    x, y = marks.centre_px
    if not len(marks.slice_px):
        how = (
            "an average over all directions about" if curve is not None else "no slice is measured yet; the spot is at"
        )
        return f"{how} ({x:.1f}, {y:.1f}) px."
    (x_0, y_0), (x_1, y_1) = marks.slice_px[0], marks.slice_px[-1]
    return f"from ({x_0:.0f}, {y_0:.0f}) over the spot at ({x:.1f}, {y:.1f}) to ({x_1:.0f}, {y_1:.0f}) px of the frame."


def _points(points: Iterable[Iterable[float]]) -> str:
    return " ".join(",".join(f"{value:.1f}" for value in point) for point in points)


def _data_url(extension: str, pixels: NDArray[np.uint8], options: list[int]) -> str:
    done, encoded = cv2.imencode(extension, np.ascontiguousarray(pixels), options)
    if not done:
        raise InputError(f"the picture cannot be encoded as {extension}; check the OpenCV that is installed")
    return f"data:image/{extension[1:]};base64,{base64.b64encode(encoded.tobytes()).decode()}"
