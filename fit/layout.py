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

from bssrdf.holding import held
from bssrdf.session.records import ChannelSlice, Slice
from bssrdf.transport import camera_factor
from bssrdf.transport.observed import Sight

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

RADII_FROM_SPOT = 1.5
"""In 1/e² radii of the spot: from here on the spot's blur is a correction and not the signal itself."""
SPOT_MATTERS = 0.2
"""Of the data's relative sd: a smaller effect of the spot on the innermost radius is left out."""
WIDE = 1.15
"""r_hi/r_lo from which on an annulus is averaged over 12 nodes and not 3; either is good to 1e-6."""
BLUR_REACH = 8.0
"""In spot radii: within, the spot is averaged over 48 nodes, beyond over 12."""
NODE_STEP = 16
"""Radii with many nodes are counted in steps of this, so that slices that hardly differ can share a batch."""
FEW = 24
"""Radii that a start rests on."""
STATED_SDS = 2 / 3
"""Of all rows: where fewer state an error, none can be guessed from its neighbours."""


def points_of(sight: Sight, radii: int) -> int:
    """At how many a model is looked at together, for the curve or for its blur, which is laid a few times only."""
    blur = 48 * sight.blur_inner + 12 * (radii - sight.blur_inner) if sight.blurred else 0
    return max(blur // 4, 12 * sight.inner + 3 * (radii - sight.inner) if sight.binned else radii)


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
    filled: Any
    """(b, 1), bool: whether some sd were missing and taken from their neighbours."""
    log_r: Any
    """(b, u): ln of the radius or of the middle of the annulus."""
    within: Any
    """(b, u), bool: radii that may be used at all."""
    reach: Any
    """(b, 2): the innermost and the outermost of those with data; ∞ and 0 where there are none."""
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


def factor_of(piece: Slice, **changed: float) -> float:
    """R_d as the slice has it over the models', per entering flux over the hemisphere; with some keys `changed`."""
    keys = ("eta", "flux", "exit", "view_angle_deg", "incidence_deg")
    return camera_factor(**{key: getattr(piece, key) for key in keys} | changed)


def curves_of(pieces: Sequence[Slice], names: Sequence[str], window_mm: tuple[float, float] | None) -> Curves:
    """One named channel of each slice, all in one convention: radii ascending, padded to one length; what stands twice
    is looked at once."""
    channels = [piece.channels[name] for piece, name in zip(pieces, names, strict=True)]
    size = np.array([channel.r_mm.size for channel in channels])
    there = np.arange(size.max()) < size[:, None]

    def padded(arrays: Sequence[Floats]) -> Floats:
        out = np.zeros(there.shape)
        out[there] = np.concatenate(arrays)
        return out

    factor = factor_of(pieces[0])
    r = r_lo = r_hi = padded([channel.r_mm for channel in channels])
    if any(channel.r_lo_mm is not None for channel in channels):
        r_lo, r_hi = (padded(list(each)) for each in zip(*(edges(channel) for channel in channels), strict=True))
    rd, sd = (padded([getattr(channel, key) for channel in channels]) / factor for key in ("rd_per_mm2", "sd_per_mm2"))
    known, errors_known, filled = _known(r, rd, sd, there)
    data = _Data(r_lo, r_hi, _arc(pieces, r), rd, known, there & (r_hi > 0))  # light scattered once has no value at 0
    folded = _fold(_ascending(data))
    window = np.array([_window(piece, window_mm) for piece in pieces], float)
    within = (folded.r_lo >= window[:, :1]) & (folded.r_hi <= window[:, 1:])
    usable = within & (folded.known != 0).any(axis=2)
    return Curves(
        *folded,
        errors_known=errors_known,
        filled=filled,
        log_r=np.log(np.maximum(folded.r_lo + folded.r_hi, 1e-300) / 2),
        within=within,
        reach=_reach((folded.r_lo + folded.r_hi) / 2, usable),
        spot_radius=np.array([[piece.spot_radius_mm or 0.0] for piece in pieces]),
        **_sampled(folded, usable),
    )


def total_of(pieces: Sequence[Slice], names: Sequence[str]) -> Total:
    """R of the named channel of each slice, in the models' convention; NaN where it is not known."""
    factor = factor_of(pieces[0])
    return Total(
        *(
            np.array([[getattr(p, key).get(name, math.nan)] for p, name in zip(pieces, names, strict=True)]) / factor
            for key in ("total_r", "total_r_sd")
        )
    )


def edges(channel: ChannelSlice) -> tuple[Floats, Floats]:
    """Inner and outer radius of each value, equal where it belongs to a radius."""
    if channel.r_lo_mm is None or channel.r_hi_mm is None:
        return channel.r_mm, channel.r_mm
    return channel.r_lo_mm, channel.r_hi_mm


def _known(r: Floats, rd: Floats, sd: Floats, there: Bools) -> tuple[Floats, Bools, Bools]:
    """1/sd, a missing one relative as its neighbours'; (b, 1) whether errors are known, whether any was filled."""
    stated, size = (sd > 0) & there, there.sum(1, keepdims=True)
    count = stated.sum(1, keepdims=True)
    errors_known = count >= STATED_SDS * size
    filled = errors_known & (count < size)
    for row in np.flatnonzero(filled):
        at = there[row]
        sd[row, at] = _filled(r[row, at], rd[row, at], sd[row, at])
    known = np.where(errors_known, 1 / np.where(there, sd, 1.0), 1.0)
    return np.where(there, known, 0.0), errors_known, filled


def _filled(r_mm: Floats, rd: Floats, sd: Floats) -> Floats:
    stated = sd > 0
    usable = stated & (rd != 0)
    order = np.flatnonzero(usable)[np.argsort(r_mm[usable], kind="stable")]
    relative = np.exp(np.interp(r_mm, r_mm[order], np.log(sd[order] / np.abs(rd[order]))))
    return np.where(stated, sd, np.maximum(relative * np.abs(rd), sd[stated].min()))


def _arc(pieces: Sequence[Slice], r_mm: Floats) -> Floats:
    whole = np.array([[piece.azimuth == "mean"] for piece in pieces])
    band = np.array([[piece.band_mm or 0.0] for piece in pieces])
    if not band.any() and not whole.any():
        return np.zeros_like(r_mm)
    return np.where(whole, np.pi / 2, np.arcsin(np.minimum(1, band / 2 / np.maximum(r_mm, 1e-12))))


def _window(piece: Slice, window_mm: tuple[float, float] | None) -> tuple[float, float]:
    """Outside the spot; and where a camera saw a slice from an angle, outside its band: within it a few pixels hold
    the line of light scattered once."""
    lo, hi = window_mm or (0.0, math.inf)
    tilted = piece.exit == "fresnel" and piece.view_angle_deg > 0 and piece.azimuth == "perpendicular"
    band = (piece.band_mm or 0.0) if tilted else 0.0
    return max(lo, RADII_FROM_SPOT * (piece.spot_radius_mm or 0.0), band / 2), min(hi, held(piece).reach)


class NodeCounts(NamedTuple):
    """What each row of a batch asks for by itself, (b,) each: see the fields of `Sight`."""

    blurred: NDArray[np.bool_]
    inner: NDArray[np.int_]
    blur_inner: NDArray[np.int_]


def nodes_of(curves: Curves) -> NodeCounts:
    """How finely each row's radii are averaged, whatever the rows beside it."""
    there = (curves.known != 0).any(axis=2)
    middle = (curves.r_lo + curves.r_hi) / 2
    return NodeCounts(
        _spot_is_seen(curves),
        _last(there & (curves.r_hi > WIDE * curves.r_lo)),
        _last(there & (middle < BLUR_REACH * curves.spot_radius)),
    )


def _spot_is_seen(c: Curves) -> NDArray[np.bool_]:
    """Whether a spot changes the innermost radius used by a share of its error; R_d ~ 1/r² to 1/r³ there."""
    if not c.spot_radius.any():
        return np.zeros(c.spot_radius.shape[0], bool)
    relative = np.where(
        c.errors_known[:, 0], median_of(1 / np.maximum(np.abs(c.rd * c.known), 1e-300), c.known != 0), 0.01
    )
    innermost = np.maximum((c.r_lo + c.r_hi).min(axis=1) / 2, RADII_FROM_SPOT * c.spot_radius[:, 0])
    wide = np.where(c.spot_radius[:, 0] > 0, 9 / 8 * (c.spot_radius[:, 0] / innermost) ** 2, 0.0)
    return np.asarray(wide > SPOT_MATTERS * relative)


def median_of(values: Floats, counts: Bools) -> Floats:
    """Of the values of each row that count, (b,); np.nanmedian would load NumPy's masked arrays first."""
    b = values.shape[0]
    ordered = np.sort(np.where(counts, values, np.inf).reshape(b, -1), axis=1)
    n, rows = counts.reshape(b, -1).sum(axis=1), np.arange(b)
    return (ordered[rows, np.maximum(n - 1, 0) // 2] + ordered[rows, n // 2]) / 2


def sight_of(piece: Slice, curves: Curves, *, blurred: bool | None = None) -> Sight:
    """What the curves, all of slices seen as `piece` was, have to go through."""
    binned = bool((curves.r_hi > curves.r_lo).any())
    nodes, size = nodes_of(curves), curves.r_lo.shape[1]
    blurred = bool(nodes.blurred.any()) if blurred is None else blurred
    return Sight(
        camera=piece.exit == "fresnel",
        cos_view=math.cos(math.radians(piece.view_angle_deg)),
        slant=math.sin(math.radians(piece.view_angle_deg)) * math.sin(math.radians(piece.incidence_deg)) / piece.eta**2,
        binned=binned,
        inner=min(int(nodes.inner.max()), size) if binned else 0,
        blurred=blurred,
        blur_inner=min(int(nodes.blur_inner.max()), size) if blurred else 0,
        held=held(piece).kind,
    )


def _last(holds: Bools) -> NDArray[np.int_]:
    """Columns up to the last in which a row holds, in steps of NODE_STEP."""
    last = np.where(holds.any(axis=1), holds.shape[1] - np.argmax(holds[:, ::-1], axis=1), 0)
    return NODE_STEP * -(-last // NODE_STEP)


class _Data(NamedTuple):
    """Padded rows, (b, n) each."""

    r_lo: Floats
    r_hi: Floats
    arc: Floats
    rd: Floats
    known: Floats
    there: Bools


class _Folded(NamedTuple):
    """The first fields of Curves."""

    r_lo: Floats
    r_hi: Floats
    arc: Floats
    rd: Floats
    known: Floats


def _ascending(data: _Data) -> _Data:
    """By radius, what is not there last; a slice that is so already, as most are, is not sorted anew."""
    middle = np.where(data.there, data.r_lo + data.r_hi, np.inf)
    if ((middle[:, 1:] > middle[:, :-1]) | np.isinf(middle[:, 1:])).all():
        return data
    order = np.lexsort((data.arc, data.r_hi, data.r_lo, middle))
    turned: Any = (np.take_along_axis(each, order, axis=1) for each in data)
    return _Data(*turned)


def _fold(data: _Data) -> _Folded:
    """Equal radii as one, with all their data."""
    differs = [each[:, 1:] != each[:, :-1] for each in (data.r_lo, data.r_hi, data.arc)]
    new = data.there.copy()
    new[:, 1:] &= differs[0] | differs[1] | differs[2]
    if new.all():
        return _Folded(data.r_lo, data.r_hi, data.arc, data.rd[..., None], data.known[..., None])
    unit = np.maximum(np.cumsum(new, axis=1) - 1, 0)
    first = np.maximum.accumulate(np.where(new, np.arange(new.shape[1]), 0), axis=1)
    place = np.arange(new.shape[1]) - first
    rows, columns = np.nonzero(data.there)
    at = (rows, unit[rows, columns], place[rows, columns])
    b, u, m = new.shape[0], int(unit.max()) + 1, int(place[data.there].max(initial=0)) + 1
    last = np.maximum(new.sum(1) - 1, 0)
    out = []
    for each in (data.r_lo, data.r_hi, data.arc):
        unique = np.zeros((b, u))
        unique[at[:2]] = each[rows, columns]
        out.append(np.where(np.arange(u) > last[:, None], unique[np.arange(b), last][:, None], unique))
    for each in (data.rd, data.known):
        folded = np.zeros((b, u, m))
        folded[at] = each[rows, columns]
        out.append(folded)
    return _Folded(*out)


def _reach(r: Floats, usable: Bools) -> Floats:
    return np.stack([np.where(usable, r, np.inf).min(1), np.where(usable, r, 0.0).max(1)], axis=1)


def _sampled(f: _Folded, usable: Bools) -> dict[str, Floats]:
    """FEW radii of each row spread evenly over those that may count, with the mean of their data."""
    count = usable.sum(1, keepdims=True)
    rank = np.rint(np.maximum(count - 1, 0) * np.linspace(0, 1, FEW)).astype(int)
    at = np.take_along_axis(np.argsort(~usable, axis=1, kind="stable"), rank, axis=1)
    known, rd = (np.take_along_axis(each, at[..., None], axis=1) for each in (f.known, f.rd))
    weight = np.square(known).sum(2)
    some = count > 0
    return {
        "few_r": np.where(some, np.take_along_axis(f.r_lo + f.r_hi, at, axis=1) / 2, 1.0),
        "few_rd": np.where(some, (np.square(known) * rd).sum(2) / np.where(weight > 0, weight, 1.0), 0.0),
        "few_known": np.where(some, np.sqrt(weight), 0.0),
    }
