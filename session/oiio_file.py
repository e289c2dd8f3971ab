"""Image files through OpenImageIO, whose calls return False where they fail: every return is checked here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from bssrdf.errors import InputError

_DTYPES = {"uint8": "uint8", "uint16": "uint16", "uint": "uint", **dict.fromkeys(("half", "float", "double"), "float")}
_WITH_LOSS = ("dwaa", "dwab", "b44", "b44a", "jpeg")
"""Codes that change pixels by percents, dark ones beside bright ones most."""
_PLACED = "openexr"
"""The format whose pictures say where in the whole frame they lie."""

_LARGEST_FRAME = 2**33
"""Bytes of a frame beyond which a damaged header is more likely."""


_MOST_IN_HALF = 2048


class StoredImage(NamedTuple):
    """One image of a file: values as stored (half and double as float32), shape (h, w, channels)."""

    data: NDArray[Any]
    channel_names: tuple[str, ...]
    name: str
    attributes: dict[str, Any]


def read_images(path: Path) -> list[StoredImage]:
    """Every image of the file; InputError where one cannot be read whole."""
    return _read_most(path, None)


def read_image(path: Path) -> StoredImage:
    """The first image of the file; those after it may be thumbnails."""
    return _read_most(path, 1)[0]


def read_subimage(path: Path, index: int) -> NDArray[Any]:
    """The pixels of one page of a TIFF: (h, w), or (h, w, channels)."""
    data = _read_most(path, 1, first=index)[0].data
    return data[:, :, 0] if data.shape[2] == 1 else data


def _read_most(path: Path, most: int | None, first: int = 0) -> list[StoredImage]:
    with _no_text(path):
        return _read_open(path, most, first)


@contextmanager
def _no_text(path: Path) -> Iterator[None]:
    """InputError for a name, an attribute, or a message of OpenImageIO's own that is not text."""
    try:
        yield
    except UnicodeDecodeError as error:
        raise _unreadable(path, "") from error


def _opened(path: Path) -> Any:
    if not path.is_file():
        raise InputError(f"{path}: is not there; check the path")
    file = oiio.ImageInput.open(str(path))
    if file is None:
        raise _unreadable(path, oiio.geterror())
    return file


def _read_open(path: Path, most: int | None, first: int) -> list[StoredImage]:
    file = _opened(path)
    try:
        images: list[StoredImage] = []
        while len(images) != most and file.seek_subimage(first + len(images), 0):
            images.append(_read(path, file))
        if not images:
            raise _unreadable(path, file.geterror())
        return images
    finally:
        file.close()


def _read(path: Path, file: Any) -> StoredImage:
    spec = file.spec()
    dtype = _DTYPES.get(str(spec.format))
    attributes = _attributes(spec)
    if dtype is None:
        raise InputError(f"{path}: pixels of {spec.format} are not read; save 8 or 16 bit unsigned, or float")
    if spec.depth != 1 or spec.deep:
        raise InputError(f"{path}: is a volume or a deep image; save a flat one")
    data = file.read_image(file.current_subimage(), 0, 0, spec.nchannels, dtype)
    if data is None or file.has_error:
        raise _unreadable(path, file.geterror())
    lossy = str(attributes.get("compression", "")).partition(":")[0]
    if file.format_name() == _PLACED and lossy in _WITH_LOSS:
        raise InputError(
            f"{path}: is compressed with loss ({lossy}), which spoils dark pixels; save it with zip or none"
        )
    pixels = np.asarray(data).reshape(spec.height, spec.width, spec.nchannels)
    pixels = pixels.astype(np.float32) if pixels.dtype == np.uint32 else pixels
    if file.format_name() == _PLACED:
        pixels = _in_display_window(path, spec, pixels)
    return StoredImage(pixels, tuple(spec.channelnames), attributes.get("oiio:subimagename", ""), attributes)


