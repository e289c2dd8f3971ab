"""Axes and paths of a figure in SVG: numbers to places, nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bssrdf.session.records import Array


@dataclass(frozen=True)
class Axis:
    """From values to places [px]; values beyond the ends lie on them."""

    low: float
    high: float
    start_px: float
    end_px: float
    is_log: bool

    @classmethod
    def log(cls, values: Array, start_px: float, end_px: float) -> Axis:
        """A log axis that holds all positive values."""
        positive = values[np.isfinite(values) & (values > 0)]
        low, high = (float(positive.min()), float(positive.max())) if positive.size else (0.1, 1.0)
        return cls(low / 1.15, max(high, low * 1.01) * 1.15, start_px, end_px, is_log=True)

    def __call__(self, value: float) -> float:
        """The place of a value."""
        low, high = (math.log(self.low), math.log(self.high)) if self.is_log else (self.low, self.high)
        at = (math.log(max(value, 1e-300)) if self.is_log else value) - low
        return self.start_px + min(max(at / (high - low), 0.0), 1.0) * (self.end_px - self.start_px)

    def ticks(self) -> list[tuple[float, str]]:
        """Places and words: decades, with 2 and 5 between where there are few; else whole numbers."""
        if not self.is_log:
            step = max(1, round((self.high - self.low) / 6))
            numbers = [float(n) for n in range(math.ceil(self.low), math.floor(self.high) + 1) if n % step == 0]
            return [(self(number), f"{number:g}") for number in numbers]
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        steps = (1, 2, 5) if last - first <= 3 else (1,)
        stride = max(1, (last - first) // 7)
        values = [step * 10.0**n for n in range(first, last + 1) if n % stride == 0 for step in steps]
        return [(self(value), f"{value:.0e}".replace("e-0", "e−").replace("e-", "e−").replace("e+0", "e")
                 if value < 0.01 or value >= 1000 else f"{value:g}")
                for value in values if self.low <= value <= self.high]  # fmt: skip


def line(x: Axis, y: Axis, xs: Array, ys: Array) -> str:
    """A path through the points that are there."""
    there = np.isfinite(xs) & np.isfinite(ys)
    points = [f"{x(a):.1f} {y(b):.1f}" for a, b in zip(xs[there].tolist(), ys[there].tolist(), strict=True)]
    return "M" + "L".join(points) if points else ""


def dots(x: Axis, y: Axis, xs: Array, ys: Array) -> str:
    """A path of points, which round line ends make dots of."""
    there = np.isfinite(xs) & np.isfinite(ys)
    return "".join(f"M{x(a):.1f} {y(b):.1f}h0" for a, b in zip(xs[there].tolist(), ys[there].tolist(), strict=True))


def bars(x: Axis, y: Axis, xs: Array, lows: Array, highs: Array) -> str:
    """A path of upright error bars."""
    there = np.isfinite(xs) & np.isfinite(lows) & np.isfinite(highs)
    rows = zip(xs[there].tolist(), lows[there].tolist(), highs[there].tolist(), strict=True)
    return "".join(f"M{x(a):.1f} {y(lo):.1f}V{y(hi):.1f}" for a, lo, hi in rows)
