"""The frames of one kind in a session, with their darks, ready to be merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.response import Response
from bssrdf.calib.sensor import master_dark
from bssrdf.errors import InputError
from bssrdf.measure.merge import Sample, Shot
from bssrdf.session.frame_files import read_frame_file
from bssrdf.session.frames_csv import dark_for
from bssrdf.session.raw_frame import RawFrame
from bssrdf.session.records import Camera, Frame, FrameKind


@dataclass(frozen=True)
class Bracket:
    """The frames of one kind, shortest exposure first, and the darks of each."""

    kind: FrameKind
    folder: Path
    frames: tuple[Frame, ...]
    darks: tuple[tuple[Frame, ...], ...]
    response: Response | None = None
    """Of a camera whose files are not linear."""

    def read(self, frame: Frame) -> NDArray[Any]:
        """The pixels of a frame or dark, linear in light."""
        path = self.folder / frame.file
        if self.response is None:
            return read_frame_file(path).data
        return self.response.linearised(path, read_frame_file(path, encoded=True).data)

    def exposures_s(self) -> list[float]:
        """Measured exposure times, nominal where there is none."""
        return [frame.exposure_measured_s or frame.exposure_s for frame in self.frames]

    def shots(self, exposures_s: Sequence[float]) -> list[Shot]:
        """The frames to merge, each standing for the given time."""
        return [
            Shot(frame.file, seconds, _Loader(self, frame, darks))
            for frame, darks, seconds in zip(self.frames, self.darks, exposures_s, strict=True)
        ]


@dataclass(frozen=True)
class _Loader:
    bracket: Bracket
    frame: Frame
    darks: tuple[Frame, ...]

    def __call__(self) -> Sample:
        raw = self.bracket.read(self.frame)
        darks = [self.bracket.read(dark) for dark in self.darks]
        for dark, frame in zip(darks, self.darks, strict=True):
            if dark.shape != raw.shape:
                path = self.bracket.folder / frame.file
                raise InputError(f"{path}: has {_size(dark)}, not the {_size(raw)} of {self.frame.file}")
        return Sample(raw, master_dark(darks), len(darks))


def bracket_of(kind: FrameKind, folder: Path, frames: Sequence[Frame], response: Response | None = None) -> Bracket:
    """The frames of `kind` in `frames`, none if there is none; InputError where one has no dark."""
    chosen = sorted((f for f in frames if f.kind == kind), key=lambda f: (f.exposure_s, f.file))
    darks = tuple(tuple(sorted(dark_for(f, frames), key=lambda d: d.file)) for f in chosen)
    return Bracket(kind, folder, tuple(chosen), darks, response)


def camera_of(bracket: Bracket, camera: Camera) -> Camera:
    """`[camera]` completed by what the first frame's own file says; InputError where the layout stays unknown."""
    path = bracket.folder / bracket.frames[0].file
    raw = read_frame_file(path, encoded=bracket.response is not None)
    layout = camera.layout or raw.layout
    if layout is None:
        raise InputError(f'{path}: does not tell its layout; set layout = "RGGB", "mono" or … in [camera]')
    if (raw.data.ndim == 3) != (layout == "rgb"):
        raise InputError(f'{path}: has {_size(raw.data)}, which does not go with layout = "{layout}" in [camera]')
    return Camera(
        layout,
        camera.black if camera.black is not None else _mean_black(raw),
        bracket.response.saturation if bracket.response else camera.white if camera.white is not None else _white(raw),
        camera.gain_e_per_dn,
        camera.read_noise_e,
    )


def _mean_black(raw: RawFrame) -> float | None:
    return None if raw.black is None else float(np.mean(raw.black))


def _white(raw: RawFrame) -> float:
    """The file's own white level, else the largest number its pixels can hold."""
    if raw.white is not None:
        return raw.white
    return float(np.iinfo(raw.data.dtype).max) if np.issubdtype(raw.data.dtype, np.integer) else np.inf


def _size(data: np.ndarray) -> str:
    return " x ".join(str(n) for n in (data.shape[1], data.shape[0], *data.shape[2:])) + " values"
