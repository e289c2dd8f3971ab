"""Is a TIFF file, or a RAW file built as one (DNG, NEF, CR2, ARW, …), as long as its own tables say?

LibRaw prints to stderr where a file ends early; this finds it out first.
"""

from __future__ import annotations

import struct
from pathlib import Path

from bssrdf.errors import InputError

_INTEGERS = {3: ("H", 2), 4: ("I", 4), 13: ("I", 4)}
"""struct's letter and the size of a tag's type."""
_OFFSETS_AND_COUNTS = ((273, 279), (324, 325))
_SUB_IFDS = 330


def check_tiff_extent(path: Path) -> None:
    """InputError where strips, tiles or tables lie beyond the end of the file; other kinds of file pass."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(content[:4])
    if order is None:
        return
    try:
        end = _extent(content, order)
    except struct.error:
        end = len(content) + 1
    if end > len(content):
        raise InputError(f"{path}: is cut short at {len(content)} bytes; copy or take the file again")


def _extent(content: bytes, order: str) -> int:
    """Where the last strip or tile ends; struct.error where a table lies outside."""
    todo, done, end = [struct.unpack_from(order + "I", content, 4)[0]], set[int](), 0
    while todo:
        at = todo.pop()
        if at == 0 or at in done:
            continue
        done.add(at)
        tags, following = _directory(content, order, at)
        todo += [following, *tags.get(_SUB_IFDS, ())]
        for offsets, counts in _OFFSETS_AND_COUNTS:
            ends = (a + n for a, n in zip(tags.get(offsets, ()), tags.get(counts, ()), strict=False))
            end = max(end, *ends, 0)
    return end


def _directory(content: bytes, order: str, at: int) -> tuple[dict[int, tuple[int, ...]], int]:
    """Integer tags of the directory at this offset, and the offset of the next."""
    (count,) = struct.unpack_from(order + "H", content, at)
    tags = {}
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind, n = struct.unpack_from(order + "HHI", content, entry)
        if kind in _INTEGERS:
            letter, size = _INTEGERS[kind]
            where = entry + 8 if n * size <= 4 else struct.unpack_from(order + "I", content, entry + 8)[0]
            tags[tag] = struct.unpack_from(f"{order}{n}{letter}", content, where)
    (following,) = struct.unpack_from(order + "I", content, at + 2 + 12 * count)
    return tags, following
