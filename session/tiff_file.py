"""TIFF, and DNG whose pixels a TIFF reader gets: the numbers as they are stored, or a refusal by name.

tifffile decodes what Python alone can, imagecodecs (the extra `formats`) most of the rest, OpenImageIO LZW.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.ome import check_one_channel, plane_exposures_s
from bssrdf.session.raw_frame import (
    MACHINE_VISION_REL_SD,
    RawFrame,
    Tags,
    card_of_tags,
    exposure_of_tags,
    positive,
    real,
    time_of_tags,
    without_alpha,
)
from bssrdf.session.tone_curve import check_profile, check_table

logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what is wrong with a file is said by our own exception

_LINEAR = {1: "minisblack", 2: "rgb", 32803: "mosaic", 34892: "rgb"}
_ENCODED = {
    0: "an inverted picture (white is zero)",
    3: "a palette picture",
    4: "a mask",
    5: "a CMYK picture",
    6: "a YCbCr picture",
    **dict.fromkeys((8, 9, 10), "a CIELAB picture"),
    **dict.fromkeys((32844, 32845), "a LogLuv picture"),
}
_JPEG, _LOSSY_DNG = (6, 7), 34892
_SOF, _LOSSLESS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}, 0xC3
_NO_PICTURE = 1 | 4 | 8
"""Bits of NewSubfileType: a reduced copy, a mask, a map of depths."""
_CODED_AT_MOST = 2000
"""No lossless code of a frame is smaller than this share; deflate reaches 1032."""


def read_tiff(path: Path, *, pixels: bool = True) -> Iterator[RawFrame]:
    """The pictures of the file one by one, thumbnails left out; with `pixels` false their cards over empty data."""
    with _opened(path) as tif:
        pages, exposures = _pictures(path, tif), plane_exposures_s(tif)
        check_one_channel(path, tif, exposures)
        for page in pages:
            frame = _frame(path, page, pixels)
            if exposures.get(page.index):
                frame = replace(frame, exposure_s=exposures[page.index], exposure_rel_sd=MACHINE_VISION_REL_SD)
            yield frame


def raw_tags(path: Path) -> Tags:
    """Tags of a RAW file that is built as a TIFF, those of its EXIF and of its raw picture; none of another file."""
    try:
        with tifffile.TiffFile(path) as tif:
            pages = [page for page in _with_children(list(tif.pages)) if not page.subfiletype & _NO_PICTURE]
            tags = [_tags(page) for page in (tif.pages.first, *pages[:1])]
    except Exception:  # any damage there is: who reads the pixels says so
        return {}
    return {**tags[0], **tags[-1], "pictures": len(pages)}


def check_extent(path: Path) -> None:
    """InputError where strips or tiles lie beyond the end of the file, or where a mosaic was compressed with loss."""
    with _opened(path) as tif:
        for page in _with_children(list(tif.pages)):
            _check_extent(path, page)
            if page.photometric == 32803:
                _check_lossless(path, page, _tags(page))


@contextmanager
def _opened(path: Path) -> Iterator[tifffile.TiffFile]:
    try:
        with tifffile.TiffFile(path) as tif:
            tif.pages.useframes = False  # else the tags of all pages but the first are taken for the first's
            _check_chain(path, tif)
            yield tif
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(f"{path}: is not there; check the path") from error
    except Exception as error:  # whatever tifffile meets in a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read as TIFF ({reason[:120]}); copy or take the file again") from error


def _check_chain(path: Path, tif: tifffile.TiffFile) -> None:
    """InputError where the last directory points beyond the end of the file: tifffile stops there in silence."""
    form, file = tif.tiff, tif.filehandle
    at = tif.pages[-1].offset
    file.seek(at)
    (n_tags,) = struct.unpack(form.tagnoformat, file.read(form.tagnosize))
    file.seek(at + form.tagnosize + n_tags * form.tagsize)
    (following,) = struct.unpack(form.offsetformat, file.read(form.offsetsize))
    if following >= file.size:
        raise InputError(f"{path}: is cut short at {file.size} bytes; copy or take the file again")


def _with_children(pages: list[Any]) -> Iterator[Any]:
    for page in pages:
        yield page
        if page.pages is not None:
            yield from _with_children(list(page.pages))


def _pictures(path: Path, tif: tifffile.TiffFile) -> list[Any]:
    pages = [page for page in _with_children(list(tif.pages)) if not page.subfiletype & _NO_PICTURE]
    if not pages:
        raise InputError(f"{path}: holds thumbnails and masks only; take the picture itself")
    sizes = sorted({f"{page.imagewidth} x {page.imagelength}" for page in pages})
    if len(sizes) > 1:
        raise InputError(f"{path}: holds pictures of different sizes ({', '.join(sizes)}); save each by itself")
    listed = int((tif.imagej_metadata or {}).get("images", 1))
    if listed > len(pages) > 0:
        raise InputError(f"{path}: holds {listed} pictures behind {len(pages)} directory; save it as a plain stack")
    return pages


def _frame(path: Path, page: Any, pixels: bool) -> RawFrame:
    tags = _tags(page)
    _check_linear(path, page, tags)
    layout = _layout(path, page, tags)
    data: NDArray[Any] = _pixels(path, page) if pixels else np.empty((0, 0), np.uint8)
    cut = _active_area(tags, page)
    black, white = _levels(path, tags)
    card = replace(
        card_of_tags(tags),
        layout=layout,
        bits=_bits(page, white),
        black=black,
        white=white,
        width_px=page.imagewidth if cut is None else cut[1].stop - cut[1].start,
        height_px=page.imagelength if cut is None else cut[0].stop - cut[0].start,
    )
    micro_manager = real((tags.get("MicroManagerMetadata") or {}).get("Exposure-ms"))
    return RawFrame(
        data if cut is None or not pixels else np.ascontiguousarray(data[cut]),
        card,
        exposure_s=positive(micro_manager / 1000) if micro_manager else exposure_of_tags(tags),
        exposure_rel_sd=MACHINE_VISION_REL_SD if micro_manager else None,
        utc=time_of_tags(tags),
    )


def _check_linear(path: Path, page: Any, tags: Tags) -> None:
    """InputError for a picture whose numbers are something else than light."""
    if page.photometric not in _LINEAR:
        what = _ENCODED.get(int(page.photometric), f"a picture of kind {page.photometric}")
        raise InputError(f"{path}: is {what}, whose numbers are not linear in light; save mono, mosaic or RGB")
    if "GrayResponseCurve" in tags:
        raise InputError(f"{path}: stores optical densities, as its gray response curve says; save it linear")
    if "TransferFunction" in tags:
        check_table(path, tags["TransferFunction"])
    check_profile(path, tags.get("InterColorProfile"))
    if tags.get("LinearizationTable") is not None:
        raise InputError(f"{path}: has a linearisation table that only a RAW reader applies; convert it to plain DNG")
    _check_lossless(path, page, tags)
    if page.imagedepth > 1 or page.dtype is None or page.dtype.kind not in "uif":
        raise InputError(f"{path}: holds {page.dtype or 'unknown'} pixels or a volume; save integers or floats")


def _check_lossless(path: Path, page: Any, tags: Tags) -> None:
    """InputError for a code that changes numbers: JPEG of any kind but the lossless one, JPEG XL at a distance."""
    is_lossy = page.compression == _LOSSY_DNG or (real(tags.get("JXLDistance")) or 0.0) > 0
    if page.compression in _JPEG and page.dataoffsets:
        with path.open("rb") as file:
            file.seek(page.dataoffsets[0])
            is_lossy = _frame_marker(file.read(min(page.databytecounts[0], 1 << 16))) != _LOSSLESS
    if is_lossy:
        raise InputError(f"{path}: is compressed with loss, which spoils dark pixels; save it without")


def _frame_marker(jpeg: bytes) -> int | None:
    """The byte of a JPEG that tells its kind: the first of the markers SOF0 to SOF15."""
    at = 2
    while at + 4 <= len(jpeg):
        marker = jpeg[at + 1]
        if marker in _SOF:
            return marker
        at += 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
    return None


def _layout(path: Path, page: Any, tags: Tags) -> str | None:
    if page.samplesperpixel >= 3 or page.photometric != 32803:
        return "rgb" if page.samplesperpixel >= 3 else "mono" if page.photometric == 34892 else None
    size = tuple(tags.get("CFARepeatPatternDim") or ())
    pattern = bytes(tags.get("CFAPattern") or b"")
    if not pattern:
        return None
    if size != (2, 2) or len(pattern) != 4:
        raise InputError(f"{path}: {pattern_refusal(size)}")
    if max(pattern) >= len("RGBCMYW"):
        raise InputError(f"{path}: its colour filter pattern {list(pattern)} is not known; copy or take the file again")
    return "".join("RGBCMYW"[colour] for colour in pattern)


def pattern_refusal(size: tuple[int, ...]) -> str:
    """Why a colour filter pattern of this size is not read."""
    name = {4: "quad Bayer", 6: "X-Trans"}.get(size[0] if size else 0, "unusual")
    return f"has a colour filter pattern of {' x '.join(map(str, size))} ({name}), which is not read; use a 2x2 pattern"


def _pixels(path: Path, page: Any) -> NDArray[Any]:
    """The numbers, (h, w) or (h, w, 3)."""
    _check_extent(path, page)
    data = _decoded(path, page)
    if data.ndim == 3 and page.axes.startswith("S"):
        data = np.moveaxis(data, 0, -1)
    if data.ndim == 3 and data.shape[2] in (2, 4):
        data = without_alpha(path, data)
    data = data[:, :, 0] if data.ndim == 3 and data.shape[2] == 1 else data
    if data.ndim != 2 and (data.ndim != 3 or data.shape[2] != 3):
        raise InputError(f"{path}: has {data.shape[-1]} channels; save one (mosaic or mono) or three (RGB)")
    return plain(data)


def _decoded(path: Path, page: Any) -> NDArray[Any]:
    from bssrdf.session.oiio_file import read_subimage

    if page.is_memmappable:  # asarray would go strip by strip, at ten times the cost
        stored = page.dtype.newbyteorder(page.parent.byteorder)
        return np.fromfile(path, stored, page.size, offset=page.dataoffsets[0]).reshape(page.shape)
    try:
        return np.asarray(page.asarray())
    except (ValueError, NotImplementedError, ImportError) as error:
        if not isinstance(error, ImportError) and "imagecodecs" not in str(error):
            raise
        name = getattr(page.compression, "name", str(page.compression))
        spare = 16 - page.bitspersample
        try:
            data = read_subimage(path, page.index)
        except InputError:
            raise InputError(f"{path}: is compressed by {name}; `pip install 'bssrdf[formats]'` reads it") from error
        return data if spare <= 0 or data.dtype != np.uint16 else data >> spare  # OpenImageIO aligns bits high


def plain(data: NDArray[Any]) -> NDArray[Any]:
    """uint8 and uint16 as they are, all other numbers as float32, in the machine's byte order."""
    kept = data.dtype.kind == "u" and data.dtype.itemsize <= 2
    with np.errstate(over="ignore"):  # becomes infinite, as what no camera reads
        return np.ascontiguousarray(data, data.dtype.newbyteorder("=") if kept else np.float32)


