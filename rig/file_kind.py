"""Which of the files that a camera's program has left is the frame, and of what kind where its name does not say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bssrdf.errors import DeviceError
from bssrdf.session.file_kind import kind_of
from bssrdf.session.frame_files import ENCODED_SUFFIXES, IMAGE_SUFFIXES
from bssrdf.session.raw_file import RAW_SUFFIXES


def frame_among(whose: str, files: Sequence[Path]) -> tuple[Path, str]:
    """The frame and its suffix: the one RAW file, else the one image; DeviceError where there is none or no telling."""
    kinds = {file: file.suffix.lower() or kind_of(file) for file in files if not file.name.startswith(".")}
    for wanted in (RAW_SUFFIXES, IMAGE_SUFFIXES, ENCODED_SUFFIXES):
        fitting = [file for file, suffix in kinds.items() if suffix in wanted]
        if len(fitting) > 1:
            names = ", ".join(file.name for file in fitting)
            raise DeviceError(f"{whose} left {names}; one frame is wanted")
        if fitting:
            return fitting[0], kinds[fitting[0]]
    others = ", ".join(file.name for file in files)
    left = f"left {others}, no kind of frame" if others else "left no file at {out}"
    raise DeviceError(f"{whose} {left}; have it write RAW, TIFF or EXR there")
