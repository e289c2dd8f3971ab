"""A slice in a renderer's colours: light adds up, so the colour matrix converts each row of R, G, B by itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bssrdf.calib import may_have_narrow_band, slice_matrix
from bssrdf.errors import InputError
from bssrdf.session.flags import Flag
from bssrdf.session.records import Array, ChannelSlice, Session, Slice, Space

_RGB = ("R", "G", "B")
_BEYOND_NOISE = 3.0
"""Standard errors below 0 at which a row is not noise."""


def in_space(curve: Slice, session: Session, space: Space) -> Slice:
    """The curve and its totals in `space`, by the session's [colour] matrix; "camera" only says so.

    Rows that come out negative are kept. InputError where there is no matrix, or the channels are not R, G and B.
    """
    if space == "camera":
        return replace(curve, space=space)
    where = session.path / "session.toml"
    if session.colour is None:
        raise InputError(
            f"{where}: has no [colour]; take a picture of a colour chart under the same light and run "
            "`bssrdf calibrate colour` on it"
        )
    if set(curve.channels) != set(_RGB):
        raise InputError(f"{where}: --space {space} needs the channels R, G, B, not {', '.join(curve.channels)}")
    matrix = slice_matrix(np.array(session.colour.matrix), space)
    channels = _converted(_aligned(curve), matrix)
    totals, sds, lost = _totals(curve, matrix)
    if outside := [name for name, total in totals.items() if total <= 0]:
        raise InputError(
            f"{where}: R in {outside[0]} would be {totals[outside[0]]:.2g} in {space}: the colour lies outside that "
            "space; try --space acescg, or camera"
        )
    return replace(
        curve,
        channels=channels,
        total_r=totals,
        total_r_sd=sds,
        lost_fraction=lost,
        space=space,
        flags=tuple(dict.fromkeys((*curve.flags, *_flags(curve, channels)))),
        provenance={**curve.provenance, "colour": {"matrix": matrix.tolist(), "rms": session.colour.rms or "unknown"}},
    )


def _aligned(curve: Slice) -> list[ChannelSlice]:
    """The three channels with the same rows: bins that some channel has not are left out."""
    parts = [curve.channels[name] for name in _RGB]
    keys = [_keys(part) for part in parts]
    common = sorted(set.intersection(*map(set, keys)))
    if not common:
        raise InputError("R, G and B have no radius in common, so they cannot be converted")
    return [_rows(part, [key.index(row) for row in common]) for part, key in zip(parts, keys, strict=True)]


def _keys(part: ChannelSlice) -> list[tuple[int, float]]:
    """By row its side and radius, to a digit that all channels share."""
    side = np.zeros(part.r_mm.size) if part.side is None else part.side
    return [(int(s), float(f"{r:.6g}")) for s, r in zip(side, part.r_mm, strict=True)]


def _rows(part: ChannelSlice, at: list[int]) -> ChannelSlice:
    picked: dict[str, Any] = {
        name: None if (column := getattr(part, name)) is None else column[at]
        for name in ("r_mm", "rd_per_mm2", "sd_per_mm2", "r_lo_mm", "r_hi_mm", "side")
    }
    return ChannelSlice(**picked)


def _converted(parts: list[ChannelSlice], matrix: Array) -> dict[str, ChannelSlice]:
    light = matrix @ np.array([part.rd_per_mm2 for part in parts])
    sd = np.sqrt(matrix**2 @ np.array([part.sd_per_mm2 for part in parts]) ** 2)
    return {
        name: replace(part, rd_per_mm2=light[i], sd_per_mm2=sd[i])
        for i, (name, part) in enumerate(zip(_RGB, parts, strict=True))
    }


def _totals(curve: Slice, matrix: Array) -> tuple[dict[str, float], dict[str, float], dict[str, float] | None]:
    """R, its error and the share beyond the frame; none where a channel has none, for each needs all three."""
    if any(name not in curve.total_r for name in _RGB):
        return {}, {}, None
    total = np.array([curve.total_r[name] for name in _RGB])
    converted = matrix @ total
    sd = np.sqrt(matrix**2 @ np.array([curve.total_r_sd.get(name, np.nan) for name in _RGB]) ** 2)
    lost = None
    if curve.lost_fraction is not None and all(name in curve.lost_fraction for name in _RGB):
        beyond = matrix @ (total * np.array([curve.lost_fraction[name] for name in _RGB]))
        lost = _named(np.clip(beyond / converted, 0, 0.99))
    return _named(converted), _named(sd) if np.isfinite(sd).all() else {}, lost


def _named(values: Array) -> dict[str, float]:
    return dict(zip(_RGB, map(float, values), strict=True))


def _flags(curve: Slice, channels: dict[str, ChannelSlice]) -> list[Flag]:
    raised = []
    if all(name in curve.total_r for name in _RGB) and may_have_narrow_band(
        np.array([curve.total_r[name] for name in _RGB])
    ):
        raised.append(Flag.NARROW_BAND)
    if any(np.any(part.rd_per_mm2 < -_BEYOND_NOISE * part.sd_per_mm2) for part in channels.values()):
        raised.append(Flag.NEGATIVE_LIGHT)
    return raised