def _check_extent(path: Path, page: Any) -> None:
    """InputError where a page's strips lie beyond the end of the file, or hold less than it claims."""
    end = path.stat().st_size
    pairs = list(zip(page.dataoffsets, page.databytecounts, strict=False))
    stored = sum(count for _, count in pairs)
    if any(offset + count > end for offset, count in pairs) or len(page.dataoffsets) > len(page.databytecounts):
        raise InputError(f"{path}: is cut short at {end} bytes; copy or take the file again")
    if page.compression == 1 and stored * 8 < page.bitspersample * page.size:
        raise InputError(
            f"{path}: claims a {page.nbytes / 2**20:.0f} MB image of {stored} bytes; copy or take the file again"
        )
    if page.nbytes > _CODED_AT_MOST * max(stored, 1024):
        raise InputError(f"{path}: claims a {page.nbytes / 2**20:.0f} MB image; copy or take the file again")


def _active_area(tags: Tags, page: Any) -> tuple[slice, slice] | None:
    """The pixels that light reaches, where a DNG tells them."""
    area = tags.get("ActiveArea")
    if area is None or len(area) != 4:
        return None
    top, left, bottom, right = (int(edge) for edge in area)
    if not (0 <= top < bottom <= page.imagelength and 0 <= left < right <= page.imagewidth):
        return None
    return slice(top, bottom), slice(left, right)


