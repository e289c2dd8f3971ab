"""Calibration targets lying in the plane of the sample: ChArUco and chess boards, dot grids. Lengths in mm."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
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
_SQUARE_USED = 0.4
"""Half width of the window in which a corner between plain squares is refined, in squares."""
_LENS_OF_PITCH = 0.25
"""A dot may lie off the plain perspective of the others by this share of the pitch: what a lens bends."""
_CORNER_BLUR_PX = 1.0
"""Halves the error of corners in a sharp image, whose edges are too steep for the pixels."""
_DARKEST, _BRIGHTEST = 0.5, 99.5
"""Percentiles of the frame that become black and white."""


@dataclass(frozen=True)
class Target:
    """A printed target: `columns` × `rows` squares of a board, or dots of a grid, `pitch_mm` apart.

    In a grid whose rows are offset by half a pitch, `pitch_mm` is the distance of the dots in a row, and rows lie half
    a pitch apart.
    """

    columns: int
    rows: int
    pitch_mm: float
    kind: Literal["charuco", "dots"] = "charuco"
    marker_share: float = 0.75
    """Side of a marker over that of its square."""
    dictionary: str = "DICT_4X4_250"
    """OpenCV's name of the set of markers."""

    def board(self, *, legacy: bool = False) -> Any:
        """OpenCV's description of the board; `legacy` is the layout before OpenCV 4.6, another where `rows` is even."""
        if not hasattr(cv2.aruco, self.dictionary):
            raise InputError(f"dictionary {self.dictionary} is not known to OpenCV; use a name such as DICT_4X4_250")
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.pitch_mm, self.marker_share * self.pitch_mm, markers)
        board.setLegacyPattern(legacy)
        return board


Points = tuple[Array, Array]
"""In the image [px] and on the target [mm], each (n, 2)."""
_NONE: Points = (np.empty((0, 2)), np.empty((0, 2)))


def find_target(path: Path, image: Image8, target: Target) -> Points:
    """Points of the target in the image [px] and on the target [mm], each (n, 2); InputError where it is not found.

    Light and dark may be exchanged, and so may `columns` and `rows`: neither changes where a point lies in mm.
    """
    found = max(_searches(image, target), key=lambda points: len(points[0]))
    if len(found[0]) < _LEAST_POINTS:
        raise InputError(
            f"{path}: shows {len(found[0])} points of the {target.columns} x {target.rows} {target.kind} target, "
            f"at least {_LEAST_POINTS} are needed; check the target's description, its focus and light"
        )
    return found


def _searches(image: Image8, target: Target) -> Iterator[Points]:
    """What each way of reading the target finds, up to the first that finds enough."""
    finders: tuple[Callable[[Image8, Target], Points], ...] = (
        (_charuco, _charuco_legacy, _chessboard) if target.kind == "charuco" else (_dots, _offset_dots)
    )
    yield _NONE
    for finder in finders:
        for turned in (target, replace(target, columns=target.rows, rows=target.columns)):
            for shown in (image, np.asarray(255 - image, np.uint8)):
                points = finder(shown, turned)
                yield points
                if len(points[0]) >= _LEAST_POINTS:
                    return


def _charuco(image: Image8, target: Target) -> Points:
    return _on_board(image, target, target.board())


def _charuco_legacy(image: Image8, target: Target) -> Points:
    return _on_board(image, target, target.board(legacy=True)) if target.rows % 2 == 0 else _NONE


def _on_board(image: Image8, target: Target, board: Any) -> Points:
    # A corner is refined in the white margin of the markers: within a wider window they would pull at it.
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    if ids is None:
        return _NONE
    on_board = np.asarray(board.getChessboardCorners(), float)[ids.ravel(), :2]
    return _sharpened(image, corners, on_board, target.pitch_mm, _MARGIN_USED * (1 - target.marker_share) / 2), on_board


def _chessboard(image: Image8, target: Target) -> Points:
    """The inner corners of a board without markers."""
    inner = (target.columns - 1, target.rows - 1)
    if min(inner) < 2:
        return _NONE
    found, corners = cv2.findChessboardCorners(image, inner, flags=cv2.CALIB_CB_ADAPTIVE_THRESH)
    if not found:
        return _NONE
    on_board = target.pitch_mm * _grid(*inner)
    return _sharpened(image, corners, on_board, target.pitch_mm, _SQUARE_USED), on_board


def _sharpened(image: Image8, corners: Any, on_board: Array, pitch_mm: float, window_of_pitch: float) -> Array:
    pitch_px = np.ptp(corners.reshape(-1, 2), axis=0) / np.maximum(np.ptp(on_board, axis=0) / pitch_mm, 1)
    window = np.clip(window_of_pitch * pitch_px, 3, 15).astype(int)
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    smooth = cv2.GaussianBlur(image, (0, 0), _CORNER_BLUR_PX)
    sharp = cv2.cornerSubPix(smooth, np.asarray(corners, np.float32), window.tolist(), (-1, -1), stop)
    return np.asarray(sharp, float).reshape(-1, 2)


def _dots(image: Image8, target: Target) -> Points:
    """Dots in straight rows and columns, dark on light."""
    return _grid_of_dots(image, target, cv2.CALIB_CB_SYMMETRIC_GRID, _grid(target.columns, target.rows))


def _offset_dots(image: Image8, target: Target) -> Points:
    """Dots of which each second row is offset by half a pitch, dark on light.

    OpenCV orders them wrongly for an even number of rows, unless the picture is turned.
    """
    column, row = _grid(target.columns, target.rows).T
    places = np.stack([column + row % 2 / 2, row / 2], axis=1)
    points = _grid_of_dots(image, target, cv2.CALIB_CB_ASYMMETRIC_GRID, places)
    if len(points[0]):
        return points
    turned = np.ascontiguousarray(np.rot90(image))
    px, mm = _grid_of_dots(turned, target, cv2.CALIB_CB_ASYMMETRIC_GRID, places)
    return np.stack([image.shape[1] - 1 - px[:, 1], px[:, 0]], axis=1), mm


def _grid_of_dots(image: Image8, target: Target, flags: int, places: Array) -> Points:
    """Dots found in the picture that also lie as the target says, seen through any perspective."""
    if min(target.columns, target.rows) < 2:
        return _NONE
    size = (target.columns, target.rows)
    found, centres = cv2.findCirclesGrid(image, size, flags=flags, blobDetector=_blobs(image.size / len(places)))
    if not found:
        return _NONE
    px = np.asarray(centres, float).reshape(-1, 2)
    drawn, _ = cv2.findHomography(places, px)
    missed_px = cv2.perspectiveTransform(places[None], drawn)[0] - px if drawn is not None else np.inf
    pitch_px = np.median(np.hypot(*np.diff(px[: target.columns], axis=0).T))
    return (px, target.pitch_mm * places) if np.abs(missed_px).max() < _LENS_OF_PITCH * pitch_px else _NONE


def _blobs(largest_px: float) -> Any:
    """OpenCV's finder of dark blobs up to an area: its own limit of 5000 px is less than a dot in 24 Mpx."""
    wanted = cv2.SimpleBlobDetector.Params()
    wanted.maxArea = max(largest_px, wanted.maxArea)
    return cv2.SimpleBlobDetector.create(wanted)


def _grid(columns: int, rows: int) -> Array:
    """Column and row of each point, (columns · rows, 2), row by row."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    return np.stack([column, row], axis=1).astype(float)


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
