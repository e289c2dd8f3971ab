"""What the sample and its mounting do to a fit that takes it for a bare half space."""

from __future__ import annotations

import math

from bssrdf.session.flags import Flag
from bssrdf.session.records import ChannelFit, Material

REACH = 3.0
"""In diffuse mean free paths 1/σtr: a sample this thick and wide loses little light through its other faces."""


def setting_flags(material: Material, channel: ChannelFit) -> tuple[str, ...]:
    """The flags that the session's `[material]` gives to a channel's fit."""
    sigma_tr = math.sqrt(3 * channel.sigma_a_per_mm * (channel.sigma_a_per_mm + channel.sigma_sp_per_mm))
    needed_mm = REACH / sigma_tr if sigma_tr > 0 else math.inf
    held = {
        Flag.NARROW_SAMPLE: material.width_mm is not None and material.width_mm / 2 < needed_mm,
        Flag.ROUGH_FINISH: material.finish == "rough",
        Flag.THIN_SAMPLE: material.thickness_mm is not None and material.thickness_mm < needed_mm,
        Flag.UNDER_GLASS: material.cover == "glass",
    }
    return tuple(name for name, holds in held.items() if holds)
