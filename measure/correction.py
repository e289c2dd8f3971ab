"""What a frame's dark does not take away: black that moved between the two, and what saturated neighbours add."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.sensor import Sensor, by_row, rows_of
from bssrdf.measure.levels import beside
from bssrdf.measure.merge import Sample


@dataclass(frozen=True)
class Correction:
    """By place in a cell of the mosaic, or by channel."""

    offset_dn: tuple[float, ...]
    leak_dn: tuple[float, ...]
    """What pixels beside saturated ones get more."""
    sensor: Sensor | None = None

    def __call__(self, sample: Sample) -> Sample:
        """The frame with its dark put right."""
        dark: NDArray[np.float32] = by_row(np.add, sample.dark, rows_of(self.offset_dn, sample.raw.shape))
        if self.sensor and any(self.leak_dn):
            leak = by_row(np.add, np.zeros(dark.shape, np.float32), rows_of(self.leak_dn, dark.shape))
            dark += leak * beside(~self.sensor.unsaturated(sample.raw))
        return sample._replace(dark=dark)
