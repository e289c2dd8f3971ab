"""The flat field: what an evenly lit surface shows of lens and sensor, divided out of a merged image."""

from __future__ import annotations

import numpy as np

from bssrdf.measure.merge import NO_DATA, Hdr

_LEAST_RESPONSE = 0.05
"""A pixel that sees less than this share of its colour's mean cannot be corrected."""


def flattened(hdr: Hdr, field: Hdr, period: int) -> Hdr:
    """`hdr` divided by `field`, which is scaled to a mean of 1 in each colour; its noise is added."""
    response = np.full_like(field.radiance, np.nan)
    for row in range(period):
        for column in range(period):
            phase = (slice(row, None, period), slice(column, None, period))
            part = field.radiance[phase]
            mean = np.nanmean(np.where(field.mask[phase] == 0, part, np.nan), axis=(0, 1), keepdims=True)
            response[phase] = part / mean
    usable = (field.mask == 0) & (response > _LEAST_RESPONSE)
    response = np.where(usable, response, np.float32(1))
    relative_var = np.where(usable, field.variance / np.square(field.radiance), np.float32(0))
    radiance = hdr.radiance / response
    return Hdr(
        radiance,
        hdr.variance / response**2 + relative_var * radiance**2,
        hdr.count,
        hdr.mask | np.where(usable, np.uint8(0), np.uint8(NO_DATA)),
    )
