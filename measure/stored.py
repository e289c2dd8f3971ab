"""A merged image that lies in a file: of its pixels those are read that are asked for."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bssrdf.measure.hdr import Bits, Counts, Pixels, Plane
from bssrdf.session import HdrExr

_SIDE = 128
"""Of the squares that are read whole [px]."""
_ALL = slice(None)


class _Box(NamedTuple):
    """Pixels that were read, and where they lie."""

    rows: range
    columns: range
    pixels: Pixels

    def holds(self, rows: range, columns: range) -> bool:
        return all(
            own.start <= asked.start and asked.stop <= own.stop
            for own, asked in ((self.rows, rows), (self.columns, columns))
        )

    def at(self, rows: range, columns: range) -> Pixels:
        top, left = self.rows.start, self.columns.start
        return self.pixels.at(
            (slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left))
        )


class StoredHdr:
    """What `measure` wrote of an image, as its `Hdr` was."""

    def __init__(self, path: Path) -> None:
        """InputError where the file cannot be read or a part is missing."""
        self._file = HdrExr(path)
        self.shape, self.provenance = self._file.shape, self._file.provenance
        self._boxes: list[_Box] = []

    def window(self, rows: slice, columns: slice) -> Pixels:
        """The pixels of some rows and columns; InputError where they cannot be read."""
        asked = [range(size)[part] for part, size in zip((rows, columns), self.shape, strict=False)]
        box = next((box for box in self._boxes if box.holds(*asked)), None) or self._read(*asked)
        return box.at(*asked)

    def _read(self, rows: range, columns: range) -> _Box:
        """The squares that hold these pixels, read and kept; boxes within them are dropped."""
        high, wide = (
            range(part.start // _SIDE * _SIDE, min(-(-part.stop // _SIDE) * _SIDE, size))
            for part, size in zip((rows, columns), self.shape, strict=False)
        )
        where = slice(high.start, high.stop), slice(wide.start, wide.stop)
        radiance, variance, mask = (self._file.window(part, *where) for part in Pixels._fields)
        box = _Box(high, wide, Pixels(radiance, variance, mask.astype(np.uint8)))
        self._boxes = [box, *(other for other in self._boxes if not box.holds(other.rows, other.columns))]
        return box

    @property
    def radiance(self) -> Plane:
        """[DN/s]"""
        return self.window(_ALL, _ALL).radiance

    @property
    def variance(self) -> Plane:
        """Of the radiance."""
        return self.window(_ALL, _ALL).variance

    @property
    def mask(self) -> Bits:
        """0 for a good pixel."""
        return self.window(_ALL, _ALL).mask

    @cached_property
    def count(self) -> Counts:
        """Samples that were merged."""
        return self._file.whole("count").astype(np.uint16)
