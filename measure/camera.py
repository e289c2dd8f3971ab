"""`bssrdf calibrate camera`: what the frames of a session tell of the camera that took them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from bssrdf.errors import InputError
from bssrdf.measure.bracket import bracket_of, camera_of
from bssrdf.measure.encoded import session_response
from bssrdf.measure.learn import learn_camera
from bssrdf.measure.merge import Progress
from bssrdf.measure.pixels import mosaic_period
from bssrdf.session.constancy import check_constant, with_cards
from bssrdf.session.frames_csv import read_frames
from bssrdf.session.records import Camera, FrameKind, Session

_KINDS: tuple[FrameKind, ...] = ("sample", "reference", "flat")


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