class ImageWindows:
    """The images of a file by their name, of which windows are read when they are asked for."""

    def __init__(self, path: Path) -> None:
        """InputError where the file is not there or none of the kinds that can be read."""
        self._path = path
        self._specs: list[Any] = []
        with _no_text(path):
            self._file = _opened(path)
            while self._file.seek_subimage(len(self._specs), 0):
                self._specs.append(self._file.spec())
            self.attributes = [_attributes(spec) for spec in self._specs]
        self.names = [attributes.get("oiio:subimagename", "") for attributes in self.attributes]

    def shape(self, index: int) -> tuple[int, int, int]:
        """(h, w, channels) of an image, as it is shown."""
        spec = self._specs[index]
        return spec.full_height, spec.full_width, spec.nchannels

    def read(self, index: int, rows: slice, columns: slice) -> NDArray[Any]:
        """A window of an image, (rows, columns, channels), half or float as stored; InputError where it fails."""
        with _no_text(self._path):
            return self._read(index, rows, columns)

    def _read(self, index: int, rows: slice, columns: slice) -> NDArray[Any]:
        spec, file = self._specs[index], self._file
        placed = (spec.x - spec.full_x, spec.y - spec.full_y, spec.height, spec.width)
        if placed != (0, 0, spec.full_height, spec.full_width):
            file.seek_subimage(index, 0)
            return _read(self._path, file).data[rows, columns]
        dtype = "half" if str(spec.format) == "half" else "float"
        (top, bottom), (left, right) = (rows.start, rows.stop), (columns.start, columns.stop)
        if spec.tile_width:
            high, wide = spec.tile_height, spec.tile_width
            top, left = top - top % high, left - left % wide
            bottom, right = min(-(-bottom // high) * high, spec.height), min(-(-right // wide) * wide, spec.width)
            box = (spec.x + left, spec.x + right, spec.y + top, spec.y + bottom, 0, 1)
            data = file.read_tiles(index, 0, *box, 0, spec.nchannels, dtype)
        else:
            left, right = 0, spec.width
            data = file.read_scanlines(index, 0, spec.y + top, spec.y + bottom, 0, 0, spec.nchannels, dtype)
        if data is None or file.has_error:
            raise _unreadable(self._path, file.geterror())
        whole = np.asarray(data).reshape(bottom - top, right - left, spec.nchannels)
        return whole[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]


def _in_display_window(path: Path, spec: Any, pixels: NDArray[Any]) -> NDArray[Any]:
    """The whole frame that an EXR shows: NaN where its data window does not reach, cut where it reaches beyond."""
    left, top = spec.x - spec.full_x, spec.y - spec.full_y
    height, width = spec.full_height, spec.full_width
    if (left, top, height, width) == (0, 0, *pixels.shape[:2]):
        return pixels
    rows, columns = slice(max(top, 0), top + spec.height), slice(max(left, 0), left + spec.width)
    inner = pixels[max(-top, 0) :, max(-left, 0) :]
    if 4 * height * width * spec.nchannels > _LARGEST_FRAME:
        raise InputError(f"{path}: claims a frame of {width} x {height}; copy or take the file again")
    frame = np.full((height, width, spec.nchannels), np.nan, np.float32)
    place = frame[rows, columns]
    place[...] = inner[: place.shape[0], : place.shape[1]]
    if not place.size:
        raise InputError(f"{path}: its data window lies outside its display window; save it anew")
    return frame


def _attributes(spec: Any) -> dict[str, Any]:
    return {attribute.name: attribute.value for attribute in spec.extra_attribs}


def _unreadable(path: Path, reason: str) -> InputError:
    lines = reason.strip().splitlines() or ["damaged or cut short"]
    return InputError(f"{path}: cannot be read as an image ({lines[0]}); copy or take the file again")


def write_exr(
    path: Path, parts: Sequence[tuple[str, NDArray[Any]]], attributes: dict[str, str], tile_px: int = 0
) -> None:
    """Write images of shape (h, w, channels) as the named parts of one EXR; `attributes` go into the first.

    They are stored as float, unsigned integers up to 2,048 as half, which holds these. With `tile_px` in tiles, of
    which a reader gets those that it needs, else line by line.
    """
    planes = [(name, _storable(data)) for name, data in parts]
    specs = []
    for name, data in planes:
        height, width, channels = data.shape
        small = data.dtype == np.float16
        spec = oiio.ImageSpec(width, height, channels, "half" if small else "float")
        spec.channelnames = ("Y",) if channels == 1 else ("R", "G", "B")
        spec.attribute("oiio:subimagename", name)
        spec.attribute("compression", "zip" if small else "none")  # noise does not shrink
        spec.tile_width = spec.tile_height = tile_px
        spec.tile_depth = 1
        specs.append(spec)
    for key, value in attributes.items():
        specs[0].attribute(key, value)
    file: Any = oiio.ImageOutput.create("exr")
    try:
        done = file.open(str(path), specs)
        for i, (_, data) in enumerate(planes):
            done = done and (i == 0 or file.open(str(path), specs[i], "AppendSubimage"))
            done = done and file.write_image(np.ascontiguousarray(data))
    finally:
        closed = file.close()
    if not (done and closed):
        raise InputError(f"{path}: cannot be written ({file.geterror() or oiio.geterror()}); choose another place")


def _storable(data: NDArray[Any]) -> NDArray[Any]:
    small = data.dtype.kind == "u" and data.max(initial=0) <= _MOST_IN_HALF
    return data.astype(np.float16 if small else np.float32, copy=False)


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
