"""The sensor's noise model: what a count in DN is worth. Signals in DN above the dark frame, times in s."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

BEND_PIVOT = 0.5
"""Share of the range at which a bent response is left as it is, so that straightening it changes no scale."""
_DITHERS = 0.4
"""Noise in steps from which the mean of rounded values is right to a percent of a step."""
_RESOLUTION = 1e-7
"""Of float32, relative: no noise is smaller."""


@dataclass(frozen=True)
class Sensor:
    """How DN follow from electrons, and where they stop to."""

    black_dn: float
    saturation_dn: float
    """A sample of this many DN or more is taken as clipped, in the colour that clips first."""
    gain_e_per_dn: float
    read_noise_e: float
    black_clipped: bool = False
    """The converter cuts off at black: noise below it is lost, so that darks tell neither bias nor read noise."""
    dark_levels: int = 3
    """Different values that 99 % of a dark's pixels show, 3 standing for more."""
    step_dn: float = 1.0
    """Between neighbouring values: 16 where 12 bits stand at the high end of 16."""
    saturations_dn: tuple[float, ...] = ()
    """The same by place in a cell of the mosaic, row by row, or by channel; empty where all are alike."""
    bend: float = 0.0
    """Straight signal over shown signal grows by this share over the range."""

    def quantisation_var_dn(self) -> float:
        """Variance [DN²] that rounding to whole steps adds."""
        return self.step_dn**2 / 12

    def read_var_dn(self) -> float:
        """Variance [DN²] of one sample without light: read noise and quantisation."""
        least = (_RESOLUTION * self.saturation_dn) ** 2 if np.isfinite(self.saturation_dn) else 0.0
        return max((self.read_noise_e / self.gain_e_per_dn) ** 2 + self.quantisation_var_dn(), least)

    def hidden_dn(self) -> float:
        """Signal [DN] up to which rounding may show nothing: half a step where noise does not dither it, else 0.

        A whole one where darks show but two values: black may lie at the edge between them.
        """
        if self.black_clipped or self.dark_levels > 2:
            dithered = self.read_noise_e / self.gain_e_per_dn > _DITHERS * self.step_dn
            return 0.0 if dithered or self.black_clipped else self.step_dn / 2
        return self.step_dn if self.dark_levels == 2 else self.step_dn / 2

    def span_dn(self) -> float:
        """From black to saturation, in the colour that clips last."""
        return max(self.saturations_dn, default=self.saturation_dn) - self.black_dn

    def bend_per_dn(self) -> float:
        """Share by which the straight signal grows over the shown one with each DN."""
        return self.bend / self.span_dn() if self.bend else 0.0

    def saturation_at(self, place: int) -> float:
        """Saturation [DN] at a place in a cell of the mosaic, or of a channel."""
        return self.saturations_dn[place] if self.saturations_dn else self.saturation_dn

    def saturation_rows(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Saturation [DN] of the rows of a cell, each as long as a row of a frame of this shape in memory."""
        return rows_of(self.saturations_dn or (self.saturation_dn,), shape)

    def unsaturated(self, raw: NDArray[Any]) -> NDArray[np.bool_]:
        """Which samples of a frame are below saturation."""
        return by_row(np.less, raw, self.saturation_rows(raw.shape))


def rows_of(values: tuple[float, ...], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Values by place in a cell, 1, 2 × 2 or one per channel, repeated along the rows of a frame of `shape`."""
    width = int(np.prod(shape[1:]))
    cell = np.asarray(values, np.float32)
    rows = cell.reshape(2, 2) if cell.size == 4 and len(shape) == 2 else cell.reshape(1, -1)
    return np.ascontiguousarray(np.tile(rows, (1, -(-width // rows.shape[1])))[:, :width])


def by_row(operation: np.ufunc, raw: NDArray[Any], rows: NDArray[np.float32]) -> NDArray[Any]:
    """`operation` of a frame and the rows of a cell, without a plane of the latter."""
    flat = raw.reshape(len(raw), -1)
    out = np.empty(flat.shape, bool if operation is np.less else np.float32)
    for place, row in enumerate(rows):
        operation(flat[place :: len(rows)], row, out=out[place :: len(rows)])
    return out.reshape(raw.shape)


def master_dark(darks: list[NDArray[Any]]) -> NDArray[Any]:
    """Mean dark frame [DN] of one exposure: bias and dark current, with nothing clipped. A single one as it is."""
    if len(darks) == 1:
        return darks[0]
    total: NDArray[np.float32] = darks[0].astype(np.float32)
    for dark in darks[1:]:
        total += dark
    total /= len(darks)
    return total
