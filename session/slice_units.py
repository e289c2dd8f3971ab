"""Units of a slice: what a column is multiplied by on reading, and whether what was read can be in mm and 1/mm²."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from bssrdf.session.keys import Key
from bssrdf.session.records import ChannelSlice, Slice

MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001}
"""Length units by name [mm]."""


@dataclass(frozen=True)
class Columns:
    """What a slice.csv may say of its own columns: nothing that is left once it has been read."""

    unit: Annotated[
        Literal["mm", "cm", "m", "um"],
        Key("of the columns' lengths; R_d is in 1 over its square. Columns may be named by it: r_cm, rd_per_cm2"),
    ] = "mm"


SMALLEST_FAR_MM = 0.1
"""A curve that ends before this is hardly one of a camera or a fibre: most likely its radii are in metres."""
MORE_THAN_ALL = 2.0
"""Light under the curve over the light that there is, from which on the units must be wrong or the values relative.
Downstream of an oblique beam 1.5 is right."""
FAR_TOO_LITTLE = 0.25
"""Light under the curve, with what is expected nearer and farther, over R: the estimate is good to a factor of 2 where
most of it lies under the curve."""


def column_unit(name: str) -> str | None:
    """The unit that the name of a column ends in, mm included; None for a column without one."""
    ending = name.removesuffix("2").rpartition("_")[2]
    return ending if ending in MM else None


def in_mm(name: str) -> str:
    """The name of the column that holds the same in mm."""
    unit = column_unit(name)
    square = "2" if name.endswith("2") else ""
    return name if unit is None else f"{name.removesuffix(unit + square)}mm{square}"


def factor(name: str, unit: str) -> float:
    """What values of this column, its lengths in `unit`, are multiplied by."""
    if column_unit(name) is None:
        return 1.0
    return MM[unit] ** -2 if name.endswith("2") else MM[unit]


def doubt(curve: Slice) -> str | None:
    """What speaks against radii in mm and values in 1/mm², one line without the file's name; None if nothing does."""
    for channel, part in curve.channels.items():
        farthest = float(part.r_mm.max())
        if 0 < farthest < SMALLEST_FAR_MM:
            return f"channel {channel} ends at r = {farthest:g} mm: if the radii are in m, give --unit m"
        total = curve.total_r.get(channel)
        inside, whole = _light(part)
        if inside > MORE_THAN_ALL * (total or 1.0):
            limit = f"total_r = {total:.3g}" if total else "all that entered"
            return (
                f"channel {channel} holds {inside:.3g} of the light, more than {limit}: is R_d in 1/mm² "
                "(in 1/cm² with radii in cm: --unit cm), or only known up to a factor (--scale free)?"
            )
        if total and whole < min(FAR_TOO_LITTLE * total, 2 * inside):
            return (
                f"channel {channel} comes to {whole:.2g} of the light, far below total_r = {total:.3g}: are the radii "
                "in mm and R_d in 1/mm² (both in cm: --unit cm), or is R_d only known up to a factor (--scale free)?"
            )
    return None


def _light(part: ChannelSlice) -> tuple[float, float]:
    """∫ 2πr R_d dr over the radii, and that with R_d going on to r = 0 and outwards as e^(−kr)/r."""
    r, rd = part.r_mm, part.rd_per_mm2
    if not (r[1:] > r[:-1]).all():
        order = np.argsort(r, kind="stable")
        r, first, counts = np.unique(r[order], return_index=True, return_counts=True)
        rd = np.add.reduceat(rd[order], first) / counts
    if r.size < 4:
        return 0.0, math.inf
    flux = 2 * math.pi * r * np.abs(rd)
    inside = float(np.trapezoid(flux, r))
    rising, falling = (_decay(r[ends].tolist(), flux[ends].tolist()) for ends in (slice(4), slice(-4, None)))
    nearer = float(flux[0] * np.expm1(min(rising * r[0], 50.0)) / rising) if rising else float(flux[0] * r[0])
    return inside, inside + nearer + (float(flux[-1] / falling) if falling > 0 else 0.0)


def _decay(r: list[float], flux: list[float]) -> float:
    """k of flux ~ e^(−kr), by the line through its logarithm; 0 where it does not fall or is not known."""
    if min(flux) <= 0:
        return 0.0
    middle = sum(r) / len(r)
    away = [each - middle for each in r]
    fall = -sum(x * math.log(each) for x, each in zip(away, flux, strict=True))
    return max(0.0, fall / sum(x * x for x in away))
