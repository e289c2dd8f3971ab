"""Sessions of one sample under several view angles: does what leaves it follow the exit law?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bssrdf.errors import InputError
from bssrdf.session.records import Array, Slice
from bssrdf.transport import camera_factor


@dataclass(frozen=True)
class ViewComparison:
    """One channel under several angles, as the same model quantity: entering flux, hemispherical exit."""

    view_angle_deg: tuple[float, ...]
    r_mm: Array
    """Radii that all slices reach."""
    rd_over_mean: Array
    """(angles, radii): each curve over the mean of all; 1 where the exit law holds."""
    total_r: tuple[float, ...]
    """NaN where a slice has none."""


def compare_views(slices: Sequence[Slice], channel: str) -> ViewComparison:
    """Take the camera's factor off each slice and compare them; InputError for fewer than two."""
    if len(slices) < 2:
        raise InputError(f"{len(slices)} slice has nothing to be compared with; give two or more view angles")
    for curve in slices:
        if channel not in curve.channels:
            raise InputError(f"channel {channel} is not in every slice; it must be one of {', '.join(curve.channels)}")
    factors = [
        camera_factor(
            curve.eta,
            flux=curve.flux,
            exit=curve.exit,
            view_angle_deg=curve.view_angle_deg,
            incidence_deg=curve.incidence_deg,
        )
        for curve in slices
    ]
    parts = [curve.channels[channel] for curve in slices]
    first = max(part.r_mm.min() for part in parts)
    last = min(part.r_mm.max() for part in parts)
    r = np.unique(parts[0].r_mm)
    r = r[(r >= first) & (r <= last)]
    if not r.size:
        raise InputError(f"channel {channel} has no radius that all slices reach; compare slices of one sample")
    curves = []
    for part, factor in zip(parts, factors, strict=True):
        order = np.argsort(part.r_mm)
        curves.append(np.interp(r, part.r_mm[order], part.rd_per_mm2[order]) / factor)
    values = np.array(curves)
    return ViewComparison(
        tuple(curve.view_angle_deg for curve in slices),
        r,
        values / values.mean(axis=0),
        tuple(curve.total_r.get(channel, np.nan) / factor for curve, factor in zip(slices, factors, strict=True)),
    )


def views_text(slices: Sequence[Slice]) -> str:
    """For each channel and angle: the curve over the mean of all angles, and R as the model has it."""
    lines = []
    for channel in slices[0].channels:
        found = compare_views(slices, channel)
        lines.append(f"{channel}: {found.r_mm[0]:.3g} to {found.r_mm[-1]:.3g} mm, the camera's factor taken off")
        for angle, curve, total in zip(found.view_angle_deg, found.rd_over_mean, found.total_r, strict=True):
            low, middle, high = np.percentile(curve, (5, 50, 95))
            lines.append(
                f"  {angle:g}°: {middle:.3f} of the mean ({low:.3f} to {high:.3f} over the radii), R {total:.4f}"
            )
    return "\n".join(lines)
