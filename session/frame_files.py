"""The one door for images: which reader a frame's file needs. Safe in several threads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.file_kind import check_content
from bssrdf.session.raw_file import RAW_SUFFIXES, read_raw
from bssrdf.session.raw_frame import RawFrame, without_alpha

_TIFF, _PNM, _FITS = (".tif", ".tiff", ".btf", ".ome"), (".pgm", ".ppm", ".pnm", ".pfm"), (".fits", ".fit", ".fts")
_FLOAT = (".exr", ".hdr")
_JPEG = (".jpg", ".jpeg")
IMAGE_SUFFIXES = (*_TIFF, *_PNM, *_FITS, *_FLOAT, ".npy", ".png")
ENCODED_SUFFIXES = (*_JPEG, ".png")
"""Of 8-bit files whose values a camera has bent to please the eye."""


def is_frame_name(path: Path, *, encoded: bool = False) -> bool:
    """Whether a file's name is that of an image: hidden files and the sidecars of a Mac are none."""
    suffixes = (*RAW_SUFFIXES, *IMAGE_SUFFIXES, *(ENCODED_SUFFIXES if encoded else ()))
    return path.suffix.lower() in suffixes and not path.name.startswith(".")


def read_frame_file(path: Path, *, encoded: bool = False) -> RawFrame:
    """Read one frame; InputError where the file is missing, damaged or of a kind that cannot be measured from.

    With `encoded` an 8-bit file may be one of those whose values are not linear; else they are refused.
    """
    frames = read_frames_of(path, encoded=encoded)
    frame = next(frames)
    if next(frames, None) is not None:
        raise InputError(f"{path}: holds several pictures; a stack is a bracket: have `bssrdf ingest` take it apart")
    return frame


def read_frames_of(path: Path, *, encoded: bool = False) -> Iterator[RawFrame]:
    """Every frame of a file, one by one: one, or those of a stack."""
    return map(_with_exposure, _read(path, encoded=encoded, pixels=True))


def read_card(path: Path, *, encoded: bool = False) -> RawFrame:
    """What the file says of its frame, without its pixels where a header tells; InputError as when it is read."""
    return _with_exposure(next(iter(_read(path, encoded=encoded, pixels=False))))


def _with_exposure(frame: RawFrame) -> RawFrame:
    return replace(frame, card=replace(frame.card, file_exposure_s=frame.exposure_s))


def read_linear_image(path: Path) -> NDArray[np.float32]:
    """A merged image from elsewhere, float32 of shape (h, w), or (h, w, 3) as RGB; NaN where the file has no data."""
    data = read_frame_file(path).data
    if data.dtype != np.float32:
        raise InputError(f"{path}: holds {data.dtype} pixels; save the merged image as linear float")
    return data


def _read(path: Path, *, encoded: bool, pixels: bool) -> Iterable[RawFrame]:
    from bssrdf.session.portable_files import read_fits, read_npy, read_pnm

    suffix = path.suffix.lower()
    if suffix not in (*RAW_SUFFIXES, *IMAGE_SUFFIXES, *ENCODED_SUFFIXES):
        raise InputError(
            f"{path}: {suffix or 'no suffix'} is not a kind of frame; use RAW, TIFF, PNG, PNM, FITS, NPY or EXR"
        )
    check_content(path)
    if suffix in RAW_SUFFIXES:
        return [read_raw(path, pixels=pixels)]
    if suffix in _TIFF:
        from bssrdf.session.tiff_file import read_tiff

        return read_tiff(path, pixels=pixels)
    if suffix in ENCODED_SUFFIXES and (encoded or suffix in _JPEG):
        return [_read_encoded(path, encoded)]
    if suffix == ".png":
        from bssrdf.session.png_file import read_png

        return read_png(path)
    if suffix in _FLOAT:
        from bssrdf.session.hdr_image import read_parts

        return [read_parts(path)]
    readers = {**dict.fromkeys(_PNM, read_pnm), **dict.fromkeys(_FITS, read_fits), ".npy": read_npy}
    return readers[suffix](path)


def _read_encoded(path: Path, encoded: bool) -> RawFrame:
    """A frame for the fit of a response curve."""
    from bssrdf.session.oiio_file import read_image
    from bssrdf.session.raw_frame import card_of_attributes, exposure_of_tags

    if not encoded:
        raise InputError(
            f"{path}: is not linear in light; take RAW or TIFF, or have the response curve fitted: "
            '`bssrdf ingest --response`, or response = "debevec" in [camera]'
        )
    image = read_image(path)
    data = without_alpha(path, image.data) if image.data.shape[2] in (2, 4) else image.data
    data = data[:, :, 0] if data.shape[2] == 1 else data
    if data.ndim == 3 and data.shape[2] != 3:
        raise InputError(f"{path}: has {data.shape[2]} channels; save one (mosaic or mono) or three (RGB)")
    card = replace(card_of_attributes(data, image.attributes), bits=8 * data.dtype.itemsize)
    return RawFrame(data, card, exposure_of_tags(image.attributes))
