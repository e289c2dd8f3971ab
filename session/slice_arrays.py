"""A slice from arrays or a data frame, held to what a slice.csv is held to."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bssrdf.errors import InputError
from bssrdf.session.checks import known_keys, shown
from bssrdf.session.keys import keys_of, missing_keys
from bssrdf.session.records import Array, ChannelSlice, Slice
from bssrdf.session.slice_csv import slice_of
from bssrdf.session.slice_units import doubt

CHANNEL = "mono"
_WHERE = Path("from_arrays")
_COLUMNS = ("r_mm", "rd_per_mm2", "sd_per_mm2", "r_lo_mm", "r_hi_mm", "side")


def slice_from_arrays(
    r_mm: ArrayLike,
    rd_per_mm2: ArrayLike | Mapping[str, ArrayLike],
    sd_per_mm2: ArrayLike | Mapping[str, ArrayLike] | None = None,
    **keys: Any,
) -> Slice:
    """One curve, or several by channel over the same radii, of shape (n,); `keys` are those of slice.csv's header.

    sd is None, or NaN at a radius, where it is unknown. Rows are put in order of radius. InputError where shapes
    differ, a value cannot be, or the light under the curve speaks against mm.
    """
    by_channel = rd_per_mm2 if isinstance(rd_per_mm2, Mapping) else {CHANNEL: rd_per_mm2}
    sds = sd_per_mm2 if isinstance(sd_per_mm2, Mapping) else dict.fromkeys(by_channel, sd_per_mm2)
    parts = {name: _part(name, r_mm, rd, sds.get(name)) for name, rd in by_channel.items()}
    return _checked(parts, keys)


def slice_from_dataframe(frame: Any, **keys: Any) -> Slice:
    """The slice of a pandas or polars frame with slice.csv's columns; without `channel` it is one curve."""
    columns = list(frame.columns)
    for name in ("r_mm", "rd_per_mm2"):
        if name not in columns:
            raise InputError(f"{_WHERE}: the frame has no column {name}; it has {', '.join(map(str, columns))}")
    names = np.asarray(frame["channel"]).astype(str) if "channel" in columns else np.full(len(frame), CHANNEL)
    parts = {}
    for name in dict.fromkeys(names.tolist()):
        here = names == name
        known = {key: np.asarray(frame[key])[here] for key in _COLUMNS if key in columns}
        r, rd, sd = (known.pop(key, None) for key in _COLUMNS[:3])
        parts[name] = _part(name, r, rd, sd, **known)
    return _checked(parts, keys)


def _checked(parts: dict[str, ChannelSlice], keys: Mapping[str, Any]) -> Slice:
    given = {key: value for key, value in keys.items() if value is not None}
    known_keys(_WHERE, "", given, keys_of(Slice))
    if lacking := missing_keys(keys_of(Slice), given):
        examples = ", ".join(f"{key}={example!r}" for key, example in lacking.items())
        raise InputError(f"{_WHERE}: lacks {', '.join(lacking)}; give keywords such as {examples}")
    curve = slice_of(_WHERE, parts, given)
    if found := doubt(curve):
        said = re.sub(r"give --unit \w+", "multiply them by 1000", found).replace("--scale free", 'scale="free"')
        raise InputError(f"{_WHERE}: {re.sub(r'--unit (.m)', 'convert first', said)}")
    return curve


def _part(channel: str, r_mm: Any, rd: Any, sd: Any, **more: Any) -> ChannelSlice:
    columns = {"r_mm": r_mm, "rd_per_mm2": rd, **more}
    read = {name: _numbers(channel, name, values) for name, values in columns.items()}
    n = len(read["r_mm"])
    read["sd_per_mm2"] = np.full(n, np.nan) if sd is None else _numbers(channel, "sd_per_mm2", sd, may_be_nan=True)
    for name, values in read.items():
        if len(values) != n:
            raise InputError(f"{_WHERE}: {name} of {channel} has {len(values)} values for {n} radii; give one for each")
    _refuse(channel, "r_mm", read["r_mm"], read["r_mm"] < 0, "must be 0 or more; radii count from the beam outwards")
    _refuse(channel, "sd_per_mm2", read["sd_per_mm2"], read["sd_per_mm2"] <= 0, "must be above 0; NaN where unknown")
    order = np.lexsort((read["r_mm"], read.get("side", np.zeros(n))))
    ordered: dict[str, Any] = {name: values[order] for name, values in read.items()}
    if "side" in ordered:
        ordered["side"] = ordered["side"].astype(np.int8)
    return ChannelSlice(**ordered)


def _numbers(channel: str, name: str, values: Any, *, may_be_nan: bool = False) -> Array:
    try:
        read = np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{_WHERE}: {name} of {channel} is not made of numbers ({error}); give an array") from error
    if read.ndim != 1 or not read.size:
        raise InputError(f"{_WHERE}: {name} of {channel} has the shape {read.shape}; give a list of numbers")
    if not may_be_nan:
        _refuse(channel, name, read, ~np.isfinite(read), "must be a finite number; leave such rows out")
    return read


def _refuse(channel: str, name: str, values: Array, bad: Any, remedy: str) -> None:
    if bad.any():
        at = int(np.argmax(bad))
        raise InputError(f"{_WHERE}: {name}[{at}] = {shown(float(values[at]))} of {channel} {remedy}")
