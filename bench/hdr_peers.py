"""The tools that `bssrdf bench hdr` runs beside our merge, each given the frames as it wants them before it is timed.

Every function returns the timed part: a call without arguments that gives the radiance [DN/s], NaN where the tool gives
none. Peers that are not installed raise ImportError.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.hdr_scene import EXPOSURES_S, SENSOR, WHITE_DN, HdrScene, Plane
from bssrdf.measure import Hdr, merge
from bssrdf.rig import SimSensor, dng_bytes

Timed = Callable[[], Hdr | Plane]


def ours(scene: HdrScene) -> Timed:
    return partial(merge, scene.shots(), SENSOR)


def _above_black(scene: HdrScene) -> list[NDArray[np.uint16]]:
    """Frames without their black level; clipped where saturated, as the other tools expect."""
    black = int(SENSOR.black_dn)
    return [
        np.where(frame >= SENSOR.saturation_dn, WHITE_DN, np.maximum(frame, black) - black).astype(np.uint16)
        for frame in scene.frames
    ]


def opencv(create: str, scene: HdrScene) -> Timed:
    import cv2

    times = np.array(EXPOSURES_S, np.float32)
    linear = np.repeat(np.arange(WHITE_DN + 1, dtype=np.float32)[:, None, None], 3, axis=2)
    linear[0] = 1
    tool, frames = getattr(cv2, create)(), _above_black(scene)
    return lambda: np.asarray(tool.process(frames, times, linear), np.float32)


def colour_hdri(scene: HdrScene) -> Timed:
    import colour_hdri as tool

    stack = tool.ImageStack()
    for frame, t in zip(_above_black(scene), EXPOSURES_S, strict=True):
        metadata = tool.Metadata(np.array(1.0), np.array(t), np.array(100.0))
        stack.append(tool.Image("frame", frame.astype(np.float32) / WHITE_DN, metadata))
    at_one_second = 1 / tool.average_luminance(np.array(1.0), np.array(1.0), np.array(100.0))

    def run() -> Plane:
        merged = tool.image_stack_to_HDRI(stack, tool.weighting_function_Debevec1997)
        return np.asarray(merged * (WHITE_DN * at_one_second), np.float32)

    return run


def ccdproc(scene: HdrScene) -> Timed:
    """With saturation masked by hand: the tool has no such step. It takes planes: the channels lie side by side."""
    import ccdproc as tool
    from astropy import units
    from astropy.nddata import CCDData

    height = len(scene.radiance)

    def run() -> Plane:
        signal, seconds = [], []
        for frame, dark, t in zip(scene.frames, scene.darks, EXPOSURES_S, strict=True):
            plane = frame.reshape(height, -1)
            data, dark_data = (CCDData(x.astype(np.float32), unit=units.adu) for x in (plane, dark.reshape(height, -1)))
            exposure = t * units.second
            clean = tool.subtract_dark(
                data, dark_data, dark_exposure=exposure, data_exposure=exposure, exposure_unit=units.second
            )
            clean.mask = plane >= SENSOR.saturation_dn
            signal.append(clean)
            seconds.append(CCDData(np.full(plane.shape, t, np.float32), unit=units.second, mask=clean.mask))
        total, time_total = (tool.combine(each, method="sum") for each in (signal, seconds))
        return np.asarray(total.data / time_total.data, np.float32).reshape(scene.radiance.shape)

    return run


def hdrutils(scene: HdrScene) -> Timed:
    """On a Bayer mosaic, which is what it merges: a third of the samples, their dark signal taken off beforehand."""
    import HDRutils

    height, width, _ = scene.radiance.shape
    camera = SimSensor(
        height, width, "RGGB", bits=16, black_dn=int(SENSOR.black_dn), gain_e_per_dn=SENSOR.gain_e_per_dn
    )
    folder = TemporaryDirectory()
    files = []
    for number, (frame, dark, t) in enumerate(zip(scene.frames, scene.darks, EXPOSURES_S, strict=True)):
        above = np.where(frame >= SENSOR.saturation_dn, WHITE_DN, frame + SENSOR.black_dn - dark)
        files.append(str(Path(folder.name) / f"{number}.dng"))
        Path(files[-1]).write_bytes(dng_bytes(_bayer(np.clip(above, 0, WHITE_DN).astype(np.uint16)), camera, t))
    saturation = SENSOR.saturation_dn / WHITE_DN
    times = list(EXPOSURES_S)

    def run() -> Plane:
        with folder:
            merged = HDRutils.merge(
                files,
                demosaic_first=False,
                color_space="raw",
                saturation_percent=saturation,
                exp=times,
                gain=[1.0] * len(times),
                aperture=1,
            )[0]
        return np.where(_filters(height, width), merged, np.float32(np.nan))

    return run


def _filters(height: int, width: int) -> NDArray[np.bool_]:
    """Which channel each pixel of an RGGB mosaic sees (h, w, 3)."""
    seen = np.zeros((height, width, 3), bool)
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        seen[row::2, column::2, channel] = True
    return seen


def _bayer(frame: NDArray[np.uint16]) -> NDArray[np.uint16]:
    return np.ascontiguousarray(np.sum(frame * _filters(*frame.shape[:2]), axis=2, dtype=np.uint16))


METHODS: dict[str, Callable[[HdrScene], Timed]] = {
    "bssrdf": ours,
    "OpenCV MergeDebevec": partial(opencv, "createMergeDebevec"),
    "OpenCV MergeRobertson": partial(opencv, "createMergeRobertson"),
    "colour-hdri": colour_hdri,
    "HDRutils": hdrutils,
    "ccdproc": ccdproc,
}
