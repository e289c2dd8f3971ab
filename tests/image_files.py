"""Small image files of many kinds, written by hand or by tifffile and OpenImageIO."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import tifffile
from numpy.typing import NDArray

RNG = np.random.default_rng(3)
DN = RNG.integers(20, 4000, (12, 16)).astype(np.uint16)
RGB = np.stack([DN, DN // 2, DN // 3], -1)
FLOATS = RNG.random((12, 16, 3)).astype(np.float32)
DNG = [(50706, "B", 4, bytes([1, 4, 0, 0]), True)]
MOSAICS = ("deflate.dng", "float_cfa.dng")
CFA = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes((0, 1, 1, 2)), True)]


def tiff(data: NDArray[Any], **options: Any) -> Callable[[Path], None]:
    options.setdefault("photometric", "rgb" if data.ndim == 3 and data.shape[-1] > 2 else "minisblack")
    if options["photometric"] == LINEAR_RAW and data.ndim == 3:
        options["planarconfig"] = "contig"  # else new versions of tifffile take rows for pages
    return lambda path: tifffile.imwrite(path, data, metadata=None, **options)


def content(data: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(data) and None


def packed(data: NDArray[np.uint16], bits: int) -> Callable[[Path], None]:
    """A TIFF whose samples of `bits` follow each other without a gap, high bit first, rows padded to bytes."""
    planes = (data[..., None] >> np.arange(bits - 1, -1, -1)) & 1
    rows = np.packbits(planes.reshape(len(data), -1).astype(np.uint8), axis=1).tobytes()
    tags = [(256, 4, data.shape[1]), (257, 4, len(data)), (258, 3, bits), (259, 3, 1), (262, 3, 1), (273, 4, 8)]
    tags += [(277, 3, 1), (278, 4, len(data)), (279, 4, len(rows))]
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag[:2], 1, tag[2]) for tag in tags)
    return content(b"II*\0" + struct.pack("<I", 8 + len(rows)) + rows + directory + b"\0\0\0\0")


def fits(data: NDArray[Any], *cards: str, unit: str = "SIMPLE  =                    T") -> bytes:
    sizes = [f"NAXIS{i + 1:<3}= {n:20}" for i, n in enumerate(reversed(data.shape))]
    bits = data.dtype.itemsize * (8 if data.dtype.kind in "ui" else -8)
    head = "".join(
        card.ljust(80) for card in [unit, f"BITPIX  = {bits:20}", f"NAXIS   = {data.ndim:20}", *sizes, *cards, "END"]
    )
    padded = (text + pad * (-len(text) % 2880) for text, pad in ((head.encode(), b" "), (data.tobytes(), b"\0")))
    return b"".join(padded)


def png(path: Path, *chunks: tuple[bytes, bytes], data: NDArray[Any] = DN) -> None:
    """A PNG with further chunks before its pixels."""
    channels, depth = (3 if data.ndim == 3 else 1), 8 * data.dtype.itemsize
    rows = data.astype(data.dtype.newbyteorder(">")).reshape(len(data), -1)
    pixels = zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows))
    header = struct.pack(">IIBBBBB", data.shape[1], data.shape[0], depth, 2 if channels == 3 else 0, 0, 0, 0)
    parts = [(b"IHDR", header), *chunks, (b"IDAT", pixels), (b"IEND", b"")]
    body = b"".join(
        struct.pack(">I", len(part)) + name + part + struct.pack(">I", zlib.crc32(name + part)) for name, part in parts
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def exr(
    path: Path, parts: list[tuple[str, tuple[str, ...], NDArray[np.float32]]], code: str = "zip", **window: int
) -> None:
    specs = []
    for name, channels, data in parts:
        spec = oiio.ImageSpec(data.shape[1], data.shape[0], len(channels), "float")
        spec.channelnames = channels
        spec.attribute("compression", code)
        for key, value in window.items():
            setattr(spec, key, value)
        if name:
            spec.attribute("oiio:subimagename", name)
        specs.append(spec)
    output: Any = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), specs if len(specs) > 1 else specs[0])
    for i, (_, _, data) in enumerate(parts):
        assert i == 0 or output.open(str(path), specs[i], "AppendSubimage")
        assert output.write_image(np.ascontiguousarray(data))
    assert output.close()


def radiance(path: Path, rgbe: NDArray[np.uint8], *lines: str, kind: str = "rgbe", rows: str = "-Y {} +X {}") -> None:
    head = "\n".join(["#?RADIANCE", f"FORMAT=32-bit_rle_{kind}", *lines, "", rows.format(*rgbe.shape[:2]), ""])
    path.write_bytes(head.encode() + rgbe.tobytes())


def icc(*exponents: float) -> bytes:
    """A colour profile whose red, green and blue curves are powers."""
    return profile(*(b"curv\0\0\0\0" + struct.pack(">IH", 1, round(256 * each)) for each in exponents))


def icc_table(values: NDArray[Any]) -> bytes:
    return profile(b"curv\0\0\0\0" + struct.pack(">I", values.size) + np.rint(65535 * values).astype(">u2").tobytes())


def icc_formula(kind: int, *parameters: float) -> bytes:
    fixed = b"".join(struct.pack(">i", round(65536 * each)) for each in parameters)
    return profile(b"para\0\0\0\0" + struct.pack(">HH", kind, 0) + fixed)


def profile(*curves: bytes, names: tuple[bytes, ...] = (b"rTRC", b"gTRC", b"bTRC")) -> bytes:
    """A colour profile of nothing but these tags."""
    table, at = struct.pack(">I", len(curves)), 132 + 12 * len(curves)
    for name, curve in zip(names, curves, strict=False):
        table += struct.pack(">4sII", name, at, len(curve))
        at += len(curve)
    return bytes(128) + table + b"".join(curves)


def iccp(stored: bytes) -> tuple[bytes, bytes]:
    return b"iCCP", b"x\0\0" + zlib.compress(stored)


LINEAR_RAW = 34892
THUMBNAIL = DN[::4, ::4].copy()


def with_thumbnail(path: Path) -> None:
    with tifffile.TiffWriter(path) as writer:
        writer.write(THUMBNAIL, subfiletype=1, metadata=None)
        writer.write(DN, metadata=None)


STACK = np.stack([DN, DN // 2, DN // 4])
CUBE = np.stack([*STACK, DN // 8])
RGBE = np.dstack([np.full((2, 3), value, np.uint8) for value in (128, 64, 32, 129)])
