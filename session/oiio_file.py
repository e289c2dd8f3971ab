"""Image files through OpenImageIO, whose calls return False where they fail: every return is checked here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from bssrdf.errors import InputError

_DTYPES = {"uint8": "uint8", "uint16": "uint16", "half": "float", "float": "float", "double": "float"}


class Image(NamedTuple):
    """One image of a file: values as stored (half and double as float32), shape (h, w, channels)."""

    data: NDArray[Any]
    channel_names: tuple[str, ...]
    name: str
    attributes: dict[str, Any]


def read_images(path: Path) -> list[Image]:
    """Every image of the file; InputError where one cannot be read whole."""
    return _read_most(path, None)


def read_image(path: Path) -> Image:
    """The first image of the file; those after it may be thumbnails."""
    return _read_most(path, 1)[0]


def file_attributes(path: Path) -> dict[str, Any]:
    """What the header of a TIFF, or of a RAW file built as one, says; empty where it cannot be read."""
    try:
        file = oiio.ImageInput.open(str(path))
        if file is None:
            oiio.geterror()  # else it is printed at exit
        return {} if file is None else _attributes(file.spec())
    except UnicodeDecodeError:
        return {}


def _read_most(path: Path, most: int | None) -> list[Image]:
    if not path.is_file():
        raise InputError(f"{path}: is not there; check the path")
    try:
        return _read_open(path, most)
    except UnicodeDecodeError as error:  # from a name, an attribute, or OpenImageIO's own message
        raise _unreadable(path, "") from error


def _read_open(path: Path, most: int | None) -> list[Image]:
    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise _unreadable(path, oiio.geterror())
    try:
        images: list[Image] = []
        while len(images) != most and file.seek_subimage(len(images), 0):
            images.append(_read(path, file))
        if not images:
            raise _unreadable(path, file.geterror())
        return images
    finally:
        file.close()


def _read(path: Path, file: Any) -> Image:
    spec = file.spec()
    dtype = _DTYPES.get(str(spec.format))
    attributes = _attributes(spec)
    bits = attributes.get("oiio:BitsPerSample", 8)
    if dtype is None or bits not in (8, 16, 32, 64):
        raise InputError(
            f"{path}: pixels of {bits}-bit {spec.format} are not read; save 8 or 16 bit unsigned, or float"
        )
    if spec.depth != 1 or spec.deep:
        raise InputError(f"{path}: is a volume or a deep image; save a flat one")
    data = file.read_image(file.current_subimage(), 0, 0, spec.nchannels, dtype)
    if data is None or file.has_error:
        raise _unreadable(path, file.geterror())
    pixels = np.asarray(data).reshape(spec.height, spec.width, spec.nchannels)
    return Image(pixels, tuple(spec.channelnames), attributes.get("oiio:subimagename", ""), attributes)


def _attributes(spec: Any) -> dict[str, Any]:
    return {attribute.name: attribute.value for attribute in spec.extra_attribs}


def _unreadable(path: Path, reason: str) -> InputError:
    lines = reason.strip().splitlines() or ["damaged or cut short"]
    return InputError(f"{path}: cannot be read as an image ({lines[0]}); copy or take the file again")


def write_exr(path: Path, parts: Sequence[tuple[str, NDArray[np.float32]]], attributes: dict[str, str]) -> None:
    """Write float32 images of shape (h, w, channels) as the named parts of one EXR; `attributes` go into the first."""
    specs = []
    for name, data in parts:
        height, width, channels = data.shape
        spec = oiio.ImageSpec(width, height, channels, "float")
        spec.channelnames = ("Y",) if channels == 1 else ("R", "G", "B")
        spec.attribute("oiio:subimagename", name)
        spec.attribute("compression", "zip")
        specs.append(spec)
    for key, value in attributes.items():
        specs[0].attribute(key, value)
    file: Any = oiio.ImageOutput.create("exr")
    try:
        done = file.open(str(path), specs)
        for i, (_, data) in enumerate(parts):
            done = done and (i == 0 or file.open(str(path), specs[i], "AppendSubimage"))
            done = done and file.write_image(np.ascontiguousarray(data))
    finally:
        closed = file.close()
    if not (done and closed):
        raise InputError(f"{path}: cannot be written ({file.geterror() or oiio.geterror()}); choose another place")


def write_png(path: Path, pixels: NDArray[np.uint8], attributes: dict[str, str]) -> None:
    """Write 8-bit sRGB pixels (h, w, 3) with text attributes."""
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, "uint8")
    for key, value in attributes.items():
        spec.attribute(key, value)
    file: Any = oiio.ImageOutput.create("png")
    try:
        done = file.open(str(path), spec) and file.write_image(np.ascontiguousarray(pixels))
    finally:
        closed = file.close()
    if not (done and closed):
        raise InputError(f"{path}: cannot be written ({file.geterror() or oiio.geterror()}); choose another place")
