"""`bssrdf calibrate geometry`: a target in the plane of the sample gives lens distortion and the pixel → mm map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from bssrdf.calib.surface import Surface
from bssrdf.calib.target import Target, find_target, grey
from bssrdf.errors import InputError
from bssrdf.session import Progress, counted, read_frame_file
from bssrdf.session.records import Distortion, Geometry

Array = NDArray[np.float64]

_FOCAL_OF_WIDTH = 1.5
"""Focal length in frame widths that the distortion is written for; any other gives the same map."""


@dataclass(frozen=True)
class GeometryCalibration:
    """What a target told, and how well its points fit."""

    geometry: Geometry
    """With the homography of the first image."""
    distortion: Distortion
    residual_mm: float
    """Root mean square over the points of the first image, in the surface."""
    residual_px: float
    n_points: int
    size_px: tuple[int, int]
    """Width and height of the pictures that the map is for."""


def calibrate_geometry(
    paths: Sequence[Path], target: Target, layout: str | None = None, *, progress: Progress | None = None
) -> GeometryCalibration:
    """Lens distortion from all images of the target, and where the pixels of the first lie on its plane.

    `layout` where the files do not tell their own. Places, not light, are read from them, so that PNG and JPEG serve.
    InputError where an image cannot be read or shows no target.
    """
    points, size = [], (1, 1)
    for path in counted(paths, "find the target", progress):
        frame = read_frame_file(path, encoded=True)
        points.append(find_target(path, grey(frame.data, layout or frame.layout or "mono"), target))
        before, size = size, (frame.data.shape[1], frame.data.shape[0])
        if len(points) > 1 and size != before:
            raise InputError(
                f"{path}: has {_shown(size)} px, not {_shown(before)} as the first; take plates of one size"
            )
    return fit_geometry(points, size)


def fit_geometry(points: Sequence[tuple[Array, Array]], size: tuple[int, int]) -> GeometryCalibration:
    """The same from points in the images [px] and on the target [mm], each (n, 2), of frames of (width, height)."""
    camera = _camera_matrix(size)
    start = [_homography(px, mm) for px, mm in points]
    first = np.concatenate([np.zeros(4), *(h.ravel()[:8] for h in start)])
    scale = np.concatenate([np.full(4, 1e-2), *(np.maximum(np.abs(h.ravel()[:8]), 1e-6) for h in start)])

    def residual(p: Array) -> Array:
        return np.concatenate(
            [
                (_drawn(mm, _matrix(p[4 + 8 * i : 12 + 8 * i]), p[:4], camera) - px).ravel()
                for i, (px, mm) in enumerate(points)
            ]
        )

    solved = least_squares(residual, first, x_scale=scale, loss="soft_l1", f_scale=0.5, max_nfev=500)
    distortion = Distortion(tuple(map(tuple, camera.tolist())), tuple(solved.x[:4].tolist()))
    to_mm = np.linalg.inv(_matrix(solved.x[4:12]))
    geometry = _geometry(to_mm / to_mm[2, 2], distortion, size)
    px, mm = points[0]
    seen = np.stack(Surface(geometry, distortion).to_mm(px[:, 0], px[:, 1]), axis=1)
    residual_mm = float(np.sqrt(np.mean(np.sum((seen - mm) ** 2, axis=1))))
    spread_mm = float(np.sqrt(np.mean(np.sum((mm - mm.mean(axis=0)) ** 2, axis=1))))
    geometry = replace(geometry, mm_per_px_rel_sd=residual_mm / spread_mm / float(np.sqrt(len(mm))))
    residual_px = float(np.sqrt(np.mean(np.sum(residual(solved.x)[: 2 * len(px)].reshape(-1, 2) ** 2, axis=1))))
    return GeometryCalibration(geometry, distortion, residual_mm, residual_px, len(px), size)


def _shown(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"


def _camera_matrix(size: tuple[int, int]) -> Array:
    focal = _FOCAL_OF_WIDTH * size[0]
    return np.array([[focal, 0.0, (size[0] - 1) / 2], [0.0, focal, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])


def _matrix(eight: Array) -> Array:
    return np.append(eight, 1.0).reshape(3, 3)


def _homography(px: Array, mm: Array) -> Array:
    """3×3, mm on the target to pixels, lens distortion neglected."""
    return np.asarray(cv2.findHomography(mm, px, cv2.RANSAC, 5.0)[0], float)


def _drawn(mm: Array, homography: Array, coefficients: Array, camera: Array) -> Array:
    """Where points of the target (n, 2) are drawn in the image, through the lens."""
    x, y, w = homography @ np.stack([mm[:, 0], mm[:, 1], np.ones(len(mm))])
    focal, middle = camera[0, 0], camera[:2, 2]
    rays = np.stack([(x / w - middle[0]) / focal, (y / w - middle[1]) / focal, np.ones(len(mm))], axis=1)
    still = np.zeros(3)
    return np.asarray(cv2.projectPoints(rays, still, still, camera, coefficients)[0], float)[:, 0]


def _geometry(to_mm: Array, distortion: Distortion, size: tuple[int, int]) -> Geometry:
    """The map with the view angle and axis that it implies in the middle of the frame."""
    bare = Geometry(homography=tuple(map(tuple, to_mm.tolist())))
    middle = np.array([(size[0] - 1) / 2]), np.array([(size[1] - 1) / 2])
    jacobian = Surface(bare, distortion).jacobian(*middle)[:, :, 0]
    _, (long, short), axes = np.linalg.svd(jacobian)
    angle = float(np.degrees(np.arccos(np.clip(short / long, 0, 1))))
    seen_along_x = abs(axes[0, 0]) > abs(axes[0, 1])
    return Geometry(homography=bare.homography, view_angle_deg=angle, view_axis="x" if seen_along_x else "y")
