"""PNG of 16 bits whose numbers are linear, as far as its header and an ICC colour profile say."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from bssrdf.errors import InputError
from bssrdf.session.raw_frame import RawFrame, card_of_attributes, exposure_of_tags, without_alpha
from bssrdf.session.tone_curve import check_profile

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
    _check_linear(path, chunks)
    data = without_alpha(path, image.data) if image.data.shape[2] in (2, 4) else image.data
    data = data[:, :, 0] if data.shape[2] == 1 else data
    card = replace(card_of_attributes(data, image.attributes), bits=chunks.get(b"sBIT", b"\x10")[0])
    return [RawFrame(data, card, exposure_of_tags(image.attributes))]


def is_deep(path: Path) -> bool:
    """Whether a PNG has 16 bits; previews and plots have 8."""
    with path.open("rb") as file:
        return file.read(25)[24:] == b"\x10"


def _check_linear(path: Path, chunks: dict[bytes, bytes]) -> None:
    """InputError for a PNG whose header says that it is encoded; of what it says cICP counts first, gAMA last."""
    if b"iCCP" in chunks and b"cICP" not in chunks:
        check_profile(path, _profile(chunks[b"iCCP"]))
    elif _is_encoded(chunks):
        raise InputError(f"{path}: is gamma encoded, as its header says; save it linear, and without gAMA and sRGB")


def _is_encoded(chunks: dict[bytes, bytes]) -> bool:
    if b"cICP" in chunks:
        return chunks[b"cICP"][1:2] != bytes([_LINEAR_TRANSFER])
    if b"sRGB" in chunks:
        return True
    return b"gAMA" in chunks and abs(int.from_bytes(chunks[b"gAMA"], "big") - _LINEAR_GAMMA) > _LINEAR_GAMMA // 100


def _profile(chunk: bytes) -> bytes:
    """The colour profile behind its name and a byte for its code; empty where it cannot be unpacked."""
    try:
        return zlib.decompress(chunk.partition(b"\0")[2][1:])
    except zlib.error:
        return b""


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Names and contents of the chunks before the pixels."""
    at = len(_SIGNATURE)
    while at + 8 <= len(content):
        size, name = struct.unpack_from(">I4s", content, at)
        if name == b"IDAT":
            return
        yield name, content[at + 8 : at + 8 + size]
        at += size + 12
