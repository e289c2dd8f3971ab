"""Which of the files that a camera's program has left is the frame, and of what kind where its name does not say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bssrdf.errors import DeviceError
from bssrdf.session.frame_files import ENCODED_SUFFIXES, IMAGE_SUFFIXES
from bssrdf.session.raw_file import RAW_SUFFIXES

_BEGINNINGS = {
    b"IIU\0": ".rw2",
    b"IIRO": ".orf",
    b"IIRS": ".orf",
    b"MMOR": ".orf",
    b"FUJIFILM": ".raf",
    b"\x89PNG": ".png",
    b"\xff\xd8\xff": ".jpg",
    b"v/1\x01": ".exr",
    b"#?RADIANCE": ".hdr",
    b"P5": ".pgm",
    b"SIMPLE  =": ".fits",
    b"\x93NUMPY": ".npy",
}
_TIFF = (b"II*\0", b"MM\0*")
_MAKERS = {"NIKON": ".nef", "SONY": ".arw", "PENTAX": ".pef"}
"""Whose RAW is a TIFF file, told by the maker's name in it."""
_DNG_VERSION, _MAKE = 50706, 271


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


def kind_of(file: Path) -> str:
    """The suffix that a file of this content has, or nothing."""
    with file.open("rb") as stream:
        head = stream.read(16)
    if head[4:12] == b"ftypcrx ":
        return ".cr3"
    if head.startswith(_TIFF):
        return ".cr2" if head[8:10] == b"CR" else _tiff_kind(file)
    return next((suffix for start, suffix in _BEGINNINGS.items() if head.startswith(start)), "")


def _tiff_kind(file: Path) -> str:
    import tifffile

    try:
        with tifffile.TiffFile(file) as tiff:
            tags = tiff.pages.first.tags
            maker = str(tags[_MAKE].value).upper() if _MAKE in tags else ""
            return (
                ".dng" if _DNG_VERSION in tags else next((s for m, s in _MAKERS.items() if maker.startswith(m)), ".tif")
            )
    except Exception:  # a damaged file: reading it as a TIFF will say how
        return ".tif"
