"""Repeated measurements of one material: their weighted mean, and whether they agree within their stated errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple


class Combined(NamedTuple):
    """A mean of repeats; `inflation` is Birge's ratio, by which the stated errors were too small (at least 1)."""

    n: int
    mean: float
    sd: float
    """Of the mean, inflated."""
    spread: float
    """Standard deviation between the repeats; NaN of one."""
    inflation: float


def combine(values: Sequence[float], sds: Sequence[float]) -> Combined:
    """Mean weighted by 1/sd² (Birge 1932); plain where an sd is missing. Values that are NaN are left out."""
    pairs = [(value, sd) for value, sd in zip(values, sds, strict=True) if math.isfinite(value)]
    if not pairs:
        return Combined(0, math.nan, math.nan, math.nan, math.nan)
    known = all(math.isfinite(sd) and sd > 0 for _, sd in pairs)
    weights = [1 / sd**2 if known else 1.0 for _, sd in pairs]
    mean = sum(w * value for w, (value, _) in zip(weights, pairs, strict=True)) / sum(weights)
    n = len(pairs)
    if n == 1:
        return Combined(1, mean, pairs[0][1], math.nan, 1.0)
    spread = math.sqrt(sum((value - mean) ** 2 for value, _ in pairs) / (n - 1))
    if not known:
        return Combined(n, mean, spread / math.sqrt(n), spread, math.nan)
    chi2 = sum(w * (value - mean) ** 2 for w, (value, _) in zip(weights, pairs, strict=True))
    inflation = max(1.0, math.sqrt(chi2 / (n - 1)))
    return Combined(n, mean, inflation / math.sqrt(sum(weights)), spread, inflation)
