"""What the frames tell of their own sensor: gain, read noise, saturation, hot pixels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.photon_transfer import Gain, clipped_variance, pair_gain, read_noise_dn
from bssrdf.calib.sensor import Sensor
from bssrdf.measure.bracket import Bracket
from bssrdf.session.frame_files import read_frame_file
from bssrdf.session.records import Camera, Frame

_MARGIN = 0.01
"""Samples this close to saturation, as a share of the range, are taken as clipped: response bends there."""
_MAX_PIXELS = 400_000
_HOT_SD = 8.0
_CLIPPED_SHARE = 0.3
"""Share of a dark's pixels at its lowest value above which the camera clips at black."""


class Learnt(NamedTuple):
    """A sensor model and what was found on the way."""

    sensor: Sensor
    hot: NDArray[np.bool_]
    flags: tuple[str, ...]


def learn_sensor(brackets: Sequence[Bracket], camera: Camera) -> Learnt:
    """Complete the sensor model of `camera` from the frames."""
    darks = [bracket.darks[0] for bracket in brackets]
    folder = brackets[0].folder
    first = [read_frame_file(folder / dark.file).data for dark in max(darks, key=len)[:2]]
    black = camera.black if camera.black is not None else float(np.median(first[0]))
    noise_dn = read_noise_dn(first[0], first[1] if len(first) > 1 else None)
    saturation = float(camera.white or np.inf)
    saturation -= _MARGIN * (saturation - black) if np.isfinite(saturation) else 0.0

    gain = camera.gain_e_per_dn
    flags = []
    if gain is None:
        estimate = _gain(brackets, saturation, max(noise_dn**2, 1 / 12))
        gain = estimate.e_per_dn if estimate else 1.0
        if not estimate:
            flags.append("gain_unknown")
    read_noise_e = camera.read_noise_e if camera.read_noise_e is not None else noise_dn * gain
    clipped = float(np.mean(first[0] <= np.min(first[0]))) > _CLIPPED_SHARE
    return Learnt(Sensor(black, saturation, gain, read_noise_e, clipped), _hot(brackets), tuple(flags))


def _gain(brackets: Sequence[Bracket], saturation: float, read_var_dn: float) -> Gain | None:
    """Gain by photon transfer between neighbours of the brackets."""
    gains = []
    for bracket in brackets:
        before = None
        for shot in bracket.shots(bracket.exposures_s()):
            sample = shot.load()
            signal = sample.raw - sample.dark.astype(np.float32)
            good = sample.raw < saturation
            if before is not None:
                both = good & before[1] & (before[0] > 0) & (signal > 30 * np.sqrt(read_var_dn))
                a, b = before[0][both].astype(float), signal[both].astype(float)
                thin = max(1, a.size // _MAX_PIXELS)
                gains.append(pair_gain(a[::thin], b[::thin], read_var_dn * (1 + 1 / sample.n_darks)))
            before = signal, good
    found = [gain for gain in gains if gain]
    if not found:
        return None
    weights = [1 / gain.rel_sd**2 for gain in found]
    inverse = np.average([1 / gain.e_per_dn for gain in found], weights=weights)
    return Gain(float(1 / inverse), float(np.sum(weights) ** -0.5))


def _hot(brackets: Sequence[Bracket]) -> NDArray[np.bool_]:
    """Pixels whose dark signal in the longest exposure stands far out."""
    longest: Frame = max((bracket.darks[-1][0] for bracket in brackets), key=lambda dark: dark.exposure_s)
    dark = read_frame_file(brackets[0].folder / longest.file).data.astype(np.float32)
    excess = dark - np.median(dark)
    return excess > _HOT_SD * max(np.sqrt(clipped_variance(excess.astype(float).ravel())), 0.5)
