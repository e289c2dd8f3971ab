"""PNG of 16 bits whose numbers are linear: what its header and an ICC colour profile say about that."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bssrdf.errors import InputError
from bssrdf.session.raw_frame import RawFrame, without_alpha
from bssrdf.session.records import Card

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_LINEAR_GAMMA = 100_000
_LINEAR_TRANSFER = 8
"""ITU-T H.273's code of a linear transfer, in cICP."""


def read_png(path: Path) -> list[RawFrame]:
    """The picture; InputError where it has 8 bits, which cameras bend, or says that it is gamma encoded."""
    from bssrdf.session.oiio_file import read_image

    image = read_image(path)
    chunks = dict(_chunks(path.read_bytes()))
    if image.data.dtype != "uint16":
        raise InputError(
            f"{path}: has 8 bits, which are seldom linear in light; save 16 bits or TIFF, or have the response curve "
            'fitted: `bssrdf ingest --response`, or response = "debevec" in [camera]'
        )
    if _is_encoded(chunks):
        raise InputError(f"{path}: is gamma encoded, as its header says; save it linear, and without gAMA and sRGB")
    data = without_alpha(path, image.data) if image.data.shape[2] in (2, 4) else image.data
    data = data[:, :, 0] if data.shape[2] == 1 else data
    significant = chunks.get(b"sBIT", b"\x10")[0]
    layout = "rgb" if data.ndim == 3 else None
    return [RawFrame(data, Card(layout=layout, bits=significant, width_px=data.shape[1], height_px=data.shape[0]))]


def is_deep(path: Path) -> bool:
    """Whether a PNG has 16 bits; previews and plots have 8."""
    with path.open("rb") as file:
        return file.read(25)[24:] == b"\x10"


def _is_encoded(chunks: dict[bytes, bytes]) -> bool:
    if b"cICP" in chunks:
        return len(chunks[b"cICP"]) < 2 or chunks[b"cICP"][1] != _LINEAR_TRANSFER
    if b"iCCP" in chunks:
        profile = _profile(chunks[b"iCCP"])
        return profile is None or not is_linear_profile(profile)
    if b"sRGB" in chunks:
        return True
    return b"gAMA" in chunks and abs(int.from_bytes(chunks[b"gAMA"], "big") - _LINEAR_GAMMA) > _LINEAR_GAMMA // 100


def _profile(chunk: bytes) -> bytes | None:
    """The colour profile behind its name and a byte for its code."""
    try:
        return zlib.decompress(chunk.partition(b"\0")[2][1:])
    except zlib.error:
        return None


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Names and contents of the chunks before the pixels."""
    at = len(_SIGNATURE)
    while at + 8 <= len(content):
        size, name = struct.unpack_from(">I4s", content, at)
        if name == b"IDAT":
            return
        yield name, content[at + 8 : at + 8 + size]
        at += size + 12


_HEADER = 128
_CURVES = (b"rTRC", b"kTRC")
_LINEAR_WITHIN = 0.01
"""Of an exponent, and of a table's middle: 8-bit fixed point rounds to 0.004."""


def is_linear_profile(profile: Any) -> bool:
    """Whether its tone curves are straight; no profile, and one without such a curve, say nothing against it."""
    if not isinstance(profile, bytes):
        return True
    try:
        (count,) = struct.unpack_from(">I", profile, _HEADER)
        for i in range(min(count, 100)):
            name, offset, _ = struct.unpack_from(">4sII", profile, _HEADER + 4 + 12 * i)
            if name in _CURVES:
                return _is_straight(profile, offset)
    except struct.error:
        return True
    return True


def _is_straight(profile: bytes, offset: int) -> bool:
    kind = profile[offset : offset + 4]
    if kind == b"para":
        (exponent,) = struct.unpack_from(">i", profile, offset + 12)
        return bool(abs(exponent / 65536 - 1) < _LINEAR_WITHIN)
    (count,) = struct.unpack_from(">I", profile, offset + 8)
    if count == 0:
        return True
    if count == 1:
        return bool(abs(struct.unpack_from(">H", profile, offset + 12)[0] / 256 - 1) < _LINEAR_WITHIN)
    (middle,) = struct.unpack_from(">H", profile, offset + 12 + 2 * (count // 2))
    return bool(abs(middle / 65535 - (count // 2) / (count - 1)) < _LINEAR_WITHIN)
