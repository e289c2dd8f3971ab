"""`bssrdf calibrate spot`: the beam's radius from a knife edge, or from its spot on a thin opaque target."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bssrdf.calib.spot_radius import knife_edge_radius
from bssrdf.calib.surface import Surface
from bssrdf.errors import InputError
from bssrdf.measure.image import Image, locate, spot_radius_mm
from bssrdf.measure.merge import Hdr
from bssrdf.measure.pixels import channel_names
from bssrdf.session.checks import read_text
from bssrdf.session.frame_files import read_frame_file
from bssrdf.session.records import Array, Beam, Geometry
from bssrdf.session.text_file import parse_csv

_COLUMNS = ("position_mm", "light")
_NEAR_SATURATION = 0.98


def radius_of_edge(path: Path) -> float:
    """1/e² radius [mm] from a CSV table of `position_mm` of the edge and the `light` that passes it."""
    table = parse_csv(path, read_text(path), _COLUMNS, _COLUMNS)
    try:
        values = {name: np.array([float(row[i]) for row in table.rows]) for i, name in enumerate(table.header)}
    except ValueError as error:
        raise InputError(f"{path}: holds what is no number ({error}); write plain numbers") from error
    try:
        return knife_edge_radius(*(values[name] for name in _COLUMNS))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def radius_on_target(path: Path, geometry: Geometry, layout: str | None = None) -> float:
    """1/e² radius [mm] across the view from one linear frame of the spot on a target that spreads no light.

    `layout` where the file does not tell its own. InputError where the spot saturates or is not found.
    """
    frame = read_frame_file(path)
    layout = layout or frame.layout or "mono"
    white = frame.white or (np.iinfo(frame.data.dtype).max if frame.data.dtype.kind == "u" else np.inf)
    if frame.data.max() >= _NEAR_SATURATION * white:
        raise InputError(f"{path}: is saturated in the spot; take it with a shorter exposure")
    light = (frame.data - np.median(frame.data)).astype(np.float32)
    nothing = np.zeros(light.shape, np.uint8)
    channels = channel_names(layout, Beam())
    image = Image(str(path), Hdr(light, np.ones_like(light), nothing, nothing), layout, channels, Surface(geometry))
    spot = locate(image)
    return float(np.sqrt(max(spot_radius_mm(image, spot) ** 2 - _pixel_blur(image, spot.x_px, spot.y_px), 0.0)))


def _pixel_blur(image: Image, x_px: float, y_px: float) -> float:
    """What the width of a pixel across the view adds to the square of a 1/e² radius [mm²]."""
    widths: Array = np.hypot(*image.surface.jacobian(np.array([x_px]), np.array([y_px])))[:, 0]
    return float(widths[0 if image.surface.geometry.view_axis == "y" else 1] ** 2 / 3)
