"""From a session's frames to merged images, and from these to the slice and the total reflectance.

The names below are imported when first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_HOME = {
    "calibrate_camera": "calibrate",
    "radius_of_edge": "calibrate",
    "radius_on_target": "calibrate",
    "MEANING": "flags",
    "Hdr": "hdr",
    "Progress": "hdr",
    "Sample": "hdr",
    "Shot": "hdr",
    "merge": "hdr",
    "Image": "image",
    "Measured": "session",
    "measure_session": "session",
    "Options": "slice",
    "measure_slice": "slice",
}

if TYPE_CHECKING:
    from bssrdf.measure.calibrate import calibrate_camera as calibrate_camera
    from bssrdf.measure.calibrate import radius_of_edge as radius_of_edge
    from bssrdf.measure.calibrate import radius_on_target as radius_on_target
    from bssrdf.measure.flags import MEANING as MEANING
    from bssrdf.measure.hdr import Hdr as Hdr
    from bssrdf.measure.hdr import Progress as Progress
    from bssrdf.measure.hdr import Sample as Sample
    from bssrdf.measure.hdr import Shot as Shot
    from bssrdf.measure.hdr import merge as merge
    from bssrdf.measure.image import Image as Image
    from bssrdf.measure.session import Measured as Measured
    from bssrdf.measure.session import measure_session as measure_session
    from bssrdf.measure.slice import Options as Options
    from bssrdf.measure.slice import measure_slice as measure_slice


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(_HOME)
