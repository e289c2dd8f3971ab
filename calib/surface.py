"""From pixels to mm in the surface of the sample. Pixel (x, y) is the centre of column x, row y; lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.records import Distortion, Geometry

Array = NDArray[np.float64]

_UNDISTORT_PASSES = 12


@dataclass(frozen=True)
class Surface:
    """The map from the image to the surface, by scale and view angle or by homography and lens distortion."""

    geometry: Geometry
    distortion: Distortion | None = None

    def __post_init__(self) -> None:
        if self.geometry.mm_per_px is None and self.geometry.homography is None:
            raise InputError(
                "session.toml: [geometry] has neither mm_per_px nor homography; "
                "measure one with `bssrdf calibrate geometry`"
            )

    def to_mm(self, x_px: Array, y_px: Array) -> tuple[Array, Array]:
        """Point of the surface [mm] that an image point sees; arrays of equal shape."""
        if self.distortion is not None:
            x_px, y_px = undistort(self.distortion, x_px, y_px)
        if self.geometry.homography is None:
            scale_x, scale_y = self._scales()
            return x_px * scale_x, y_px * scale_y
        h = np.asarray(self.geometry.homography)
        w = h[2, 0] * x_px + h[2, 1] * y_px + h[2, 2]
        return (h[0, 0] * x_px + h[0, 1] * y_px + h[0, 2]) / w, (h[1, 0] * x_px + h[1, 1] * y_px + h[1, 2]) / w

    def _scales(self) -> tuple[float, float]:
        across = float(self.geometry.mm_per_px or 0.0)
        along = across / np.cos(np.radians(self.geometry.view_angle_deg))
        return (across, along) if self.geometry.view_axis == "y" else (along, across)

    def jacobian(self, x_px: Array, y_px: Array) -> Array:
        """∂(mm)/∂(px) [mm] at image points of shape (n,): an array (2, 2, n)."""
        along_x = np.subtract(self.to_mm(x_px + 0.5, y_px), self.to_mm(x_px - 0.5, y_px))
        along_y = np.subtract(self.to_mm(x_px, y_px + 0.5), self.to_mm(x_px, y_px - 0.5))
        return np.stack([along_x, along_y], axis=1)

    def pixel_area_mm2(self, x_px: Array, y_px: Array) -> Array:
        """Area of the surface that a pixel sees: mm_per_px²/cos(view angle), or |det J| of the map."""
        (a, b), (c, d) = self.jacobian(x_px, y_px)
        return np.abs(a * d - b * c)

    def centred(self, x_px: Array, y_px: Array, centre_px: tuple[float, float]) -> tuple[Array, Array]:
        """(across, along) [mm] from the point seen at `centre_px`: perpendicular to the view, and along it."""
        x_mm, y_mm = self.to_mm(x_px, y_px)
        x_0, y_0 = self.to_mm(*(np.array([c], float) for c in centre_px))
        view_column = 1 if self.geometry.view_axis == "y" else 0
        view = self.jacobian(*(np.array([c], float) for c in centre_px))[:, view_column, 0]
        view /= np.hypot(*view)
        across = (x_mm - x_0) * view[1] - (y_mm - y_0) * view[0]
        along = (x_mm - x_0) * view[0] + (y_mm - y_0) * view[1]
        return across, along


def undistort(distortion: Distortion, x_px: Array, y_px: Array) -> tuple[Array, Array]:
    """Where a lens without distortion would have drawn these image points."""
    import cv2

    camera = np.asarray(distortion.camera_matrix, float)
    focal, middle = np.diag(camera)[:2], camera[:2, 2]
    drawn = np.stack([np.ravel(x_px), np.ravel(y_px)], axis=-1).astype(float)
    still = np.zeros(3)
    straight = drawn.copy()
    for _ in range(_UNDISTORT_PASSES):
        rays = np.concatenate([(straight - middle) / focal, np.ones((len(straight), 1))], axis=1)
        bent = cv2.projectPoints(rays, still, still, camera, np.asarray(distortion.coefficients))[0][:, 0]
        straight += drawn - bent
    return straight[:, 0].reshape(np.shape(x_px)), straight[:, 1].reshape(np.shape(y_px))
