"""What must stay the same over a session, compared with what the files say of themselves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import log
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from bssrdf.errors import BssrdfError, InputError
from bssrdf.session.frame_files import read_card, read_frame_file
from bssrdf.session.frames_csv import dark_for
from bssrdf.session.raw_frame import filled
from bssrdf.session.records import Card, Frame

CONSTANT_KINDS = ("sample", "reference", "sample_dark", "reference_dark", "dark")
"""What is compared as counts of light."""
_SIZE = "size"
_GROUPS: tuple[tuple[str | None, tuple[str, ...], tuple[str, ...]], ...] = (
    (None, CONSTANT_KINDS, ("camera", "iso", "gain", "f_number", "lens", "focal_mm", "bits", _SIZE)),
    ("flat", ("sample", "reference", "flat"), ("camera", "lens", "f_number", "layout", _SIZE)),
    ("flat", ("flat", "flat_dark"), ("iso", "gain", _SIZE)),
    ("target", ("sample", "reference", "target"), ("lens", "focal_mm", _SIZE)),
)
"""A kind that must be there, kinds of frames, and what must not differ between them. Black, layouts and bits of a
sensor are allowed for: see `measure.bracket`."""
_TOLERANCE = {"focal_mm": 0.01, "f_number": 0.01, "gain": 1e-3, "iso": 1e-6}
"""Relative. A focal length 1 % longer is 1 % in every length; the others are labels and only rounded."""
_NAMES = {
    "iso": "ISO",
    "gain": "gain",
    "f_number": "f-number",
    "focal_mm": "focal length",
    "lens": "lens",
    "camera": "camera",
    "layout": "layout",
    "bits": "bits",
    _SIZE: "size",
}
ROUNDED, _OTHER_EXPOSURE = 0.07, 0.18
"""Logarithms: a label is rounded by 6.7 % at most; 20 % is another exposure."""
_REMEDY = "take them anew with one setting, or leave one out"


class Difference(NamedTuple):
    """Two frames that must agree and do not."""

    first: Frame
    other: Frame
    what: str

    def __str__(self) -> str:
        return f"{self.other.file}: {self.fact}; {_REMEDY}"

    @property
    def fact(self) -> str:
        """What the other frame has, and what the first one."""
        one, two = (_shown(frame.card, self.what) for frame in (self.first, self.other))
        return f"has {_NAMES[self.what]} {two}, not {one} as {self.first.file}"


def check_constant(frames: Sequence[Frame], where: Path) -> None:
    """InputError for the first two frames that differ in what must be constant, or in exposure by their own files."""
    for fault in (*differences(frames), *exposure_faults(frames)):
        raise InputError(f"{where / str(fault)}")


def differences(frames: Sequence[Frame]) -> Iterator[Difference]:
    """One for each frame and property: the frame, and the first one that tells it and that it must agree with."""
    told = set()
    for needed, kinds, properties in _GROUPS:
        members = [frame for frame in frames if frame.kind in kinds]
        if needed and not any(frame.kind == needed for frame in members):
            continue
        for what in properties:
            known = [frame for frame in members if _value(frame.card, what) is not None]
            for frame in known[1:]:
                if (frame.file, what) not in told and not _agree(known[0].card, frame.card, what):
                    told.add((frame.file, what))
                    yield Difference(known[0], frame, what)


def exposure_faults(frames: Sequence[Frame]) -> Iterator[str]:
    """A line for each dark that its file says is of another exposure than its frame, and for each kind of frames whose
    files say, all alike, that frames.csv has other exposures."""
    for kind in ("sample", "reference", "flat"):
        told = [frame for frame in frames if frame.kind == kind and frame.card.file_exposure_s]
        yield from (line for frame in told for line in _dark_faults(frame, frames))
        off = [log(f.card.file_exposure_s / f.exposure_s) for f in told if not f.exposure_measured_s]  # type: ignore[operator]  # told
        labels = {frame.exposure_s for frame in told if not frame.exposure_measured_s}
        if len(labels) > 1 and max(off) - min(off) < ROUNDED and abs(median(off)) > _OTHER_EXPOSURE:
            yield (
                f"{told[0].file}: was exposed for {told[0].card.file_exposure_s:g} s by its own file, not for "
                f"{told[0].exposure_s:g} s as frames.csv says, and so were the other {kind} frames; correct exposure_s"
            )


def _dark_faults(frame: Frame, frames: Sequence[Frame]) -> Iterator[str]:
    try:
        darks = dark_for(frame, frames)
    except InputError:
        return  # who needs it says so
    for dark in darks:
        own, its = frame.card.file_exposure_s, dark.card.file_exposure_s
        if own and its and abs(log(its / own)) > ROUNDED:
            yield (
                f"{dark.file}: was exposed for {its:g} s by its own file, not for {own:g} s as {frame.file}; take "
                "darks of the frames' exposures, or correct exposure_s in frames.csv"
            )


def check_no_copy(frames: Sequence[Frame], hashes: Mapping[str, str], where: Path) -> None:
    """InputError for the first frame that is the very file of another one of another kind or exposure."""
    for message in copies(frames, hashes, where):
        raise InputError(f"{where / message}")


def copies(frames: Sequence[Frame], hashes: Mapping[str, str], where: Path) -> Iterator[str]:
    """A line for each frame that is a copy of one that it cannot be.

    One dark may serve sample and reference, and frames of one value in all pixels are alike without being copies.
    """
    first: dict[str, Frame] = {}
    for frame in frames:
        other = first.setdefault(hashes[frame.file], frame)
        darks = frame.kind.endswith("dark") and other.kind.endswith("dark")
        if frame.exposure_s == other.exposure_s and (frame.kind == other.kind or darks):
            continue
        if np.ptp(read_frame_file(where / frame.file, encoded=True).data) > 0:
            yield (
                f"{frame.file}: is {other.file} once more, byte for byte, but listed as {frame.kind} of "
                f"{frame.exposure_s:g} s and not {other.kind} of {other.exposure_s:g} s; put the right file there"
            )


def with_cards(session_path: Path, frames: Sequence[Frame], *, encoded: bool = False) -> list[Frame]:
    """The frames with the cards of their files where frames.csv has none; its own entries win."""
    return [
        frame
        if frame.card.width_px
        else replace(frame, card=filled(frame.card, card_of_file(session_path / frame.file, encoded=encoded)))
        for frame in frames
    ]


def card_of_file(path: Path, *, encoded: bool = False) -> Card:
    """What a file says of its frame; of one that cannot be read, nothing: who needs its pixels says why."""
    try:
        return read_card(path, encoded=encoded).card
    except BssrdfError:
        return Card()


def _value(card: Card, what: str) -> Any:
    if what == _SIZE:
        return f"{card.width_px} x {card.height_px}" if card.width_px and card.height_px else None
    return getattr(card, what)


def _shown(card: Card, what: str) -> str:
    value = _value(card, what)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _agree(one: Card, two: Card, what: str) -> bool:
    a, b = _value(one, what), _value(two, what)
    if what == "bits" and a != b:
        return all(_is_of_sensor(card) for card in (one, two))
    if what in _TOLERANCE:
        return bool(abs(a - b) <= _TOLERANCE[what] * max(abs(a), abs(b)))
    return bool(a == b)


def _is_of_sensor(card: Card) -> bool:
    """Whether the bits are those of the sensor's numbers, so that they can be brought to others, or a container's."""
    return bool(card.layout and card.white) or card.bits not in (8, 16, 32)
