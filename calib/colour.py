"""`bssrdf calibrate colour`: camera RGB to linear sRGB from a colour chart, and slices converted by it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session import read_frame_file
from bssrdf.session.records import Camera

Array = NDArray[np.float64]

_PATCHES = 24
_PATCH_HALF_PX = 3
_SINGULAR = 1e-9
_DIP = 0.05
"""A simulated Nikon D5100 under daylight and a white LED sees 0.05 to 0.6 in skin, pale to dark, and meat, where the
matrix is hardly better than none; less in milk, marble, jade, wax, soap; but more in ketchup, juice, a blue dye too."""


@dataclass(frozen=True)
class ColourCalibration:
    """Matrix from linear camera RGB, scaled so that white is 1, to linear sRGB (D65)."""

    matrix: Array
    """3×3."""
    rms: float
    """Root mean square miss of the patches, in linear sRGB."""


def calibrate_colour(path: Path, camera: Camera) -> ColourCalibration:
    """Fit the matrix to a 24-patch ColorChecker in a frame; `camera` says what the file does not.

    InputError where the frame cannot be read, is of one colour, or shows no chart.
    """
    frame = read_frame_file(path)
    layout = camera.layout or frame.layout or "mono"
    black = frame.black if camera.black is None else camera.black
    return fit_matrix(chart_patches(path, linear_rgb(path, frame.data, layout, 0.0 if black is None else black)))


def linear_rgb(path: Path, data: NDArray[Any], layout: str, black: float | NDArray[np.float64]) -> Array:
    """RGB above black (h, w, 3); of a colour filter mosaic at half its size, a 2×2 cell for a pixel."""
    if layout == "rgb":
        return np.asarray(data, float) - black
    if set(layout) != set("RGB"):
        raise InputError(f"{path}: has the layout {layout}, from which no colour can be had; use an RGB camera")
    levels = np.broadcast_to(black, (2, 2))
    height, width = (n // 2 * 2 for n in data.shape)
    cell = [data[row:height:2, column:width:2] - levels[row, column] for row in (0, 1) for column in (0, 1)]
    return np.stack(
        [np.mean([part for part, letter in zip(cell, layout, strict=True) if letter == c], axis=0) for c in "RGB"],
        axis=-1,
    )


def chart_patches(path: Path, image: NDArray[Any]) -> Array:
    """Mean linear RGB of the 24 patches (24, 3), in the chart's order."""
    shown = np.clip(image / max(float(np.percentile(image, 99.5)), 1e-9), 0, 1) ** (1 / 2.2)
    detector: Any = cv2.mcc.CCheckerDetector.create()
    of_opencv_4: tuple[int, ...] = (cv2.mcc.MCC24,)
    if hasattr(detector, "setColorChartType"):
        of_opencv_4 = ()
        detector.setColorChartType(cv2.mcc.MCC24)
        detector.setUseDnnModel(False)
    if not detector.process(np.ascontiguousarray(255 * shown[..., ::-1], np.uint8), *of_opencv_4):
        raise InputError(f"{path}: shows no 24-patch colour chart; fill a third of the frame with it, evenly lit")
    corners = np.asarray(detector.getBestColorChecker().getBox(), np.float32)
    column, row = np.meshgrid((np.arange(6) + 0.5) / 6, (np.arange(4) + 0.5) / 4)
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    to_image = cv2.getPerspectiveTransform(unit, corners)
    centres = cv2.perspectiveTransform(np.stack([column, row], axis=-1).reshape(1, _PATCHES, 2), to_image)[0]
    half = _PATCH_HALF_PX
    return np.array(
        [
            np.mean(image[round(y) - half : round(y) + half + 1, round(x) - half : round(x) + half + 1], axis=(0, 1))
            for x, y in centres
        ],
        float,
    )


def fit_matrix(patches: Array) -> ColourCalibration:
    """The matrix that takes measured patches (24, 3) to those of the ColorChecker 24 (Finlayson 2015 with one term)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # colour-science warns of optional packages
        import colour

        chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
        xyz = colour.xyY_to_XYZ(np.array(list(chart.data.values())))
        wanted = colour.XYZ_to_RGB(xyz, "sRGB", chart.illuminant)
        white = patches[_PATCHES - 6]
        scaled = patches / white.mean() * wanted[_PATCHES - 6].mean()
        matrix = np.asarray(colour.matrix_colour_correction(scaled, wanted, method="Cheung 2004", terms=3), float)
    miss = scaled @ matrix.T - wanted
    return ColourCalibration(matrix, float(np.sqrt(np.mean(miss**2))))


def slice_matrix(matrix: Array, space: str) -> Array:
    """3×3 from R, G, B over those of a white tile to linear `space` ("lin_rec709", "acescg").

    A chart's matrix takes raw numbers; those over a tile are balanced already. White is white in both, so each column
    is taken times what white reads in it: rows add up to 1. InputError where the matrix cannot be inverted.
    """
    if abs(np.linalg.det(matrix)) < _SINGULAR * np.abs(matrix).max() ** 3:
        raise InputError("the [colour] matrix has no inverse; run `bssrdf calibrate colour` again")
    to_rec709 = matrix * np.linalg.solve(matrix, np.ones(3))
    if space == "lin_rec709":
        return np.asarray(to_rec709)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # colour-science warns of optional packages
        import colour

        return np.asarray(colour.matrix_RGB_to_RGB("sRGB", "ACEScg") @ to_rec709, float)


def may_have_narrow_band(total_r: Array) -> bool:
    """Whether total reflectances in R, G, B leave room for an absorption band that a matrix gets wrong.

    Three numbers do not show a band. But where green absorbs more than red and blue lead one to expect, by
    Kubelka–Munk's ln((1 − R)²/2R), as the bands of blood make it, there is room for one.
    """
    r = np.clip(total_r, 1e-6, 1 - 1e-6)
    red, green, blue = np.log((1 - r) ** 2 / (2 * r))
    return bool(green - (red + blue) / 2 > _DIP)