def _levels(path: Path, tags: Tags) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    """Black and white [DN] where tags give them: one number, or one by place or by channel."""
    black, white = (_numbers(tags.get(name)) for name in ("BlackLevel", "WhiteLevel"))
    repeat = tuple(tags.get("BlackLevelRepeatDim") or (1, 1))
    if (black is not None and repeat not in ((1, 1), (2, 2))) or (black and len(black) not in (1, 3, 4)):
        raise InputError(f"{path}: has black levels that repeat over {repeat} pixels, which is not read")
    return _once(black), _once(white)


def _once(levels: tuple[float, ...] | None) -> tuple[float, ...] | None:
    return levels[:1] if levels and len(set(levels)) == 1 else levels


def _numbers(value: Any) -> tuple[float, ...] | None:
    """Numbers of a tag; rationals come as one flat list of pairs."""
    if value is None:
        return None
    flat = [float(each) for each in np.ravel(value)]
    if len(flat) in (2, 6, 8):
        flat = [a / b for a, b in zip(flat[::2], flat[1::2], strict=True) if b]
    return tuple(flat) if flat and np.isfinite(flat).all() else None


def _bits(page: Any, white: tuple[float, ...] | None) -> int | None:
    """Significant bits: by the white level where it is known, else those of a sample."""
    if page.dtype.kind != "u":
        return None
    stored = int(page.bitspersample)
    return min(stored, int(max(white)).bit_length()) if white else stored


def _tags(page: Any) -> dict[str, Any]:
    tags = {tag.name: tag.value for tag in page.tags}
    exif = tags.pop("ExifTag", None)
    return {**(exif if isinstance(exif, dict) else {}), **tags}
