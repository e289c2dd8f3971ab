"""Images that are merged already: by an earlier `measure` of the session, or by another tool.

Beside our own, in measured/, stands what merging told, so that a curve can be read from them again. Those of another
tool are linear, of unknown exposure and noise.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.calib import Exposures, pile_up_dn
from bssrdf.errors import InputError
from bssrdf.measure.hdr import NO_DATA, SATURATED, Hdr, Plane, Planes
from bssrdf.measure.pixels import check_picture, mosaic_period, places
from bssrdf.measure.stored import StoredHdr
from bssrdf.measure.summary import Summary, read_summary, write_summary
from bssrdf.measure.total_errors import Timing
from bssrdf.session import OUR_PARTS, from_plain, read_linear_image, to_plain, write_hdr_exr
from bssrdf.session.records import Camera, Frame, Session

_TOLD = "told"
_NEIGHBOURHOOD = 9
_LEAST_ON_TOP, _PILED, _JUST_BELOW = 4, 4.0, 0.01
"""So many pixels of the very same largest value, and so many times those within this share below it, were cut off."""
_BRIGHT_EDGE = 0.05
"""Share of the brightest pixel: what leaves a spot's surroundings at this level is more than is put back."""


class StaleImages(InputError):
    """The images are not there, or not of the session's frames as they are now."""


@dataclass(frozen=True)
class Told:
    """What merging told, beside the images."""

    layouts: dict[str, str]
    """By kind of image."""
    timing: dict[str, Timing]
    """By kind; of images merged elsewhere there is none."""
    exposures: Exposures
    flags: tuple[str, ...]
    inputs: str
    """Digest of the lines of frames.csv and of [camera], as they were."""


@dataclass(frozen=True)
class Merged:
    """The images by kind, what merging told, and where it comes from."""

    images: dict[str, Planes]
    told: Told
    provenance: dict[str, Any]
    summaries: dict[str, Summary] = field(default_factory=dict)
    """Of the images that were read, as far as they are known."""

    def write(self, folder: Path) -> None:
        """Write each image with all of this into `folder`."""
        for kind, hdr in self.images.items():
            parts = {part: getattr(hdr, part) for part in OUR_PARTS}
            write_hdr_exr(folder / f"{kind}.exr", parts, {**self.provenance, _TOLD: to_plain(self.told)})


def write_summaries(folder: Path, summaries: Mapping[str, Summary]) -> None:
    """Write beside each image what it tells without its pixels."""
    for kind, summary in summaries.items():
        write_summary(folder / f"{kind}.npz", summary, folder / f"{kind}.exr")


def inputs_of(session: Session, frames: Sequence[Frame]) -> str:
    """Digest of what the images of a session depend on, the frames' own bytes left out."""
    lines = sorted(json.dumps(asdict(replace(frame, utc=None, sha256=None))) for frame in frames)
    camera = asdict(replace(session.camera, aperture_mm=0.0))  # it changes no image
    return sha256(json.dumps([lines, camera], sort_keys=True).encode()).hexdigest()


