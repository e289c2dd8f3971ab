"""HDR images: our multi-part EXR with its provenance."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.atomic import atomic_write
from bssrdf.session.linear_image import OUR_PARTS, Plane

_PROVENANCE = "bssrdf:provenance"


def write_hdr_exr(path: Path, parts: Mapping[str, NDArray[Any]], provenance: Mapping[str, Any]) -> None:
    """Write `parts`, radiance, variance, count and mask, each (h, w) or (h, w, 3), as float32."""
    from bssrdf.session.oiio_file import write_exr

    planes = [(name, np.atleast_3d(np.asarray(parts[name], np.float32))) for name in OUR_PARTS]
    with atomic_write(path) as unfinished:
        write_exr(unfinished, planes, {_PROVENANCE: json.dumps(provenance, default=float)})


def read_hdr_exr(path: Path) -> tuple[dict[str, Plane], dict[str, Any]]:
    """The parts by name, each (h, w) or (h, w, 3), and the provenance; InputError where a part is missing."""
    from bssrdf.session.oiio_file import read_images

    images = {image.name: image for image in read_images(path)}
    for name in OUR_PARTS:
        if name not in images:
            raise InputError(f"{path}: lacks the part {name}; run `bssrdf measure` again")
        if images[name].data.shape[:2] != images[OUR_PARTS[0]].data.shape[:2]:
            raise InputError(f"{path}: the part {name} has another size; run `bssrdf measure` again")
    try:
        provenance = json.loads(images[OUR_PARTS[0]].attributes.get(_PROVENANCE, "{}"))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: its provenance is not JSON ({error}); run `bssrdf measure` again") from error
    return {name: _flat(images[name].data) for name in OUR_PARTS}, provenance


def _flat(data: NDArray[Any]) -> Plane:
    return data[:, :, 0] if data.shape[2] == 1 else data
