"""`bssrdf calibrate camera` and `calibrate spot`: what frames tell of the camera that took them, and of the beam."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bssrdf.calib import Surface, knife_edge_radius
from bssrdf.errors import InputError
from bssrdf.measure.bracket import bracket_of, camera_of, session_response
from bssrdf.measure.hdr import Hdr, Progress
from bssrdf.measure.image import Image, spot_radius_mm
from bssrdf.measure.learn import learn_camera
from bssrdf.measure.pixels import channel_names, mosaic_period
from bssrdf.session import check_constant, read_frame_file, read_frames, with_cards
from bssrdf.session.records import Array, Beam, Camera, FrameKind, Geometry, Session
from bssrdf.session.text_file import parse_csv, read_text

_KINDS: tuple[FrameKind, ...] = ("sample", "reference", "flat")

_COLUMNS = ("position_mm", "light")
_NEAR_SATURATION = 0.98


@dataclass(frozen=True)
class CameraCalibration:
    """A complete `[camera]` table, and how good it is."""

    camera: Camera
    """`white` is the saturation that the frames show."""
    gain_rel_sd: float
    nonlinearity: float
    """Largest relative bend of the response between two exposures."""
    exposure_ratio: dict[float, float]
    """True over nominal exposure time by label [s]."""
    exposure_rel_sd: dict[float, float]
    n_hot: int
    flags: tuple[str, ...]


def calibrate_camera(session: Session, *, progress: Progress | None = None) -> CameraCalibration:
    """Gain, read noise, saturation, linearity and exposure times from the brackets of a session and their darks."""
    frames = with_cards(session.path, read_frames(session.path), encoded=session.camera.response is not None)
    check_constant(frames, session.path)
    response = session_response(session, frames)
    every = (bracket_of(kind, session.path, frames, response) for kind in _KINDS)
    brackets = [bracket for bracket in every if bracket.frames]
    if not brackets:
        raise InputError(f"{session.path / 'frames.csv'}: lists no frame of kind {', '.join(_KINDS)}; add some")
    camera = camera_of(brackets[0], session.camera)
    learnt = learn_camera(brackets, camera, mosaic_period(camera.layout or "mono"), progress)
    sensor = learnt.sensor
    return CameraCalibration(
        replace(
            camera,
            black=sensor.black_dn,
            white=sensor.saturation_dn,
            gain_e_per_dn=sensor.gain_e_per_dn,
            read_noise_e=sensor.read_noise_e,
        ),
        learnt.gain_rel_sd,
        learnt.nonlinearity,
        {label: learnt.exposures.factor(kind, label) for kind, label in learnt.exposures.frames},
        {label: sd for (_, label), sd in zip(learnt.exposures.frames, learnt.exposures.rel_sd.tolist(), strict=True)},
        int(learnt.hot.sum()),
        learnt.flags,
    )


def radius_of_edge(path: Path) -> float:
    """1/e² radius [mm] from a CSV table of `position_mm` of the edge and the `light` that passes it."""
    table = parse_csv(path, read_text(path), _COLUMNS, _COLUMNS)
    try:
        values = {name: np.array([float(row[i]) for row in table.rows]) for i, name in enumerate(table.header)}
    except ValueError as error:
        raise InputError(f"{path}: contains a value that is not a number ({error}); write plain numbers") from error
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
    spot = image.spot
    return float(np.sqrt(max(spot_radius_mm(image, spot) ** 2 - _pixel_blur(image, spot.x_px, spot.y_px), 0.0)))


def _pixel_blur(image: Image, x_px: float, y_px: float) -> float:
    """What the width of a pixel across the view adds to the square of a 1/e² radius [mm²]."""
    widths: Array = np.hypot(*image.surface.jacobian(np.array([x_px]), np.array([y_px])))[:, 0]
    return float(widths[0 if image.surface.geometry.view_axis == "y" else 1] ** 2 / 3)