def read_merged(session: Session, frames: Sequence[Frame], kinds: Sequence[str]) -> Merged:
    """What an earlier `measure` of the session wrote; InputError where it is not there, or of other frames."""
    paths = {kind: session.path / "measured" / f"{kind}.exr" for kind in kinds}
    read = {kind: _read(path) for kind, path in paths.items()}
    path, provenance = paths[kinds[0]], dict(read[kinds[0]].provenance)
    for kind in kinds:
        if read[kind].provenance != provenance:
            raise _stale(session.path / "measured" / f"{kind}.exr", f"comes from another run than {path.name}")
    try:
        told = from_plain(Told, provenance.pop(_TOLD))
        hashes = dict(provenance["sha256"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _stale(path, "does not say how it was merged") from error
    if told.inputs != inputs_of(session, frames):
        raise _stale(path, "was made before frames.csv or [camera] changed")
    for frame in frames:
        if frame.sha256 is not None and frame.sha256 != hashes.get(frame.file):
            raise _stale(path, f"was made from another {frame.file}")
    known = {kind: read_summary(path.with_suffix(".npz"), path) for kind, path in paths.items()}
    return Merged(dict(read), told, provenance, {kind: summary for kind, summary in known.items() if summary})


def _stale(path: Path, reason: str) -> StaleImages:
    return StaleImages(f"{path}: {reason}; run `bssrdf measure` without --from-hdr")


def _read(path: Path) -> StoredHdr:
    if not path.is_file():
        raise _stale(path, "is not there")
    return StoredHdr(path)


def read_elsewhere(
    session: Session, frames: Sequence[Frame], rel_sd: float | None = None
) -> tuple[dict[str, Hdr], Camera]:
    """The images of kind sample_hdr and reference_hdr as sample and reference, and the camera with their layout.

    `rel_sd` is the relative error of a pixel, where it is known; else the scatter tells it.
    """
    images: dict[str, Hdr] = {}
    camera = session.camera
    for frame in frames:
        kind, _, suffix = frame.kind.partition("_")
        if suffix != "hdr":
            continue
        if kind in images or any(other.kind == kind for other in frames):
            raise InputError(f"{frame.file}: is one of several images of the {kind}; leave one in frames.csv")
        radiance = read_linear_image(session.path / frame.file)
        check_picture(frame.file, radiance)
        _check_light_is_inside(frame, radiance)
        layout = "rgb" if radiance.ndim == 3 else session.camera.layout or frame.card.layout or "mono"
        if images and layout != camera.layout:
            raise InputError(
                f"{frame.file}: has the layout {layout}, the image before {camera.layout}; merge both alike"
            )
        camera = replace(camera, layout=layout)
        images[kind] = _with_variance(radiance, mosaic_period(layout), rel_sd)
    return images, camera


def _check_light_is_inside(frame: Frame, radiance: Plane) -> None:
    """InputError where it is bright beside pixels without data: the data window of the file cuts off the spot."""
    light = radiance if radiance.ndim == 2 else radiance.sum(2)
    usable = np.isfinite(light)
    near = np.ones((3, 3), np.uint8)
    without_data = cv2.morphologyEx((~usable).astype(np.uint8), cv2.MORPH_OPEN, near)  # single pixels are not a window
    beside = usable & (cv2.dilate(without_data, near) > 0)
    if beside.any() and light[beside].max() > _BRIGHT_EDGE * light[usable].max():
        raise InputError(f"{frame.file}: its data window cuts through the spot; save the whole picture")


def _with_variance(radiance: Plane, period: int, rel_sd: float | None) -> Hdr:
    """The image with its variance, given or by its own scatter; pixels that are not numbers have no data.

    Where values pile up at the end of a channel, the tool that merged it had no exposure short enough.
    """
    usable = np.isfinite(radiance)
    numbers = np.nan_to_num(radiance, posinf=0.0, neginf=0.0)
    return Hdr(
        np.where(usable, radiance, np.float32(np.nan)),
        scatter_variance(numbers, period) if rel_sd is None else np.square(np.float32(rel_sd) * numbers),
        usable.astype(np.uint16),
        np.where(usable, np.uint8(0), np.uint8(NO_DATA)) | _clipped(numbers, period) * np.uint8(SATURATED),
    )


def _clipped(image: Plane, period: int) -> NDArray[np.bool_]:
    """Pixels at the end of a channel where values pile up, and in others that end at the very same value."""
    at_places = places(image.shape, period)
    ends = [_end_of_pile(image[at]) for at in at_places]
    limits = {float(image[at].max()) for at, end in zip(at_places, ends, strict=True) if np.isfinite(end)}
    clipped = np.zeros(image.shape, bool)
    for at, end in zip(at_places, ends, strict=True):
        top = float(image[at].max())
        clipped[at] = image[at] >= min(end, top if top in limits else np.inf)
    return clipped


def _end_of_pile(values: Plane) -> float:
    """The value from which a channel's values pile up; infinity where they do not."""
    end, top = pile_up_dn(values, 0.0, 0.0), float(values.max())
    on_top = np.count_nonzero(values == top)
    below = np.count_nonzero(values > (1 - _JUST_BELOW) * top) - on_top
    if end is None:
        return top if on_top >= _LEAST_ON_TOP and on_top > _PILED * (1 + below) else np.inf
    return end


def scatter_variance(image: Plane, period: int) -> Plane:
    """Variance of the noise by how far pixels lie from the mean of their four neighbours of the same colour."""
    around = np.zeros((2 * period + 1, 2 * period + 1), np.float32)
    around[[0, -1, period, period], [period, period, 0, -1]] = 0.25
    residual = image - cv2.filter2D(image, cv2.CV_32F, around, borderType=cv2.BORDER_REFLECT_101)
    square = np.square(residual) / np.float32(1 + 1 / 4)
    size = _NEIGHBOURHOOD * period
    mean = cv2.blur(square, (size, size), borderType=cv2.BORDER_REFLECT_101)
    return np.maximum(np.asarray(mean, np.float32), 0)  # its running sum rounds below 0 beside a bright spot
