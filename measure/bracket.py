"""The frames of one kind in a session, with their darks, ready to be merged."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import Response, fit_response, master_dark
from bssrdf.errors import InputError
from bssrdf.measure.hdr import DarkPaired, Shot
from bssrdf.session import CONSTANT_KINDS, RawFrame, by_place, dark_for, filled, read_frame_file
from bssrdf.session.records import Camera, Frame, FrameKind, Session

Corrections = Mapping[tuple[str, float], Callable[[DarkPaired], DarkPaired]]

LABEL_REL_SD, MEASURED_REL_SD = 0.03, 0.0005
"""Errors assumed for a label (EXIF rounds by up to 6.7 %) and for a time that the shutter measured."""


@dataclass(frozen=True)
class Bracket:
    """The frames of one kind, shortest exposure first, and the darks of each."""

    kind: FrameKind
    folder: Path
    frames: tuple[Frame, ...]
    darks: tuple[tuple[Frame, ...], ...]
    response: Response | None = None
    """Of a camera whose files are not linear."""
    bits: int | None = None
    """The finest that a file of the session has: the numbers of all others are brought to it."""

    def read(self, frame: Frame) -> NDArray[Any]:
        """The pixels of a frame or dark, linear in light; its median for those that hold no number."""
        data = self.read_whole(frame).data
        return data if _is_whole(data) else np.where(np.isfinite(data), data, np.nanmedian(data))

    def read_whole(self, frame: Frame) -> RawFrame:
        """The same with what the file says of it; its own line in frames.csv wins."""
        path = self.folder / frame.file
        raw = read_frame_file(path, encoded=self.response is not None)
        raw = replace(raw, card=filled(frame.card, raw.card), data=_numbers(path, raw.data))
        if self.response is not None:
            return replace(raw, data=self.response.linearised(path, raw.data))
        finer = 2 ** (self.bits - raw.card.bits) if self.bits and raw.card.bits else 1
        return raw if finer <= 1 else _scaled(raw, finer)

    def exposures_s(self) -> list[float]:
        """Measured exposure times, nominal where there is none."""
        return [frame.exposure_measured_s or frame.exposure_s for frame in self.frames]

    def exposure_rel_sd(self, frame: Frame, camera: Camera) -> float:
        """Relative error of a frame's exposure: stated, or assumed by where it comes from."""
        assumed = LABEL_REL_SD if frame.exposure_measured_s is None else MEASURED_REL_SD
        return frame.exposure_rel_sd or camera.exposure_rel_sd or assumed

    def shots(self, exposures_s: Sequence[float], corrections: Corrections | None = None) -> list[Shot]:
        """The frames to merge, each standing for the given time, with corrections by kind and label."""
        by_name = corrections or {}
        return [
            Shot(frame.file, seconds, _Loader(self, frame, darks, by_name.get((self.kind, frame.exposure_s))))
            for frame, darks, seconds in zip(self.frames, self.darks, exposures_s, strict=True)
        ]


@dataclass(frozen=True)
class _Loader:
    bracket: Bracket
    frame: Frame
    darks: tuple[Frame, ...]
    correction: Callable[[DarkPaired], DarkPaired] | None

    def __call__(self) -> DarkPaired:
        raw = self.bracket.read_whole(self.frame)
        darks = [self.bracket.read_whole(dark) for dark in self.darks]
        for dark, frame in zip(darks, self.darks, strict=True):
            if dark.data.shape != raw.data.shape:
                path = self.bracket.folder / frame.file
                raise InputError(f"{path}: has {_size(dark.data)}, not the {_size(raw.data)} of {self.frame.file}")
        sample = _matched(raw.data, master_dark([_at_black_of(raw, dark) for dark in darks]), len(darks))
        return self.correction(sample) if self.correction else sample


def bracket_of(kind: FrameKind, folder: Path, frames: Sequence[Frame], response: Response | None = None) -> Bracket:
    """The frames of `kind` in `frames`, none if there is none; InputError where one has no dark."""
    chosen = sorted((f for f in frames if f.kind == kind), key=lambda f: (f.exposure_s, f.file))
    darks = tuple(tuple(sorted(dark_for(f, frames), key=lambda d: d.file)) for f in chosen)
    bits = max((f.card.bits for f in frames if f.card.bits and f.kind in CONSTANT_KINDS), default=None)
    return Bracket(kind, folder, tuple(chosen), darks, response, bits)


