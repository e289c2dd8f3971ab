"""A merged image that lies in a file: of its pixels those are read that are asked for."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np

from bssrdf.measure.hdr import Bits, Counts, Pixels, Plane
from bssrdf.session import HdrExr

_ROWS = 64
"""That are read together."""


class StoredHdr:
    """What `measure` wrote of an image, as its `Hdr` was."""

    def __init__(self, path: Path) -> None:
        """InputError where the file cannot be read or a part is missing."""
        self._file = HdrExr(path)
        self.shape, self.provenance = self._file.shape, self._file.provenance
        plane = np.empty(self.shape, np.float32)
        self._planes = Pixels(plane, np.empty_like(plane), np.empty(self.shape, np.uint8))  # filled row by row
        self._filled = np.zeros(-(-self.shape[0] // _ROWS), bool)

    def rows(self, low: int, high: int) -> Pixels:
        """The pixels of some rows; InputError where they cannot be read."""
        high = min(high, self.shape[0])
        for block in range(low // _ROWS, -(-high // _ROWS)):
            if not self._filled[block]:
                self._fill(slice(block * _ROWS, min((block + 1) * _ROWS, self.shape[0])))
                self._filled[block] = True
        return self._planes.at(slice(low, high))

    def _fill(self, rows: slice) -> None:
        for part, plane in self._planes._asdict().items():
            plane[rows] = self._file.rows(part, rows.start, rows.stop)

    @property
    def radiance(self) -> Plane:
        """[DN/s]"""
        return self.rows(0, self.shape[0]).radiance

    @property
    def variance(self) -> Plane:
        """Of the radiance."""
        return self.rows(0, self.shape[0]).variance

    @property
    def mask(self) -> Bits:
        """0 for a good pixel."""
        return self.rows(0, self.shape[0]).mask

    @cached_property
    def count(self) -> Counts:
        """Samples that were merged."""
        return self._file.rows("count", 0, self.shape[0]).astype(np.uint16)
