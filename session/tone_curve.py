"""What colour profiles and transfer tables say about numbers: whether they are linear in light."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError

Curve = NDArray[np.float64]

_HEADER = 128
"""Bytes of an ICC profile before the table of its tags."""
_CURVES = (b"rTRC", b"gTRC", b"bTRC", b"kTRC")
_STRAIGHT_WITHIN = 0.01
"""Of the range: 8-bit fixed point rounds an exponent to 0.004."""
_STEPS = np.linspace(0, 1, 257)
_PARAMETERS = (1, 3, 4, 5, 7)
"""Of a parametric curve, by its type (ICC.1:2022, table 68)."""

_IDENTITY = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def check_profile(path: Path, profile: Any) -> None:
    """InputError unless all tone curves of an ICC profile are straight; no profile says nothing."""
    if profile is None:
        return
    try:
        curves = _tone_curves(bytes(profile))
    except (struct.error, IndexError, TypeError, ValueError):
        curves = []
    if not curves:
        raise InputError(
            f"{path}: has a colour profile without a tone curve, so whether it is linear in light cannot be told; "
            "save it without the profile if it is"
        )
    if not all(map(_is_straight, curves)):
        raise InputError(f"{path}: is gamma encoded, as its colour profile says; save it linear")


def check_table(path: Path, table: Any) -> None:
    """InputError unless TIFF's TransferFunction, one table or one for each of three channels, is straight."""
    values = np.ravel(np.asarray(table, np.float64))
    one = [values] if values.size & (values.size - 1) == 0 else np.array_split(values, 3)
    if not all(each.size > 1 and _is_straight(np.interp(_STEPS, np.linspace(0, 1, each.size), each)) for each in one):
        raise InputError(f"{path}: is gamma encoded, as its transfer function says; save it linear")


def _is_straight(curve: Curve) -> bool:
    return bool(curve[-1] > 0 and np.abs(curve / curve[-1] - _STEPS).max() < _STRAIGHT_WITHIN)


def _tone_curves(profile: bytes) -> list[Curve]:
    (count,) = struct.unpack_from(">I", profile, _HEADER)
    tags = [struct.unpack_from(">4sII", profile, _HEADER + 4 + 12 * i) for i in range(min(count, 100))]
    return [_curve(profile[offset:]) for name, offset, _ in tags if name in _CURVES]


def _curve(stored: bytes) -> Curve:
    """Values at even steps from 0 to 1."""
    if stored[:4] == b"para":
        (kind,) = struct.unpack_from(">H", stored, 8)
        fixed = struct.unpack_from(f">{_PARAMETERS[kind]}i", stored, 12)
        return _parametric(kind, [value / 65536 for value in fixed])
    if stored[:4] != b"curv":
        raise ValueError("neither a table nor a formula")
    (count,) = struct.unpack_from(">I", stored, 8)
    values = np.array(struct.unpack_from(f">{count}H", stored, 12), np.float64)
    if count == 0:
        return _STEPS
    return np.power(_STEPS, values[0] / 256) if count == 1 else np.interp(_STEPS, np.linspace(0, 1, count), values)


def _parametric(kind: int, parameters: list[float]) -> Curve:
    """Y = (aX + b)^g + e from X = d on, below it cX + f (ICC.1:2022, table 68)."""
    g, a, b, c, d, e, f = (*parameters, *_IDENTITY[len(parameters) :])
    if kind == 2:
        c, e, f = 0.0, c, c
    return np.where(d <= _STEPS, np.power(np.maximum(a * _STEPS + b, 0), g) + e, c * _STEPS + f)
