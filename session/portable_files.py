"""Files that are a header and plain numbers: PNM and PFM, NPY, FITS. Rows stay in the order of the file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.raw_frame import MACHINE_VISION_REL_SD, SECONDS, RawFrame, label, positive, real, without_alpha
from bssrdf.session.records import Card

_PNM = re.compile(rb"(P2|P3|P5|P6|Pf|PF)(?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+([-+.\deE]+)\s")
_COMMENT = re.compile(rb"#[^\n]*")
_BLOCK, _CARD = 2880, 80
_MOST_CHANNELS = 4
"""An array that ends on an axis as short as that is one picture with channels; on a longer one, a stack."""
_COLOURS = 3
_FITS_TYPES = {8: ">u1", 16: ">i2", 32: ">i4", 64: ">i8", -32: ">f4", -64: ">f8"}


def read_pnm(path: Path) -> list[RawFrame]:
    """PGM or PPM, in bytes or digits, or PFM, values as stored: the largest that the header states is white."""
    content = _bytes_of(path)
    frames: list[RawFrame] = []
    while content.strip() or not frames:
        header = _PNM.match(content)
        if header is None:
            raise _damaged(path, "PNM, its header is none of P2, P3, P5, P6, Pf, PF")
        frame, size = _pnm_frame(path, header, content[header.end() :])
        frames.append(frame)
        content = content[header.end() + size :]
    return frames


def _pnm_frame(path: Path, header: re.Match[bytes], content: bytes) -> tuple[RawFrame, int]:
    """The picture behind a header, and its size in bytes."""
    kind, width, height, top = header.groups()
    floats, channels = kind in (b"Pf", b"PF"), 3 if kind in (b"P3", b"P6", b"PF") else 1
    largest = real(top.decode()) or 0.0
    if not largest or (not floats and not 0 < largest < 65536):
        raise _damaged(path, f"PNM, its largest value {top.decode()} cannot be")
    order = "<" if floats and largest < 0 else ">"
    dtype = order + ("f4" if floats else "u1" if largest < 256 else "u2")
    shape = (int(height), int(width), channels)
    if kind in (b"P2", b"P3"):
        data, size = _digits(path, content, dtype, shape), len(content)
    else:
        data = _array(path, content, dtype, shape)
        size = data.nbytes
    card = Card() if floats else Card(bits=int(largest).bit_length(), white=(largest,))
    return _frame(np.flipud(data) if floats else data, card), size


def _digits(path: Path, content: bytes, dtype: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """Numbers that are written out, comments among them."""
    try:
        return np.array(_COMMENT.sub(b"", content).split(), np.uint32).astype(dtype).reshape(shape)
    except (ValueError, OverflowError) as error:
        raise _damaged(path, f"PNM, its numbers are not {' x '.join(map(str, shape))}") from error


def read_npy(path: Path) -> list[RawFrame]:
    """An array (h, w) or (h, w, 3); one axis more in front makes a stack."""
    try:
        data = np.load(path, allow_pickle=False, mmap_mode="r")
    except FileNotFoundError as error:
        raise InputError(f"{path}: is not there; check the path") from error
    except Exception as error:  # whatever numpy's parser meets in a damaged header
        raise _damaged(path, f"NPY ({error})") from error
    if not isinstance(data, np.ndarray) or data.dtype.kind not in "uif" or data.ndim not in (2, 3, 4) or not data.size:
        raise InputError(f"{path}: is not an array of numbers (h, w) or (h, w, 3); save one")
    is_one = data.ndim == 2 or (data.ndim == 3 and data.shape[2] <= _MOST_CHANNELS)
    if data.ndim == 3 and not is_one:
        _check_no_colours(path, data.shape)
    pages = [data] if is_one else list(data)
    return [_frame(_opaque(path, page), _container(page)) for page in pages]


def _opaque(path: Path, page: NDArray[Any]) -> NDArray[Any]:
    return without_alpha(path, page) if page.ndim == 3 and page.shape[2] in (2, 4) else page


def _check_no_colours(path: Path, axes: Sequence[int]) -> None:
    """InputError for an array (pages, h, w) whose pages, or whose columns, may be colours."""
    if axes[0] == _COLOURS or axes[2] <= _MOST_CHANNELS:
        raise InputError(
            f"{path}: holds an array {' x '.join(map(str, axes))}, whose three planes may be colours or frames; save "
            "RGB as TIFF, or each frame as a file of its own"
        )


def read_fits(path: Path) -> list[RawFrame]:
    """The pictures of all units, BZERO and BSCALE applied; a cube is a stack."""
    content, at = _bytes_of(path), 0
    frames: list[RawFrame] = []
    while at < len(content) and content[at : at + 8] in (b"SIMPLE  ", b"XTENSION"):
        keys, start = _fits_header(path, content, at)
        axes = [int(real(keys.get(f"NAXIS{i}")) or 0) for i in range(int(real(keys.get("NAXIS")) or 0), 0, -1)]
        if "ZIMAGE" in keys:
            raise InputError(f"{path}: is a compressed FITS, which is not read; uncompress it by funpack")
        dtype = _FITS_TYPES.get(int(real(keys.get("BITPIX")) or 0))
        if dtype is None:
            raise _damaged(path, "FITS, its BITPIX is none")
        size = np.dtype(dtype).itemsize * int(np.prod(axes, dtype=object)) if axes else 0
        if size and keys.get("XTENSION", "IMAGE") == "IMAGE":
            frames += _fits_unit(path, content[start:], dtype, axes, keys)
        at = start + -(-(size + int(real(keys.get("PCOUNT")) or 0)) // _BLOCK) * _BLOCK
    if not frames:
        raise _damaged(path, "FITS, it holds no picture")
    return frames


def _fits_unit(path: Path, content: bytes, dtype: str, axes: list[int], keys: dict[str, Any]) -> list[RawFrame]:
    if len(axes) not in (2, 3):
        raise InputError(f"{path}: holds an array of {len(axes)} axes; save pictures of 2, or a stack of 3")
    if len(axes) == 3:
        _check_no_colours(path, axes)
    stored = _array(path, content, dtype, (axes[0] if len(axes) == 3 else 1, *axes[-2:]))
    zero, scale = _fits_real(keys.get("BZERO", 0)), _fits_real(keys.get("BSCALE", 1))
    if zero is None or not scale:
        raise _damaged(path, "FITS, its BZERO or BSCALE is not a number")
    blank = _fits_real(keys.get("BLANK")) if np.dtype(dtype).kind in "ui" else None
    missing = np.zeros(stored.shape, bool) if blank is None else stored == blank
    if dtype == ">i2" and (zero, scale) == (32768, 1):
        stored = (stored.astype(np.int32) + 32768).astype(np.uint16)
    elif (zero, scale) != (0, 1):
        stored = (stored * scale + zero).astype(np.float32)
    if missing.any():
        stored = np.where(missing, np.float32(np.nan), stored.astype(np.float32))
    return [_fits_frame(page, keys) for page in stored]


def _fits_real(value: Any) -> float | None:
    """A number, of which FITS may write the exponent with a D."""
    return real(value.upper().replace("D", "E") if isinstance(value, str) else value)


def _fits_exposure_s(keys: dict[str, Any]) -> float | None:
    """EXPTIME or EXPOSURE in the unit in brackets that begins its comment; seconds where there is none."""
    name = "EXPTIME" if "EXPTIME" in keys else "EXPOSURE"
    seconds, unit = _fits_real(keys.get(name)), str(keys.get(f"{name} unit", "s"))
    return None if seconds is None or unit not in SECONDS else positive(seconds * SECONDS[unit])


def _fits_header(path: Path, content: bytes, start: int) -> tuple[dict[str, Any], int]:
    """Values by keyword of the unit that starts there, and where its data begin."""
    keys: dict[str, Any] = {}
    for at in range(start, len(content) - _CARD + 1, _CARD):
        card = content[at : at + _CARD].decode("ascii", errors="replace")
        if card.rstrip() == "END":
            return keys, (at // _BLOCK + 1) * _BLOCK
        if card[8:10] == "= ":
            text = card[10:].strip()
            quoted = re.match(r"'((?:[^']|'')*)'", text)
            keys.setdefault(card[:8].strip(), quoted[1].strip() if quoted else text.split("/")[0].strip())
            comment = text[quoted.end() :] if quoted else text
            if unit := re.search(r"/\s*\[\s*(\S+?)\s*\]", comment):
                keys.setdefault(f"{card[:8].strip()} unit", unit[1])
    raise _damaged(path, "FITS, its header has no end")


def _fits_frame(data: NDArray[Any], keys: dict[str, Any]) -> RawFrame:
    offset = [int(real(keys.get(name)) or 0) % 2 for name in ("YBAYROFF", "XBAYROFF")]
    pattern = str(keys.get("BAYERPAT", keys.get("COLORTYP", ""))).upper()
    if re.fullmatch("[RGBCMYW]{4}", pattern):
        pattern = "".join(np.roll(np.array(list(pattern)).reshape(2, 2), [-k for k in offset], (0, 1)).ravel())
    if str(keys.get("ROWORDER", "")).upper().startswith("BOTTOM"):
        pattern = ""  # programs differ in whether the pattern is that of the first row or of the top one
    card = Card(
        camera=label(keys.get("INSTRUME")),
        gain=_fits_real(keys.get("GAIN")),
        focal_mm=positive(_fits_real(keys.get("FOCALLEN"))),
        temperature_c=_fits_real(keys.get("CCD-TEMP")),
        layout=pattern if re.fullmatch("[RGBCMYW]{4}", pattern) else None,
        bits=_container(data).bits,
    )
    seconds = _fits_exposure_s(keys)
    try:
        utc = datetime.fromisoformat(str(keys["DATE-OBS"])).isoformat() if "DATE-OBS" in keys else None
    except ValueError:
        utc = None
    return _with_exposure(_frame(data, card), seconds, utc)


def _with_exposure(frame: RawFrame, seconds: float | None, utc: str | None) -> RawFrame:
    """The frame with the exposure that an instrument's program wrote."""
    return RawFrame(frame.data, frame.card, seconds, MACHINE_VISION_REL_SD if seconds else None, utc)


def _frame(data: NDArray[Any], card: Card) -> RawFrame:
    from bssrdf.session.tiff_file import plain

    data = data[:, :, 0] if data.ndim == 3 and data.shape[2] == 1 else data
    layout = "rgb" if data.ndim == 3 else card.layout
    sized = vars(card) | {"layout": layout, "width_px": data.shape[1], "height_px": data.shape[0]}
    return RawFrame(plain(data), Card(**sized))


def _container(data: NDArray[Any]) -> Card:
    return Card(bits=8 * data.dtype.itemsize if data.dtype.kind == "u" else None)


def _array(path: Path, content: bytes, dtype: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """The first numbers of the content in this shape; InputError where there are too few."""
    size = np.dtype(dtype).itemsize * int(np.prod(shape, dtype=object))
    if not 0 < size <= len(content):
        raise InputError(f"{path}: is cut short at {len(content)} of {size} bytes; copy or take the file again")
    return np.frombuffer(content[:size], dtype).reshape(shape)


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: is not there; check the path") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); check its permissions") from error


def _damaged(path: Path, what: str) -> InputError:
    return InputError(f"{path}: cannot be read as {' '.join(what.split())}; copy or take the file again")
