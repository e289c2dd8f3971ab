"""Calibration targets lying in the plane of the sample: ChArUco boards and dot grids. Lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError

Array = NDArray[np.float64]
Image8 = NDArray[np.uint8]

_LEAST_POINTS = 12
_MARGIN_USED = 0.8
_CORNER_BLUR_PX = 1.0
"""Halves the error of corners in a sharp image, whose edges are too steep for the pixels."""
_DARKEST, _BRIGHTEST = 0.5, 99.5
"""Percentiles of the frame that become black and white."""


@dataclass(frozen=True)
class Target:
    """A printed target: `columns` × `rows` squares of a ChArUco board, or dots of a grid, `pitch_mm` apart."""

    columns: int
    rows: int
    pitch_mm: float
    kind: Literal["charuco", "dots"] = "charuco"
    marker_share: float = 0.75
    """Side of a marker over that of its square."""
    dictionary: str = "DICT_4X4_250"
    """OpenCV's name of the set of markers."""

    def board(self) -> Any:
        """OpenCV's description of the board."""
        if not hasattr(cv2.aruco, self.dictionary):
            raise InputError(f"dictionary {self.dictionary} is not known to OpenCV; use a name such as DICT_4X4_250")
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        size = (self.columns, self.rows)
        return cv2.aruco.CharucoBoard(size, self.pitch_mm, self.marker_share * self.pitch_mm, markers)


def find_target(path: Path, image: Image8, target: Target) -> tuple[Array, Array]:
    """Points of the target in the image [px] and on the target [mm], each (n, 2); InputError where it is not found."""
    finder = _charuco if target.kind == "charuco" else _dots
    points_px, points_mm = finder(image, target)
    if len(points_px) < _LEAST_POINTS:
        raise InputError(
            f"{path}: shows {len(points_px)} points of the {target.columns} x {target.rows} {target.kind} target, "
            f"at least {_LEAST_POINTS} are needed; check the target's description, its focus and light"
        )
    return points_px, points_mm


def _charuco(image: Image8, target: Target) -> tuple[Array, Array]:
    board = target.board()
    # A corner is refined in the white margin of the markers: within a wider window they would pull at it.
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    if ids is None:
        return np.empty((0, 2)), np.empty((0, 2))
    on_board = np.asarray(board.getChessboardCorners(), float)[ids.ravel(), :2]
    pitch_px = np.ptp(corners.reshape(-1, 2), axis=0) / np.maximum(np.ptp(on_board, axis=0) / target.pitch_mm, 1)
    window = np.clip(_MARGIN_USED * (1 - target.marker_share) / 2 * pitch_px, 3, 15).astype(int)
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    smooth = cv2.GaussianBlur(image, (0, 0), _CORNER_BLUR_PX)
    sharp = cv2.cornerSubPix(smooth, np.asarray(corners, np.float32), window.tolist(), (-1, -1), stop)
    return np.asarray(sharp, float).reshape(-1, 2), on_board


def _dots(image: Image8, target: Target) -> tuple[Array, Array]:
    found, centres = cv2.findCirclesGrid(image, (target.columns, target.rows), flags=cv2.CALIB_CB_SYMMETRIC_GRID)
    if not found:
        return np.empty((0, 2)), np.empty((0, 2))
    row, column = np.divmod(np.arange(target.columns * target.rows), target.columns)
    return np.asarray(centres, float).reshape(-1, 2), target.pitch_mm * np.stack([column, row], axis=1).astype(float)


def grey(data: NDArray[Any], layout: str) -> Image8:
    """A frame as an 8-bit grey image of its own size, without shifting any edge.

    On a colour filter mosaic the kernel (1 2 1)⊗(1 2 1) weighs the colours alike at every pixel.
    """
    plane = data.astype(np.float32)
    if plane.ndim == 3:
        plane = plane.mean(axis=2)
    elif layout != "mono":
        kernel = np.array([1.0, 2.0, 1.0]) / 4
        plane = np.asarray(cv2.sepFilter2D(plane, cv2.CV_32F, kernel, kernel), np.float32)
    low, high = np.percentile(plane, (_DARKEST, _BRIGHTEST))
    return np.asarray(np.clip(255 * (plane - low) / max(high - low, 1e-9), 0, 255), np.uint8)
