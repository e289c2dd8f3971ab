"""Frames that are not linear in light (JPEG, video): the response curve of a session that asks for one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bssrdf.calib.response import Response, fit_response
from bssrdf.errors import InputError
from bssrdf.session.frame_files import read_frame_file
from bssrdf.session.records import Frame, Session


def session_response(session: Session, frames: Sequence[Frame]) -> Response | None:
    """The response curve that the brackets of the session show, None unless its [camera] asks for one."""
    if session.camera.response is None:
        return None
    kind = "sample" if any(frame.kind == "sample" for frame in frames) else "reference"
    bracket = {frame.exposure_s: frame for frame in frames if frame.kind == kind}
    labels = sorted(bracket)
    images = []
    for label in labels:
        path = session.path / bracket[label].file
        images.append(read_frame_file(path, encoded=True).data)
        if images[-1].dtype != np.uint8 or images[-1].shape != images[0].shape:
            raise InputError(f"{path}: is no 8-bit image of the first one's size; take response out of [camera]")
    return fit_response(images, labels)
