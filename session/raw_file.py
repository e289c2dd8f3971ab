"""A camera's RAW file through LibRaw; a DNG that LibRaw does not unpack through the TIFF reader."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.raw_frame import RawFrame, card_of_tags, filled, label, positive, time_of_tags
from bssrdf.session.records import Card

RAW_SUFFIXES = (
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mef", ".mos", ".mrw"),
    *(".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
)
_PLAIN_TIFF = (".dng", ".cr2", ".nef")
"""RAW whose tables can be trusted to say where the pixels end."""
_NOT_BY_LIBRAW = (8, 32946, 50002, 52546)
"""Codes of a DNG mosaic: deflate of integers, JPEG XL."""
_BENT_OR_CUT = (
    "LinearizationTable",
    "ActiveArea",
    "MaskedAreas",
    "BlackLevelDeltaH",
    "BlackLevelDeltaV",
    "OpcodeList1",
)
"""Tags of a DNG that ask for more than taking its numbers as they stand."""


def read_raw(path: Path, *, pixels: bool = True) -> RawFrame:
    """The frame, or with `pixels` false its card over empty data; InputError where it cannot be measured from."""
    import rawpy

    from bssrdf.session.tiff_file import check_extent, raw_tags, read_tiff

    tags = raw_tags(path)
    _check_pattern(path, tags)
    if _is_for_tiff(path, tags):
        return next(read_tiff(path, pixels=pixels))
    if pixels and path.suffix.lower() in _PLAIN_TIFF and tags:
        check_extent(path)
    try:
        with rawpy.imread(str(path)) as raw:
            if tags and not pixels:
                return RawFrame(np.empty((0, 0), np.uint16), _quick_card(raw, tags), utc=time_of_tags(tags))
            return _raw_frame(path, raw, tags, pixels)
    except rawpy.LibRawFileUnsupportedError as error:
        version = ".".join(map(str, rawpy.libraw_version))
        raise InputError(
            f"{path}: is of a kind that LibRaw {version} does not read; convert it to DNG, or update rawpy"
        ) from error
    except (rawpy.LibRawError, rawpy.NotSupportedError, OSError, ValueError, IndexError, MemoryError) as error:
        reason = error.args[0] if error.args else error
        reason = reason.decode(errors="replace") if isinstance(reason, bytes) else reason
        raise InputError(f"{path}: cannot be read as RAW ({reason}); copy or take the file again") from error


def _check_pattern(path: Path, tags: Mapping[str, Any]) -> None:
    """LibRaw takes the corner of a larger pattern for the whole, and the first of several pictures."""
    from bssrdf.session.tiff_file import pattern_refusal

    size = tags.get("CFARepeatPatternDim")
    if isinstance(size, tuple) and size != (2, 2):
        raise InputError(f"{path}: {pattern_refusal(size)}")
    if tags.get("CFALayout", 1) != 1:
        raise InputError(
            f"{path}: has rows or columns of its colour filters set off from each other, which is not read"
        )
    if "DNGVersion" in tags and tags["pictures"] > 1:
        raise InputError(f"{path}: holds {tags['pictures']} raw pictures; save each as a file of its own")


def _is_for_tiff(path: Path, tags: Mapping[str, Any]) -> bool:
    """Whether this is a DNG of colour planes, of floats (LibRaw rounds them), plain, or of a code it does not know.

    Numbers that lie there as they are get read eight times faster without LibRaw.
    """
    if "DNGVersion" not in tags:
        return False
    planes = tags.get("PhotometricInterpretation") == 34892 and tags.get("SamplesPerPixel", 1) > 1
    floats = 3 in np.ravel(tags.get("SampleFormat", 1))
    as_they_are = tags.get("Compression") == 1 and tags.get("BitsPerSample") in (16, (16,))
    plain = path.suffix.lower() == ".dng" and as_they_are and not tags.keys() & {*_BENT_OR_CUT}
    return bool(planes or floats or plain or tags.get("Compression") in _NOT_BY_LIBRAW)


def _quick_card(raw: Any, tags: Mapping[str, Any]) -> Card:
    """What tells without decoding the pixels, as LibRaw does for all else that it says: of DNG all that matters."""
    card, sizes = card_of_tags(tags), raw.sizes
    card = replace(card, width_px=sizes.width, height_px=sizes.height)
    pattern, white = bytes(tags.get("CFAPattern") or b""), tags.get("WhiteLevel")
    if "DNGVersion" not in tags or len(pattern) != 4 or not isinstance(white, int):
        return card
    top, left = np.ravel(tags.get("ActiveArea", (0, 0)))[:2].astype(int)
    shift = (top - sizes.top_margin, left - sizes.left_margin)
    corner = np.roll(np.array(["RGBCMYW"[min(each, 6)] for each in pattern]).reshape(2, 2), shift, (0, 1))
    return replace(card, layout="".join(corner.ravel()), white=(float(white),), bits=white.bit_length())


def _raw_frame(path: Path, raw: Any, tags: Mapping[str, Any], pixels: bool) -> RawFrame:
    """Everything copied out: rawpy's own arrays are gone with its file."""
    layout, black = _mosaic(path, raw)
    other, sizes = raw.other, raw.sizes
    by_libraw = Card(
        lens=label(raw.lens.model),
        iso=positive(other.iso_speed),
        f_number=positive(other.aperture),
        focal_mm=positive(other.focal_length),
        layout=layout,
        black=black,
        white=(float(raw.white_level),) if raw.white_level else None,
        bits=int(raw.white_level).bit_length() if raw.white_level else None,
        width_px=sizes.width,
        height_px=sizes.height,
    )
    data: NDArray[Any] = raw.raw_image_visible.copy() if pixels else np.empty((0, 0), np.uint16)
    if pixels and path.suffix.lower() not in _PLAIN_TIFF:
        _check_end(path, data, float(np.min(black)))
    return RawFrame(
        data,
        replace(filled(by_libraw, card_of_tags(tags)), orientation=card_of_tags(tags).orientation),
        exposure_s=positive(other.shutter_speed),
        utc=time_of_tags(tags) or _time(other.timestamp),
        masked_dn=_masked(raw, tags, layout) if pixels else None,
    )


