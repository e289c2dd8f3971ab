"""The sensor's noise model: what a count in DN is worth. Signals in DN above the dark frame, times in s."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_QUANTISATION_VAR_DN = 1 / 12


@dataclass(frozen=True)
class Sensor:
    """How DN follow from electrons, and where they stop to."""

    black_dn: float
    saturation_dn: float
    """A sample of this many DN or more is taken as clipped."""
    gain_e_per_dn: float
    read_noise_e: float
    black_clipped: bool = False
    """The converter cuts off at black: noise below it is lost, so that darks tell neither bias nor read noise."""

    def read_var_dn(self) -> float:
        """Variance [DN²] of one sample without light: read noise and quantisation."""
        return (self.read_noise_e / self.gain_e_per_dn) ** 2 + _QUANTISATION_VAR_DN


def master_dark(darks: list[NDArray[Any]]) -> NDArray[Any]:
    """Mean dark frame [DN] of one exposure: bias and dark current, with nothing clipped. A single one as it is."""
    if len(darks) == 1:
        return darks[0]
    total: NDArray[np.float32] = darks[0].astype(np.float32)
    for dark in darks[1:]:
        total += dark
    total /= len(darks)
    return total
