"""What is said of a finite sample: how deep it is, what its back and walls do, when σa cannot be told from them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.fit.batch import Fitted
from bssrdf.fit.problem import held_any
from bssrdf.holding import Held, assumed, held
from bssrdf.session.flags import Flag
from bssrdf.session.records import Slice
from bssrdf.transport.sample_light import SampleRatio

NAN = float("nan")
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
BRIGHT = 0.6
"""Of a half space's R: from here on σa hangs on the light that comes back from the depth."""
THIN, THIN_ON_BLACK = 4.0, 8.0
"""τ′ down to which the ratio holds: dark media and bright ones on a white back; bright ones on a black back."""
LOST, LOST_ON_BLACK = 4.0, 6.0
"""τ′ below which σa is off by more than its errors say, in media that are not surely dark."""
DARK = 0.4
"""Of a half space's R: σa that comes out far too high makes a bright medium look this much darker."""
NARROW = 12.0
"""Mean free paths to a dish's wall: at 10.5 σa of skim milk comes out 13 % too high, at 17.5 right."""
REACH = 3.0
"""In diffuse mean free paths 1/σtr: as deep and wide a sample loses little light where nothing is allowed for."""
MOST_UNKNOWN = 0.5
"""Of σa: more error than this from depth, back and ratio together leaves nothing to state."""


class InSample(NamedTuple):
    """Of one row; NaN where its slices are of half spaces."""

    tau_p: float
    log_total: float
    """ln of R over that of a half space."""
    least_ratio: float
    """Of the curve to a half space's, at the radii used."""
    flags: Mapping[str, bool]


def in_samples(fitted: Fitted, *, share: Floats, rel_sd: Floats, off: Floats) -> list[InSample]:
    """From each row's optimum; `rel_sd` of σa with the `share` of its variance that depth and back have, `off` its
    relative model error."""
    said = [any(_told(piece) for piece in job.pieces) for job in fitted.jobs]
    nothing = InSample(NAN, NAN, NAN, {})
    every = zip(said, share.tolist(), rel_sd.tolist(), off.tolist(), strict=True)
    return [_in_sample(fitted, row, *of_row) if told else nothing for row, (told, *of_row) in enumerate(every)]


def _in_sample(fitted: Fitted, row: int, share: float, rel_sd: float, off: float) -> InSample:
    pieces, channel = fitted.jobs[row].pieces, fitted.jobs[row].channel
    sigma_tp = math.exp(float(fitted.found.point.log_sigma[row, 0]))
    q, half_space = float(fitted.found.point.q[row, 0]), float(fitted.judged.seen.half[row, 0])
    every, bright = [held(piece) for piece in pieces], half_space >= BRIGHT
    finite = any(one.kind != "half" for one in every)
    thin = any(_thin(one, sigma_tp, bright, THIN, THIN_ON_BLACK) for one in every)
    narrow = any(one.kind == "dish" and one.radius * sigma_tp < NARROW for one in every)
    unknown = bright and math.hypot(math.sqrt(share) * rel_sd, off) > MOST_UNKNOWN
    lost = half_space >= DARK and any(_thin(one, sigma_tp, True, LOST, LOST_ON_BLACK) for one in every)
    needed = REACH / (q * sigma_tp) if q > 0 else math.inf
    flags: dict[str, bool] = {
        Flag.BACK_DECIDES: finite and share > 0.5,
        Flag.BACKING_ASSUMED: any(assumed(piece)[1] for piece in pieces),
        Flag.BACKING_UNKNOWN: any(
            isinstance(piece.backing, str) and piece.backing not in ("black", "air") for piece in pieces
        ),
        Flag.BEYOND_WALL: any(
            piece.width_mm is not None and (piece.channels[channel].r_mm > piece.width_mm / 2).any() for piece in pieces
        ),
        Flag.FINITE_SAMPLE: finite and not thin and not narrow,
        Flag.NARROW_SAMPLE: narrow or _left_out(pieces, "width_mm", "radius", 2 * needed),
        Flag.SIGMA_A_UNIDENTIFIABLE: finite and (lost or unknown),
        Flag.THICKNESS_ASSUMED: any(assumed(piece)[0] for piece in pieces),
        Flag.THIN_SAMPLE: thin or _left_out(pieces, "thickness_mm", "thickness", needed),
        Flag.UNDER_GLASS: any(piece.cover == "glass" for piece in pieces),
    }
    effects = [
        _effect(laid, used, row)
        for laid, used in zip(fitted.found.laid.samples, fitted.judged.used, strict=True)
        if laid
    ]
    depths = [one.thickness * sigma_tp for one in every if one.thickness < math.inf]
    log_totals, ratios = zip(*effects, strict=True) if effects else ((), ())
    return InSample(min(depths, default=NAN), min(log_totals, default=NAN), min(ratios, default=NAN), flags)


def thin_rows(fitted: Fitted) -> Bools:
    """Rows whose ratio itself may be off by more than the data: then no misfit is held against anything else."""
    sigma_tp = np.exp(fitted.found.point.log_sigma[:, 0])
    if not held_any(fitted.plan):
        return np.zeros(sigma_tp.size, bool)
    depths = np.array([min(held(piece).thickness for piece in job.pieces) for job in fitted.jobs])
    return np.asarray(depths * sigma_tp < THIN_ON_BLACK)


def _told(piece: Slice) -> bool:
    """Whether the slice says anything of its sample's bounds."""
    return (piece.thickness_mm, piece.width_mm, piece.backing, piece.cover) != (None, None, None, "none")


def _thin(one: Held, sigma_tp: float, bright: bool, least: float, on_black: float) -> bool:
    return one.thickness * sigma_tp < (on_black if bright and one.on_black else least)


def _effect(laid: SampleRatio, used: Bools, row: int) -> tuple[float, float]:
    """ln of R over a half space's, and the curve's smallest ratio to that at the radii used."""
    least = float(np.exp(laid.log_ratio[row][used[row]].min())) if used[row].any() else NAN
    return float(laid.log_total[row, 0]), least


def _left_out(pieces: Sequence[Slice], key: str, length: str, needed_mm: float) -> bool:
    """Whether a size is too small for a half space and yet not allowed for."""
    stated = [piece for piece in pieces if getattr(piece, key) is not None]
    return any(getattr(held(piece), length) == math.inf and getattr(piece, key) < needed_mm for piece in stated)
