"""A camera's sensor: from light on it to the numbers in a raw file. Charge in electrons, times in s."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SimSensor:
    """A mosaic sensor with linear response."""

    height_px: int = 400
    width_px: int = 600
    layout: str = "RGGB"
    """2×2 colour filter pattern, or "mono"."""
    bits: int = 14
    black_dn: int = 512
    gain_e_per_dn: float = 4.0
    read_noise_e: float = 3.0
    dark_e_per_s: float = 2.0
    hot_share: float = 2e-4
    """Share of the pixels that are hot."""
    hot_e_per_s: float = 3000.0
    """Mean dark current of a hot pixel."""
    seed: int = 1
    """Which pixels are hot: the same in every frame of one camera."""

    @property
    def shape(self) -> tuple[int, int]:
        return self.height_px, self.width_px

    @property
    def white_dn(self) -> int:
        """The value at which the converter clips."""
        return 2**self.bits - 1

    @property
    def full_well_e(self) -> float:
        """Charge that just clips."""
        return (self.white_dn - self.black_dn) * self.gain_e_per_dn


@functools.lru_cache(maxsize=4)
def dark_current(sensor: SimSensor) -> Array:
    """Dark current of each pixel [e⁻/s], (height, width): a common rate, and some hot pixels far above it."""
    rng = np.random.default_rng(sensor.seed)
    hot = rng.random(sensor.shape) < sensor.hot_share
    return sensor.dark_e_per_s + hot * rng.exponential(sensor.hot_e_per_s, sensor.shape)


def expose(
    sensor: SimSensor, light_e_per_s: Array | float, exposure_s: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """A raw frame [DN], (height, width): Poisson charge from light and dark current, read noise, gain, clipping.

    `light_e_per_s`, (height, width), is the mean photo-current of each pixel behind its colour filter.
    """
    charge = rng.poisson((light_e_per_s + dark_current(sensor)) * exposure_s)
    read = rng.normal(0.0, sensor.read_noise_e, sensor.shape)
    dn = np.rint((charge + read) / sensor.gain_e_per_dn) + sensor.black_dn
    return np.clip(dn, 0, sensor.white_dn).astype(np.uint16)


def mosaic(sensor: SimSensor, planes: dict[str, Array]) -> Array:
    """One plane, (height, width), that takes each pixel from the plane of its own filter; `planes` by channel name."""
    if sensor.layout == "mono":
        (plane,) = planes.values()
        return plane
    out = np.empty(sensor.shape)
    for position, channel in enumerate(sensor.layout):
        row, column = divmod(position, 2)
        out[row::2, column::2] = planes[channel][row::2, column::2]
    return out
