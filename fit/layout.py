"""From slices to the arrays of a batch: data by term, in the models' own convention. Lengths in mm, R_d in 1/mm².

b problems, u unique radii or annuli of a slice, m data on each (its two sides). A problem has one slice, or several
that are fitted together. What hangs on the data alone is done here, once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.transport.light import exit_norm, transmittance

Floats = NDArray[np.float64]

RADII_FROM_SPOT = 1.5
"""In 1/e² radii of the spot: from here on the spot's blur is a correction and not the signal itself."""
SPOT_MATTERS = 0.2
"""Of the data's relative sd: a smaller effect of the spot on the innermost radius is left out."""
WIDE = 1.15
"""r_hi/r_lo from which on an annulus is averaged over 12 nodes and not 3; either is good to 1e-6."""
BLUR_REACH = 8.0
"""In spot radii: within, the spot is averaged over 48 nodes, beyond over 12."""
FEW = 24
"""Radii that a start rests on."""
STATED_SDS = 2 / 3
"""Of all rows: where fewer state an error, none can be guessed from its neighbours."""


class Sight(NamedTuple):
    """How a slice was seen, fixed within a batch: what the model's curve has to go through."""

    camera: bool
    """Whether a camera at an angle saw the light, so that the model's own exit law counts."""
    cos_view: float
    binned: bool
    inner: int
    """Annuli, in order of radius, with 12 nodes."""
    blurred: bool
    blur_inner: int
    """Radii, in order, whose blur takes 48 nodes."""


class Curves(NamedTuple):
    """The data of one slice in each problem of a batch."""

    r_lo: Any
    r_hi: Any
    """(b, u); equal where a value belongs to a radius and not to an annulus."""
    arc: Any
    """(b, u): pixels lie within ± this of the line across the view [rad]; π/2 is the whole circle."""
    rd: Any
    known: Any
    """(b, u, m): 1/sd, 0 where there is no datum. 1 where no error is known."""
    errors_known: Any
    """(b, 1), bool."""
    window: Any
    """(b, 2): radii that may be used at all."""
    spot_radius: Any
    """(b, 1): 1/e²; 0 where it is not known."""
    few_r: Any
    few_rd: Any
    few_known: Any
    """(b, FEW): a sample of the radii, for the start."""


class Total(NamedTuple):
    """R of a slice, or of several against the same tile, (b, 1) each."""

    r: Any
    sd: Any


class Row(NamedTuple):
    """One channel of one slice, radii ascending."""

    r_lo: Floats
    r_hi: Floats
    arc: Floats
    rd: Floats
    known: Floats
    errors_known: bool
    filled: bool
    """Whether some sd were missing and taken from their neighbours."""
    window: tuple[float, float]
    spot_radius: float
    total_r: float
    total_sd: float
    """NaN where unknown; in the models' convention."""


def camera_factor(piece: Slice, *, eta: float | None = None, view_deg: float | None = None) -> float:
    """R_d as the slice has it over the models', per entering flux over the hemisphere: see `transport.convention`."""
    eta = piece.eta if eta is None else eta
    view = math.cos(math.radians(piece.view_angle_deg if view_deg is None else view_deg))
    factor = 1.0
    if piece.flux == "incident":
        factor *= float(transmittance(np, eta, math.cos(math.radians(piece.incidence_deg))))
    if piece.exit == "fresnel":
        factor *= float(transmittance(np, eta, view)) / exit_norm(eta)
    return factor


def row_of(piece: Slice, name: str, window_mm: tuple[float, float] | None) -> Row:
    """The named channel of the slice."""
    channel, factor = piece.channels[name], camera_factor(piece)
    r_lo, r_hi = edges(channel)
    order = np.flatnonzero(r_hi > 0)  # light scattered once has no value at the beam itself
    order = order[np.argsort((r_lo + r_hi)[order], kind="stable")]
    rd = channel.rd_per_mm2 / factor
    sd, errors_known, filled = _errors(channel.r_mm, rd, channel.sd_per_mm2 / factor)
    return Row(
        r_lo=r_lo[order],
        r_hi=r_hi[order],
        arc=_arc(piece, channel.r_mm)[order],
        rd=rd[order],
        known=(1 / sd)[order],
        errors_known=errors_known,
        filled=filled,
        window=_window(piece, window_mm),
        spot_radius=piece.spot_radius_mm or 0.0,
        total_r=piece.total_r.get(name, math.nan) / factor,
        total_sd=piece.total_r_sd.get(name, math.nan) / factor,
    )


def edges(channel: ChannelSlice) -> tuple[Floats, Floats]:
    """Inner and outer radius of each value, equal where it belongs to a radius."""
    if channel.r_lo_mm is None or channel.r_hi_mm is None:
        return channel.r_mm, channel.r_mm
    return channel.r_lo_mm, channel.r_hi_mm


def _errors(r_mm: Floats, rd: Floats, sd: Floats) -> tuple[Floats, bool, bool]:
    """Errors of all rows, a missing one relative as its neighbours'; whether they are known, whether any was filled."""
    stated = sd > 0
    if stated.mean() < STATED_SDS:
        return np.ones_like(rd), False, False
    if stated.all():
        return sd, True, False
    usable = stated & (rd != 0)
    order = np.flatnonzero(usable)[np.argsort(r_mm[usable], kind="stable")]
    relative = np.exp(np.interp(r_mm, r_mm[order], np.log(sd[order] / np.abs(rd[order]))))
    floor = sd[stated].min()
    return np.where(stated, sd, np.maximum(relative * np.abs(rd), floor)), True, True


