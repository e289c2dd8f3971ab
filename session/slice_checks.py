"""What the points of a curve must be, wherever they were read from; the first that is not is refused by its value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.checks import shown
from bssrdf.session.records import ChannelSlice

COLUMNS = tuple(field.name for field in fields(ChannelSlice))
NEEDED = ("r_mm", "rd_per_mm2", "sd_per_mm2")
MAY_BE_EMPTY = ("sd_per_mm2",)
LEAST, MOST = 1e-60, 1e60
"""Sizes of numbers whose squares and products a fit can still hold."""


class Places(NamedTuple):
    """Where the points of a curve stand, for what is said of one of them."""

    where: str
    """The file, and what of it."""
    numbers: NDArray[np.int64]
    """Of each point: its line, or its place in a list."""
    word: str = "line"

    def of(self, here: Any) -> Places:
        """Those of some of the points."""
        return self._replace(numbers=self.numbers[here])

    def refuse(self, bad: NDArray[np.bool_], name: str, column: Any, remedy: str) -> None:
        """InputError for the first bad point, with its number and value."""
        if bad.any():
            at = int(np.argmax(bad))
            value = column[at].item() if isinstance(column, np.ndarray) else column[at]
            raise InputError(f"{self.where}: {self.word} {self.numbers[at]}: {name} = {shown(value)} {remedy}")


def check_size(name: str, values: Any, written: Any, points: Places) -> None:
    """InputError for a number that is not finite, but where it may be missing, or of a size that no fit can hold.

    `written` is what stands in the place of each value.
    """
    finite = np.isfinite(values)
    if not finite.all():
        empty = np.isnan(values) if name in MAY_BE_EMPTY else False
        points.refuse(~(finite | empty), name, written, "must be a finite number")
    size = np.abs(values)
    limits = f"is out of reach: give 0, or a size from {LEAST:g} to {MOST:g}"
    points.refuse(((size > MOST) | (size < LEAST)) & (size != 0), name, written, limits)


def check_values(columns: Mapping[str, Any], points: Places) -> None:
    """InputError for a point that no curve has."""

    def refuse(bad: NDArray[np.bool_], name: str, remedy: str) -> None:
        points.refuse(bad, name, columns[name], remedy)

    r = columns["r_mm"]
    refuse(r < 0, "r_mm", "must be 0 or more; radii count from the beam outwards")
    refuse(columns["sd_per_mm2"] <= 0, "sd_per_mm2", "must be above 0; leave it empty where it is unknown")
    if ("r_lo_mm" in columns) != ("r_hi_mm" in columns):
        raise InputError(f"{points.where}: has one of the columns r_lo_mm and r_hi_mm; a bin needs both")
    if "r_lo_mm" in columns:
        lo, hi = columns["r_lo_mm"], columns["r_hi_mm"]
        refuse(lo < 0, "r_lo_mm", "must be 0 or more")
        refuse(hi <= lo, "r_hi_mm", "must be above r_lo_mm")
        refuse((r < lo) | (r > hi), "r_mm", "must lie between r_lo_mm and r_hi_mm")
    if "side" in columns:
        refuse(np.abs(columns["side"]) != 1, "side", "must be -1 or 1")


def check_curve(channel: str, part: ChannelSlice, points: Places) -> None:
    """InputError where radii fall, or where a point stands twice: it would count as two and halve the variance."""
    if (part.r_mm[1:] > part.r_mm[:-1]).all():
        return
    for side in [None] if part.side is None else [-1, 1]:
        here = slice(None) if part.side is None else part.side == side
        falls = np.append(False, np.diff(part.r_mm[here]) < 0)
        remedy = f"comes after a larger one in channel {shown(channel)}; sort the rows by radius"
        points.of(here).refuse(falls, "r_mm", part.r_mm[here], remedy)
    if np.any(np.diff(np.sort(part.r_mm)) == 0):
        _check_doubled(channel, part, points)


def _check_doubled(channel: str, part: ChannelSlice, points: Places) -> None:
    seen: dict[tuple[Any, ...], int] = {}
    columns = [column.tolist() for name in COLUMNS if (column := getattr(part, name)) is not None]
    for number, row in zip(points.numbers.tolist(), zip(*columns, strict=True), strict=True):
        known = seen.setdefault(tuple(map(repr, row)), number)
        if known != number:
            where = f"r_mm = {row[0]!r} in channel {shown(channel)}"
            again = f"{points.word} {number} is {points.word} {known} again"
            raise InputError(f"{points.where}: {again} ({where}); take out rows that stand twice")
