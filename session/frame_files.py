"""A camera's own files: RAW through rawpy, TIFF, EXR and .hdr through OpenImageIO. Safe in several threads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError

RAW_SUFFIXES = (
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mef", ".mos", ".mrw"),
    *(".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
)
_PLAIN_TIFF = (".dng", ".cr2", ".nef")
"""RAW whose tables can be trusted to say where the pixels end."""
IMAGE_SUFFIXES = (".tif", ".tiff", ".exr", ".hdr")
ENCODED_SUFFIXES = (".jpg", ".jpeg", ".png")
"""Of 8-bit files whose values a camera has bent to please the eye."""


@dataclass(frozen=True)
class RawFrame:
    """A frame as the camera made it, and what its file says about it."""

    data: NDArray[Any]
    """uint8, uint16 or float32 [DN], (h, w) of a mosaic or a mono camera, or (h, w, 3) RGB."""
    layout: str | None = None
    """2×2 colour filter pattern at the first pixel, "mono" or "rgb"; None where the file does not tell."""
    black: float | NDArray[np.float64] | None = None
    """[DN]; of a RAW mosaic (2, 2), by place in the pattern."""
    white: float | None = None
    """[DN]"""
    exposure_s: float | None = None
    """From the file's own metadata: a rounded label."""
    camera: str | None = None


def read_frame_file(path: Path, *, encoded: bool = False) -> RawFrame:
    """Read one frame; InputError where the file is missing, damaged or of a kind that cannot be measured from.

    With `encoded` an 8-bit file may be one of those whose values are not linear; else they are refused.
    """
    suffix = path.suffix.lower()
    if suffix in ENCODED_SUFFIXES and not encoded:
        raise InputError(
            f"{path}: is not linear in light; take RAW or TIFF, or have the response curve fitted: "
            '`bssrdf ingest --response`, or response = "debevec" in [camera]'
        )
    if suffix in RAW_SUFFIXES:
        return _read_raw(path)
    if suffix in (*IMAGE_SUFFIXES, *ENCODED_SUFFIXES):
        return _read_image(path)
    raise InputError(f"{path}: {suffix or 'no suffix'} is no kind of frame; use RAW, TIFF, EXR or .hdr")


def _read_image(path: Path) -> RawFrame:
    from bssrdf.session.oiio_file import read_image

    image = read_image(path)
    channels = image.data.shape[2]
    if channels not in (1, 3):
        raise InputError(f"{path}: has {channels} channels; save one (mosaic or mono) or three (RGB)")
    return RawFrame(
        data=image.data[:, :, 0] if channels == 1 else image.data,
        layout="rgb" if channels == 3 else None,
        exposure_s=_label(image.attributes.get("ExposureTime")),
        camera=image.attributes.get("Model"),
    )


def _read_raw(path: Path) -> RawFrame:
    import rawpy

    from bssrdf.session.oiio_file import file_attributes
    from bssrdf.session.tiff_extent import check_tiff_extent

    if path.suffix.lower() in _PLAIN_TIFF:
        check_tiff_extent(path)
    camera = file_attributes(path).get("Model")
    try:
        with rawpy.imread(str(path)) as raw:
            return _raw_frame(path, raw, camera)
    except (rawpy.LibRawError, rawpy.NotSupportedError, OSError, ValueError, IndexError, MemoryError) as error:
        reason = error.args[0] if error.args else error
        reason = reason.decode(errors="replace") if isinstance(reason, bytes) else reason
        raise InputError(f"{path}: cannot be read as RAW ({reason}); copy or take the file again") from error


def _raw_frame(path: Path, raw: Any, camera: str | None) -> RawFrame:
    """Everything copied out: rawpy's own arrays are gone with its file."""
    layout, black = _mosaic(path, raw)
    return RawFrame(
        data=raw.raw_image_visible.copy(),
        layout=layout,
        black=black,
        white=float(raw.white_level) if raw.white_level else None,
        exposure_s=_label(raw.other.shutter_speed),
        camera=camera,
    )


def _mosaic(path: Path, raw: Any) -> tuple[str, float | NDArray[np.float64]]:
    """The layout, and the black levels [DN] by place in it."""
    black = np.asarray(raw.black_level_per_channel, np.float64)
    if raw.raw_pattern is None:
        raise InputError(f"{path}: is no mosaic but a stack of planes (Foveon, sRAW, linear DNG); save full RAW")
    if raw.num_colors == 1:
        return "mono", float(black[0])
    if raw.raw_pattern.shape != (2, 2):
        raise InputError(f"{path}: has an X-Trans pattern, which is not read; use a camera with a 2x2 pattern")
    corner = raw.raw_colors_visible[:2, :2].copy()
    return "".join(chr(raw.color_desc[i]) for i in corner.ravel()), black[corner]


def _label(seconds: float | None) -> float | None:
    """The decimal number that was stored as float32; None where there is none."""
    label = float(str(np.float32(seconds or 0)))
    return label if 0 < label < float("inf") else None