def _is_whole(data: NDArray[Any]) -> bool:
    """Whether each pixel holds a number."""
    return data.dtype.kind != "f" or bool(np.isfinite(data).all())


def _numbers(path: Path, data: NDArray[Any]) -> NDArray[Any]:
    """The pixels, NaN where there is no number; infinity stays, as what overflows. InputError where none is finite."""
    if _is_whole(data):
        return data
    if not np.isfinite(data).any():
        raise InputError(f"{path}: holds no number that single precision can; write it again, or leave it out")
    return np.where(np.isneginf(data), data.dtype.type(np.nan), data)


def _matched(raw: NDArray[Any], dark: NDArray[Any], n_darks: int) -> DarkPaired:
    """Frame and dark: where the dark holds no number, the frame's is of no use either."""
    if not _is_whole(dark):
        missing = ~np.isfinite(dark)
        raw, dark = np.where(missing, np.float32(np.nan), raw), np.where(missing, np.nanmedian(dark), dark)
    return DarkPaired(raw, dark, n_darks)


def _scaled(raw: RawFrame, factor: int) -> RawFrame:
    """The frame in steps that many times as fine."""
    card = raw.card
    black, white, masked = (
        None if levels is None else tuple(factor * level for level in levels)
        for levels in (card.black, card.white, raw.masked_dn)
    )
    card = replace(card, black=black, white=white)
    dtype = np.uint16 if raw.data.dtype.kind == "u" else np.float32
    return replace(raw, data=np.multiply(raw.data, factor, dtype=dtype), card=card, masked_dn=masked)


def _at_black_of(frame: RawFrame, dark: RawFrame) -> NDArray[Any]:
    """The pixels of a dark, moved by how far the black of its frame lies from its own.

    What pixels under a mask read tells that, else the black levels that the files state.
    """
    masked = frame.masked_dn is not None and dark.masked_dn is not None
    ours, its = (each.masked_dn if masked else each.card.black for each in (frame, dark))
    if ours is None or its is None or ours == its:
        return dark.data
    shift = np.asarray(by_place(ours), np.float32) - np.asarray(by_place(its), np.float32)
    if shift.ndim == 2:
        height, width = dark.data.shape
        shift = np.tile(shift, (-(-height // 2), -(-width // 2)))[:height, :width]
    return np.asarray(dark.data + shift, np.float32)


def layout_of(bracket: Bracket, camera: Camera) -> str:
    """The layout of the bracket's frames, as [camera] or else their files tell; InputError where they differ."""
    told = {f.card.layout: f for f in reversed(bracket.frames) if f.card.layout}
    if camera.layout is None and len(told) > 1:
        (one, first), (two, other) = sorted(told.items(), key=lambda item: item[1].file)[:2]
        raise InputError(
            f"{bracket.folder / other.file}: has the layout {two}, not {one} as {first.file}; "
            "take a bracket with the camera in one position"
        )
    layout = camera.layout or next(iter(told), None)
    return layout or str(camera_of(bracket, camera).layout)


def camera_of(bracket: Bracket, camera: Camera) -> Camera:
    """`[camera]` completed by what the first frame's own file says; InputError where the layout stays unknown."""
    path = bracket.folder / bracket.frames[0].file
    raw = bracket.read_whole(bracket.frames[0])
    layout = camera.layout or raw.layout
    if layout is None:
        raise InputError(f'{path}: does not tell its layout; set layout = "RGGB", "mono" or … in [camera]')
    if (raw.data.ndim == 3) != (layout == "rgb"):
        raise InputError(f'{path}: has {_size(raw.data)}, which does not go with layout = "{layout}" in [camera]')
    white = camera.white if camera.white is not None else raw.white
    return replace(
        camera,
        layout=layout,
        black=camera.black if camera.black is not None else _mean_black(raw),
        white=bracket.response.saturation if bracket.response else white,
    )


def _mean_black(raw: RawFrame) -> float | None:
    return None if raw.black is None else float(np.mean(raw.black))


def _size(data: np.ndarray) -> str:
    return " x ".join(str(n) for n in (data.shape[1], data.shape[0], *data.shape[2:])) + " values"


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
            raise InputError(f"{path}: is not an 8-bit image of the first one's size; take response out of [camera]")
    return fit_response(images, labels)
