"""Is a session complete and unchanged: everything that measuring it would stumble over, found at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from bssrdf.errors import BssrdfError
from bssrdf.session.atomic import sha256_of
from bssrdf.session.constancy import differences, exposure_faults, with_cards
from bssrdf.session.frame_files import read_card
from bssrdf.session.frames_csv import dark_for, read_frames
from bssrdf.session.progress import Progress, counted
from bssrdf.session.records import Frame
from bssrdf.session.session_toml import UNNAMED, read_session

_LIGHT = ("sample", "reference", "flat")


class Verified(NamedTuple):
    """What was looked at, and one line for each fault."""

    frames: list[Frame]
    faults: list[str]


def verify_session(path: Path, *, progress: Progress | None = None) -> Verified:
    """Look at the tables of session.toml, and at each frame of frames.csv: there, unchanged, with a dark.

    The camera must have been set as for the other frames.
    Frames are read from disk and compared with the checksum in frames.csv where it has one. Raises InputError where
    frames.csv itself cannot be read.
    """
    frames = read_frames(path, must_exist=False)
    cards = with_cards(path, frames)
    faults = [f"{path / str(fault)}" for fault in (*differences(cards), *exposure_faults(cards))]
    return Verified(frames, [*_table_faults(path, cards), *_frame_faults(path, frames, progress), *faults])


def _table_faults(path: Path, frames: Sequence[Frame]) -> Iterator[str]:
    try:
        session = read_session(path, complete=True)
        if session.material and session.material.name == UNNAMED:
            yield f'{path / "session.toml"}: [material] name is still "{UNNAMED}"; put in what was measured'
        silent = [frame for frame in frames if frame.kind in _LIGHT and frame.card.width_px and not frame.card.layout]
        if silent and session.camera.layout is None:
            yield f'{path / silent[0].file}: does not tell its layout; set layout = "RGGB", "mono" or … in [camera]'
    except BssrdfError as error:
        yield f"{error} (without them only `measure --hdr-only` works)"
    for kind in ("sample", "reference"):
        if not any(frame.kind in (kind, f"{kind}_hdr") for frame in frames):
            yield f"{path / 'frames.csv'}: lists no {kind}; add it (without it only `measure --hdr-only` works)"


def _frame_faults(path: Path, frames: Sequence[Frame], progress: Progress | None) -> Iterator[str]:
    for frame in counted(frames, "verify", progress):
        file = path / frame.file
        if not file.is_file():
            yield f"{file}: is not there; put it back or take its line out of frames.csv"
        elif frame.sha256 and sha256_of(file) != frame.sha256:
            yield f"{file}: has changed since it was listed (its sha256 differs); restore it or take it again"
        elif not frame.card.width_px:
            yield from _unreadable(file)
        if frame.kind in _LIGHT:
            try:
                dark_for(frame, frames)
            except BssrdfError as error:
                yield f"{path / 'frames.csv'}: {error}"


def _unreadable(file: Path) -> Iterator[str]:
    """What is wrong with a file that nobody has looked into yet."""
    try:
        read_card(file, encoded=True)
    except BssrdfError as error:
        yield str(error)
