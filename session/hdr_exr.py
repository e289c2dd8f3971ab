"""HDR images: our multi-part EXR with its provenance, and linear images that other tools made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.atomic import atomic_write
from bssrdf.session.checks import shown

PARTS = ("radiance", "variance", "count", "mask")
_PROVENANCE = "bssrdf:provenance"
_LINEAR = (".exr", ".hdr", ".tif", ".tiff")

Plane = NDArray[np.float32]


def write_hdr_exr(path: Path, parts: Mapping[str, NDArray[Any]], provenance: Mapping[str, Any]) -> None:
    """Write `parts`, radiance, variance, count and mask, each (h, w) or (h, w, 3), as float32."""
    from bssrdf.session.oiio_file import write_exr

    planes = [(name, np.atleast_3d(np.asarray(parts[name], np.float32))) for name in PARTS]
    with atomic_write(path) as unfinished:
        write_exr(unfinished, planes, {_PROVENANCE: json.dumps(provenance)})


def read_hdr_exr(path: Path) -> tuple[dict[str, Plane], dict[str, Any]]:
    """The parts by name, each (h, w) or (h, w, 3), and the provenance; InputError where a part is missing."""
    from bssrdf.session.oiio_file import read_images

    images = {image.name: image for image in read_images(path)}
    for name in PARTS:
        if name not in images:
            raise InputError(f"{path}: lacks the part {name}; run `bssrdf measure` again")
        if images[name].data.shape[:2] != images[PARTS[0]].data.shape[:2]:
            raise InputError(f"{path}: the part {name} has another size; run `bssrdf measure` again")
    try:
        provenance = json.loads(images[PARTS[0]].attributes.get(_PROVENANCE, "{}"))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: its provenance is not JSON ({error}); run `bssrdf measure` again") from error
    return {name: _flat(images[name].data) for name in PARTS}, provenance


def read_linear_image(path: Path) -> Plane:
    """A merged image from elsewhere (EXR, .hdr, float TIFF), float32 of shape (h, w), or (h, w, 3) as RGB."""
    from bssrdf.session.oiio_file import read_image

    if path.suffix.lower() not in _LINEAR:
        raise InputError(f"{path}: is no EXR, .hdr or float TIFF; save the merged image as one of them")
    image = read_image(path)
    if image.data.dtype != np.float32:
        raise InputError(f"{path}: holds {image.data.dtype} pixels; save the merged image as linear float")
    if image.data.shape[2] == 1:
        return _flat(image.data)
    try:
        rgb = [image.channel_names.index(channel) for channel in "RGB"]
    except ValueError as error:
        raise InputError(
            f"{path}: has the channels {shown(image.channel_names)}; save one channel, or R, G and B"
        ) from error
    return np.ascontiguousarray(image.data[:, :, rgb])


def _flat(data: NDArray[Any]) -> Plane:
    return data[:, :, 0] if data.shape[2] == 1 else data
