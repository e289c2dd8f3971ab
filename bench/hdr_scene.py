"""The scene of `bssrdf bench hdr`: thirteen exposures of 1 ms to 4.1 s, six decades of radiance, three channels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import Sensor
from bssrdf.measure import DarkPaired, Shot

Plane = NDArray[np.float32]

EXPOSURES_S = tuple(0.001 * 2**k for k in range(13))
SENSOR = Sensor(black_dn=512.0, saturation_dn=65000.0, gain_e_per_dn=1.0, read_noise_e=3.0)
WHITE_DN = 65535
DARK_E_PER_S = 2.0
DECADES = 6
_PEAK_SHARE = 0.9
"""Of the range, that the brightest pixel fills in the shortest exposure."""
_FALLOFF = (0.92, 1.0, 1.08)
"""Steepness by channel."""


@dataclass(frozen=True)
class HdrScene:
    """True radiance [DN/s] of shape (h, w, 3), the frames that show it and their dark frames."""

    radiance: Plane
    frames: list[NDArray[np.uint16]]
    darks: list[NDArray[np.uint16]]

    def shots(self) -> list[Shot]:
        """The frames as the merge takes them."""
        return [
            Shot(f"{number:02d}", t, partial(DarkPaired, frame, dark, 1))
            for number, (frame, dark, t) in enumerate(zip(self.frames, self.darks, EXPOSURES_S, strict=True))
        ]


def make_scene(height: int = 800, width: int = 1200, seed: int = 0) -> HdrScene:
    """A spot whose radiance falls by six decades towards the corners, faster in blue than in red."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    depth = DECADES * np.hypot(x, y) / np.sqrt(2)
    peak = _PEAK_SHARE * (WHITE_DN - SENSOR.black_dn) / EXPOSURES_S[0]
    radiance = np.stack([peak * 10 ** (-depth * steep) for steep in _FALLOFF], axis=-1).astype(np.float32)
    frames = [_expose(radiance, t, rng) for t in EXPOSURES_S]
    darks = [_expose(np.zeros_like(radiance), t, rng) for t in EXPOSURES_S]
    return HdrScene(radiance, frames, darks)


def _expose(radiance: Plane, exposure_s: float, rng: np.random.Generator) -> NDArray[np.uint16]:
    electrons = rng.poisson((radiance + DARK_E_PER_S) * exposure_s).astype(np.float32)
    electrons += rng.standard_normal(radiance.shape, np.float32) * SENSOR.read_noise_e
    return np.clip(np.rint(electrons / SENSOR.gain_e_per_dn) + SENSOR.black_dn, 0, WHITE_DN).astype(np.uint16)


def bound(radiance: Plane) -> Plane:
    """Least relative error of any unbiased estimate from the frames and their darks (Cramér–Rao), by pixel."""
    information = np.zeros_like(radiance)
    for t in EXPOSURES_S:
        light, dark = radiance * t / SENSOR.gain_e_per_dn, DARK_E_PER_S * t / SENSOR.gain_e_per_dn
        usable = radiance * t + DARK_E_PER_S * t + SENSOR.black_dn < SENSOR.saturation_dn
        information += usable * np.float32(t) ** 2 / (light + 2 * dark + 2 * SENSOR.read_var_dn())
    return np.asarray(1 / np.sqrt(information) / radiance, np.float32)