def _mosaic(path: Path, raw: Any) -> tuple[str, tuple[float, ...]]:
    """The layout, and the black levels [DN] by place in it."""
    from bssrdf.session.tiff_file import pattern_refusal

    black = np.asarray(raw.black_level_per_channel, np.float64)
    if raw.raw_pattern is None:
        raise InputError(f"{path}: is not a mosaic but a stack of planes (Foveon, sRAW); save full RAW")
    if raw.num_colors == 1:
        return "mono", (float(black[0]),)
    if raw.raw_pattern.shape != (2, 2):
        raise InputError(f"{path}: {pattern_refusal(raw.raw_pattern.shape)}")
    top, left = raw.sizes.top_margin, raw.sizes.left_margin
    corner = np.array([[raw.raw_color(top + row, left + column) for column in (0, 1)] for row in (0, 1)])
    levels = tuple(float(level) for level in black[corner].ravel())
    return "".join(chr(raw.color_desc[i]) for i in corner.ravel()), levels[:1] if len(set(levels)) == 1 else levels


def _check_end(path: Path, data: NDArray[Any], black: float) -> None:
    """InputError where the last rows hold one number that no sensor reads: what a decoder leaves of a cut file."""
    last = data[-2:]
    if last.size and (last == last.flat[0]).all() and (last.flat[0] < black or last.flat[0] == 0):
        raise InputError(f"{path}: is cut short: its last rows are empty; copy or take the file again")


def _masked(raw: Any, tags: Mapping[str, Any], layout: str) -> tuple[float, ...] | None:
    """Mean of the pixels that a DNG says no light reaches, by place in the pattern of the visible picture."""
    areas = np.ravel(tags.get("MaskedAreas") or ()).astype(int)
    if not areas.size or areas.size % 4:
        return None
    image, sizes = raw.raw_image, raw.sizes
    period = 1 if layout == "mono" else 2
    sums, counts = np.zeros((period, period)), np.zeros((period, period))
    for top, left, bottom, right in areas.reshape(-1, 4):
        for row in range(period):
            for column in range(period):
                first_row = top + (sizes.top_margin + row - top) % period
                first_column = left + (sizes.left_margin + column - left) % period
                part = image[first_row:bottom:period, first_column:right:period]
                sums[row, column] += part.sum(dtype=float)
                counts[row, column] += part.size
    return tuple((sums / counts).ravel()) if counts.all() else None


def _time(stamp: Any) -> str | None:
    """LibRaw's time; the epoch stands for none."""
    return stamp.isoformat() if stamp is not None and stamp.year > 1970 else None
