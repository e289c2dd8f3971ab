"""Merged images with what merging told beside them: kept in measured/, so that a curve can be read from them again."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.calib.frame_model import Exposures
from bssrdf.errors import InputError
from bssrdf.measure.curve import Timing
from bssrdf.measure.merge import Hdr
from bssrdf.session.hdr_image import read_hdr_exr, write_hdr_exr
from bssrdf.session.plain import from_plain, to_plain
from bssrdf.session.records import Frame, Session

_TOLD = "told"


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

    images: dict[str, Hdr]
    told: Told
    provenance: dict[str, Any]

    def write(self, folder: Path) -> None:
        """Write each image with all of this into `folder`."""
        for kind, hdr in self.images.items():
            write_hdr_exr(folder / f"{kind}.exr", vars(hdr), {**self.provenance, _TOLD: to_plain(self.told)})


def inputs_of(session: Session, frames: Sequence[Frame]) -> str:
    """Digest of what the images of a session depend on, the frames' own bytes left out."""
    lines = sorted(json.dumps(asdict(replace(frame, utc=None, sha256=None))) for frame in frames)
    camera = asdict(replace(session.camera, aperture_mm=0.0))  # it changes no image
    return sha256(json.dumps([lines, camera], sort_keys=True).encode()).hexdigest()


def read_merged(session: Session, frames: Sequence[Frame], kinds: Sequence[str]) -> Merged:
    """What an earlier `measure` of the session wrote; InputError where it is not there, or of other frames."""
    read = {kind: _read(session.path / "measured" / f"{kind}.exr") for kind in kinds}
    path = session.path / "measured" / f"{kinds[0]}.exr"
    provenance = read[kinds[0]][1]
    for kind in kinds:
        if read[kind][1] != provenance:
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
    return Merged({kind: hdr for kind, (hdr, _) in read.items()}, told, provenance)


def _stale(path: Path, reason: str) -> InputError:
    return InputError(f"{path}: {reason}; run `bssrdf measure` without --from-hdr")


def _read(path: Path) -> tuple[Hdr, dict[str, Any]]:
    if not path.is_file():
        raise _stale(path, "is not there")
    parts, provenance = read_hdr_exr(path)
    return Hdr(parts["radiance"], parts["variance"], _bits(parts["count"]), _bits(parts["mask"])), provenance


def _bits(plane: NDArray[np.float32]) -> NDArray[Any]:
    """Small whole numbers, as they were before they were written as floats."""
    return plane.astype(np.uint8 if plane.max(initial=0) < 2**8 else np.uint16)
