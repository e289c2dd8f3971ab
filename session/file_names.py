"""What a file's name says about its frame."""

from __future__ import annotations

import re

_EXPOSURE = re.compile(r"(?<![^_\-\s])(\d+(?:\.\d+)?)(ms|s)(?=[_\-\s.]|$)")


def exposure_from_name(name: str) -> float | None:
    """Exposure time [s] in a name such as `…_250ms_…` or `…_0.25s…`; None where there is none, or more than one."""
    times = {float(value) / (1000 if unit == "ms" else 1) for value, unit in _EXPOSURE.findall(name)}
    return times.pop() if len(times) == 1 and min(times) > 0 else None
