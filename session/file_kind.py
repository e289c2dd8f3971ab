"""What a file is by its first bytes, whatever its name says; and the files that are not pictures."""

from __future__ import annotations

from pathlib import Path

from bssrdf.errors import InputError

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
    b"#?RGBE": ".hdr",
    **dict.fromkeys((b"P2", b"P3", b"P5", b"P6", b"Pf", b"PF"), ".pnm"),
    b"SIMPLE  =": ".fits",
    b"\x93NUMPY": ".npy",
}
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_MAKERS = {"NIKON": ".nef", "SONY": ".arw", "PENTAX": ".pef"}
"""Whose RAW is a TIFF file, told by the maker's name in it."""
_DNG_VERSION, _MAKE = 50706, 271
_FAMILIES = (
    (".png",),
    (".jpg", ".jpeg"),
    (".exr",),
    (".hdr",),
    (".pnm", ".pgm", ".ppm", ".pfm"),
    (".fits", ".fit", ".fts"),
    (".npy",),
)
"""Suffixes that stand for one format; all others may be RAW or TIFF, which are told apart by their readers."""
_NO_PICTURES = {
    b"version https://git-lfs": "is a Git LFS pointer, not the file itself; fetch it by `git lfs pull`",
    b"<!DOCTYPE": "is a web page; download the file itself",
    b"<html": "is a web page; download the file itself",
    b"PK\x03\x04": "is a zip archive; unpack it",
    **dict.fromkeys((b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf", b"Rar!"), "is a packed archive; unpack it"),
    b"\0" * 64: "begins with zeros: it was not written to its end; copy or take the file again",
}


def kind_of(file: Path) -> str:
    """The suffix that a file of this content has, or nothing."""
    head = _head(file)
    if head[4:12] == b"ftypcrx ":
        return ".cr3"
    if head.startswith(_TIFF):
        return ".cr2" if head[8:10] == b"CR" else _tiff_kind(file)
    return next((suffix for start, suffix in _BEGINNINGS.items() if head.startswith(start)), "")


def check_content(path: Path) -> None:
    """InputError where the file cannot be opened, is empty, no picture, or one of another format than its name says."""
    head = _head(path)
    if not head:
        raise InputError(f"{path}: is empty; copy or take the file again")
    for start, what in _NO_PICTURES.items():
        if head.startswith(start):
            raise InputError(f"{path}: {what}")
    suffix, found = path.suffix.lower(), next((s for start, s in _BEGINNINGS.items() if head.startswith(start)), "")
    found = ".tif" if head.startswith(_TIFF) else found
    if found and _family(found) != _family(suffix):
        raise InputError(f"{path}: is a {found} file by its content, named {suffix}; name it {path.stem}{found}")


def _family(suffix: str) -> tuple[str, ...]:
    return next((family for family in _FAMILIES if suffix in family), ())


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(64)
    except FileNotFoundError as error:
        raise InputError(f"{path}: is not there; check the path") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error


def _tiff_kind(file: Path) -> str:
    import tifffile

    try:
        with tifffile.TiffFile(file) as tiff:
            tags = tiff.pages.first.tags
            maker = str(tags[_MAKE].value).upper() if _MAKE in tags else ""
            named = next((suffix for name, suffix in _MAKERS.items() if maker.startswith(name)), ".tif")
            return ".dng" if _DNG_VERSION in tags else named
    except Exception:  # a damaged file: reading it as a TIFF will say how
        return ".tif"
