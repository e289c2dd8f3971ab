"""Each half of a slice fitted by itself, and held against the other, which it has not seen."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bssrdf.errors import BssrdfError
from bssrdf.fit import FitOptions, fit_slice
from bssrdf.report.bare import bare_curve, model_of
from bssrdf.session.records import ChannelFit, ChannelSlice, Slice

CLEAR_SD = 5.0
"""A datum below that many of its sd tells nothing of a ratio."""
AGREE = 0.02
"""Of the light: as much as a spot placed a tenth of a pixel off, or a grain of the sample, makes of two halves."""
SIDES = {-1: "left", 1: "right"}


class Half(NamedTuple):
    """One half fitted, and what it says of the other."""

    fitted_on: str
    """`left` or `right`."""
    sigma_a_per_mm: float
    sigma_sp_per_mm: float
    departure: float
    """Median over the window of (other half)/(predicted) − 1."""
    departure_sd: float
    """Of that median, by the scatter of the ratios."""
    n: int
    """Data of the other half that it rests on."""
    status: str = "converged"
    """Of the half's own fit; without coefficients there is no prediction, and nothing agrees."""

    @property
    def agrees(self) -> bool:
        return abs(self.departure) <= max(AGREE, 3 * self.departure_sd)


def halves(piece: Slice, channel: str, found: ChannelFit, options: dict[str, Any]) -> list[Half] | str:
    """Both predictions in a channel, or in words why there are none. `options` are those of fit.json."""
    part = piece.channels[channel]
    if part.side is None:
        return "the slice does not keep its two halves apart"
    if found.status not in ("converged", "upper_bound"):
        return f"not done where the fit is {found.status}"
    if {int(side) for side in np.unique(part.side)} != set(SIDES):
        return "the slice has one half only"
    asked = FitOptions(
        model=found.model,  # type: ignore[arg-type]  # as the fit chose
        constraint=options.get("constraint"),
        scale=options.get("scale", "given"),
        window_mm=tuple(options["window_mm"]) if options.get("window_mm") else None,
        robust=bool(options.get("robust", False)),
        tables="cached",
    )
    predictions = []
    for side, name in SIDES.items():
        own, other = (replace(piece, channels={channel: _side(part, each)}) for each in (side, -side))
        try:
            half = fit_slice(own, asked)[channel]
        except BssrdfError as error:
            return str(error)
        if not half.sigma_sp_per_mm > 0 or np.isnan(half.sigma_a_per_mm):
            predictions.append(Half(name, math.nan, math.nan, math.nan, math.nan, 0, half.status))
            continue
        seen = bare_curve(other, channel, half.sigma_a_per_mm, half.sigma_sp_per_mm, model_of(piece, half.model))
        clear = (seen.r_lo_mm >= found.window_mm[0]) & (seen.r_hi_mm <= found.window_mm[1])
        clear &= ~(seen.rd_per_mm2 < CLEAR_SD * seen.sd_per_mm2)
        if clear.sum() < 3:
            return f"too few radii of the half beside the {name} one are clear of noise"
        ratio = seen.rd_per_mm2[clear] / seen.model_per_mm2[clear] - 1
        middle = float(np.median(ratio))
        sd = 1.4826 * float(np.median(np.abs(ratio - middle))) * np.sqrt(np.pi / 2 / clear.sum())
        predictions.append(Half(name, half.sigma_a_per_mm, half.sigma_sp_per_mm, middle, float(sd), int(clear.sum())))
    return predictions


def _side(part: ChannelSlice, side: int) -> ChannelSlice:
    assert part.side is not None
    here = part.side == side
    return replace(part, **{name: column[here] for name, column in vars(part).items() if column is not None})
