"""Whether the scene moved between two frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Shift(NamedTuple):
    """Displacement of the second image against the first and its standard error, in pixels."""

    x_px: float
    y_px: float
    sd_px: float

    @property
    def length_px(self) -> float:
        return float(np.hypot(self.x_px, self.y_px))


def shift_between(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    compare: NDArray[np.bool_],
    period: int,
) -> Shift | None:
    """Displacement by least squares on the gradient, b(x) − a(x) = −s·∇a(x), over the pixels `compare`.

    Images of one brightness, shape (h, w); `period` is the distance of pixels of one colour. None where the pixels
    do not tell, for want of structure.
    """
    inner = np.zeros_like(compare)
    inner[period:-period, period:-period] = compare[period:-period, period:-period]
    row, column = np.nonzero(inner)
    step = 2 * period
    slope_x = (first[row, column + period] - first[row, column - period]) / step
    slope_y = (first[row + period, column] - first[row - period, column]) / step
    known = np.isfinite(slope_x) & np.isfinite(slope_y)
    row, column, slope_x, slope_y = row[known], column[known], slope_x[known], slope_y[known]
    if row.size < 10:
        return None
    level = (first[row, column] + second[row, column]) / 2
    whitened = np.stack([slope_x, slope_y]) / np.sqrt(np.maximum(level, 1))
    change = -(second[row, column] - first[row, column]) / np.sqrt(np.maximum(level, 1))
    normal = (whitened @ whitened.T).astype(float)
    if np.linalg.cond(normal) > 1e8:
        return None
    s = np.linalg.solve(normal, whitened @ change)
    noise = np.mean((change - s @ whitened) ** 2)
    sd = np.sqrt(noise * np.trace(np.linalg.inv(normal)))
    return Shift(float(s[0]), float(s[1]), float(sd))