def _arc(piece: Slice, r_mm: Floats) -> Floats:
    if piece.azimuth == "mean":
        return np.full_like(r_mm, np.pi / 2)
    return np.arcsin(np.minimum(1, (piece.band_mm or 0.0) / 2 / np.maximum(r_mm, 1e-12)))


def _window(piece: Slice, window_mm: tuple[float, float] | None) -> tuple[float, float]:
    """Outside the spot; and where a camera saw a slice from an angle, outside its band: within it a few pixels hold
    the line of light scattered once."""
    lo, hi = window_mm or (0.0, math.inf)
    tilted = piece.exit == "fresnel" and piece.view_angle_deg > 0 and piece.azimuth == "perpendicular"
    band = (piece.band_mm or 0.0) if tilted else 0.0
    return max(lo, RADII_FROM_SPOT * (piece.spot_radius_mm or 0.0), band / 2), hi


def spot_is_seen(row: Row) -> bool:
    """Whether the spot changes the innermost radius used by a share of its error; R_d ~ 1/r² to 1/r³ there."""
    if not row.spot_radius > 0:
        return False
    relative = float(np.median(1 / np.maximum(np.abs(row.rd * row.known), 1e-300))) if row.errors_known else 0.01
    innermost = max(float((row.r_lo + row.r_hi).min()) / 2, RADII_FROM_SPOT * row.spot_radius)
    return 9 / 8 * (row.spot_radius / innermost) ** 2 > SPOT_MATTERS * relative


def stack(rows: Sequence[Row], *, least_u: int = 0) -> Curves:
    """The rows padded to one length; radii that stand twice are looked at once."""
    folded = [_fold(row) for row in rows]
    u = max(least_u, max(f["r_lo"].size for f in folded))
    m = max(f["rd"].shape[1] for f in folded)
    out: dict[str, Any] = {}
    for key in ("r_lo", "r_hi", "arc"):
        out[key] = np.stack([_padded(f[key], u) for f in folded])
    for key in ("rd", "known"):
        out[key] = np.stack([np.pad(f[key], ((0, u - f[key].shape[0]), (0, m - f[key].shape[1]))) for f in folded])
    few = [_few(f, row.window) for f, row in zip(folded, rows, strict=True)]
    for at, key in enumerate(("few_r", "few_rd", "few_known")):
        out[key] = np.stack([each[at] for each in few])
    return Curves(
        errors_known=np.array([[row.errors_known] for row in rows]),
        window=np.array([row.window for row in rows], float),
        spot_radius=np.array([[row.spot_radius] for row in rows], float),
        **out,
    )


def sight_of(piece: Slice, rows: Sequence[Row], curves: Curves, *, blurred: bool | None = None) -> Sight:
    """What the rows, all of slices seen as `piece` was, have to go through."""
    binned = bool((curves.r_hi > curves.r_lo).any())
    blurred = any(spot_is_seen(row) for row in rows) if blurred is None else blurred
    return Sight(
        camera=piece.exit == "fresnel",
        cos_view=math.cos(math.radians(piece.view_angle_deg)),
        binned=binned,
        inner=_last(curves.r_hi > WIDE * curves.r_lo) if binned else 0,
        blurred=blurred,
        blur_inner=_last((curves.r_lo + curves.r_hi) / 2 < BLUR_REACH * curves.spot_radius) if blurred else 0,
    )


def _last(holds: NDArray[np.bool_]) -> int:
    """Columns up to the last in which any row holds."""
    at = np.flatnonzero(holds.any(axis=0))
    return int(at[-1]) + 1 if at.size else 0


def _padded(values: Floats, size: int) -> Floats:
    return np.concatenate([values, np.full(size - values.size, values[-1])])


def _fold(row: Row) -> dict[str, Floats]:
    order = np.lexsort((row.arc, row.r_hi, row.r_lo, row.r_lo + row.r_hi))
    lo, hi, arc, rd, known = (each[order] for each in (row.r_lo, row.r_hi, row.arc, row.rd, row.known))
    new = np.append(True, (np.diff(lo) != 0) | (np.diff(hi) != 0) | (np.diff(arc) != 0))
    unit = np.cumsum(new) - 1
    place = np.arange(lo.size) - np.flatnonzero(new)[unit]
    shape = (int(unit[-1]) + 1, int(place.max()) + 1)
    folded_rd, folded_known = np.zeros(shape), np.zeros(shape)
    folded_rd[unit, place], folded_known[unit, place] = rd, known
    return {"r_lo": lo[new], "r_hi": hi[new], "arc": arc[new], "rd": folded_rd, "known": folded_known}


def _few(f: dict[str, Floats], window: tuple[float, float]) -> tuple[Floats, Floats, Floats]:
    """FEW radii spread evenly over those that may count, with the mean of their data."""
    usable = (f["known"] != 0).any(axis=1) & (f["r_lo"] >= window[0]) & (f["r_hi"] <= window[1]) & (f["r_hi"] > 0)
    at = np.flatnonzero(usable)
    if not at.size:
        return np.ones(FEW), np.zeros(FEW), np.zeros(FEW)
    at = at[np.rint(np.linspace(0, at.size - 1, FEW)).astype(int)]
    weight = np.square(f["known"][at]).sum(axis=1)
    mean = (np.square(f["known"][at]) * f["rd"][at]).sum(axis=1) / weight
    return (f["r_lo"][at] + f["r_hi"][at]) / 2, mean, np.sqrt(weight)
