"""A slice's channels as padded arrays in the models' own convention (flux entering, exit over the hemisphere).

Lengths in mm, R_d in 1/mm². b is the number of curves, n the padded number of radii.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.transport.convention import camera_factor

RADII_FROM_SPOT = 1.5
"""In 1/e² radii of the spot: from here on the spot's blur is a correction and not the signal itself."""
BUCKETS = (64, 256, 1024, 4096, 16384)


class Curves(NamedTuple):
    """A batch of curves; a radius with weight 0 does not count, and padding has weight 0."""

    r_lo: Float[Array, " b n"]
    r_hi: Float[Array, " b n"]
    """Equal to `r_lo` where the value belongs to a radius and not to an annulus."""
    rd: Float[Array, " b n"]
    weight: Float[Array, " b n"]
    """1/sd; NaN where the sd is unknown."""
    total_r: Float[Array, " b"]
    """NaN where it was not measured."""
    total_r_sd: Float[Array, " b"]
    window: Float[Array, "b 2"]
    """Radii that may be used at all [mm]."""
    cos_view: Float[Array, " b"]
    """Of the camera's angle to the normal."""
    arc: Float[Array, " b n"]
    """Pixels of the radius lie within ± this of the line across the camera's view [rad]: π/2 is the whole circle."""
    spot_radius: Float[Array, " b"]
    """1/e² radius of the spot [mm]; 0 where it is not known."""


class Convention(NamedTuple):
    """What turns the slice's numbers into the models': value / `factor`."""

    factor: float


def convention_of(piece: Slice) -> Convention:
    """The factor between R_d as the slice has it and per entering flux over the hemisphere."""
    return Convention(
        camera_factor(
            piece.eta,
            flux=piece.flux,
            exit=piece.exit,
            view_angle_deg=piece.view_angle_deg,
            incidence_deg=piece.incidence_deg,
        )
    )


def bucket_of(n: int) -> int:
    """The padded length for n radii, so that a kernel is compiled for a few shapes only."""
    return next((size for size in BUCKETS if size >= n), n)


def stack(
    pieces: Sequence[tuple[Slice, str]],
    *,
    scale_free: bool = False,
    window_mm: tuple[float, float] | None = None,
) -> Curves:
    """Pad the named channels of the slices to one length and convert them to entering flux and the hemisphere."""
    width = bucket_of(max(len(piece.channels[name].r_mm) for piece, name in pieces))
    rows = [_row(piece, name, width, scale_free, window_mm) for piece, name in pieces]
    columns: dict[str, Any] = {key: np.stack([row[key] for row in rows]) for key in Curves._fields}
    return Curves(**columns)


def _row(
    piece: Slice, name: str, width: int, scale_free: bool, window_mm: tuple[float, float] | None
) -> dict[str, Any]:
    channel = piece.channels[name]
    factor = convention_of(piece).factor
    r_lo, r_hi = _edges(channel)
    order = np.argsort(channel.r_mm, kind="stable")  # the two sides of a slice follow one another
    weight = np.where(channel.sd_per_mm2 > 0, factor / np.where(channel.sd_per_mm2 > 0, channel.sd_per_mm2, 1), np.nan)
    return {
        "r_lo": _pad(r_lo[order], width, float(r_hi.max())),
        "r_hi": _pad(r_hi[order], width, float(r_hi.max())),
        "rd": _pad(channel.rd_per_mm2[order] / factor, width, 0.0),
        "weight": _pad(_common_unknown(weight)[order], width, 0.0),
        "total_r": np.asarray(piece.total_r.get(name, np.nan) / factor),
        "total_r_sd": np.asarray(piece.total_r_sd.get(name, np.nan) / factor),
        "window": np.asarray(_window(piece, window_mm)),
        "cos_view": np.asarray(np.cos(np.radians(piece.view_angle_deg))),
        "arc": _pad(_arc(piece, channel.r_mm)[order], width, 0.0),
        "spot_radius": np.asarray(piece.spot_radius_mm or 0.0),
    }


def _arc(piece: Slice, r_mm: np.ndarray) -> np.ndarray:
    if piece.azimuth == "mean":
        return np.full_like(r_mm, np.pi / 2)
    return np.arcsin(np.minimum(1, (piece.band_mm or 0.0) / 2 / np.maximum(r_mm, 1e-12)))


def _window(piece: Slice, window_mm: tuple[float, float] | None) -> tuple[float, float]:
    """Outside the spot; and where a camera saw a slice from an angle, outside its band: within it a few pixels hold
    the line of light scattered once."""
    lo, hi = window_mm or (0.0, np.inf)
    tilted = piece.exit == "fresnel" and piece.view_angle_deg > 0 and piece.azimuth == "perpendicular"
    band = (piece.band_mm or 0.0) if tilted else 0.0
    return max(lo, RADII_FROM_SPOT * (piece.spot_radius_mm or 0.0), band / 2), hi


def _common_unknown(weight: np.ndarray) -> np.ndarray:
    """Errors known for some radii only cannot weigh them against the others: then none is known."""
    return np.full_like(weight, np.nan) if np.isnan(weight).any() else weight


def _edges(channel: ChannelSlice) -> tuple[np.ndarray, np.ndarray]:
    if channel.r_lo_mm is None or channel.r_hi_mm is None:
        return channel.r_mm, channel.r_mm
    return channel.r_lo_mm, channel.r_hi_mm


def _pad(values: np.ndarray, width: int, fill: float) -> np.ndarray:
    return np.concatenate([values, np.full(width - len(values), fill)])
