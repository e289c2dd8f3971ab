"""Units of length of an exported file. Inside the program all is in mm."""

from __future__ import annotations

from typing import Literal

Unit = Literal["mm", "cm", "m"]
UNITS: tuple[Unit, ...] = ("mm", "cm", "m")
MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""mm in one."""
DIGITS = 9
"""Of a number in a file: more than single precision holds."""


def lengths(values_mm: tuple[float, ...], unit: Unit) -> list[float]:
    """Lengths in the unit."""
    return [rounded(value / MM[unit]) for value in values_mm]


def coefficients(values_per_mm: tuple[float, ...], unit: Unit) -> list[float]:
    """Coefficients in 1/unit."""
    return [rounded(value * MM[unit]) for value in values_per_mm]


def rounded(value: float) -> float:
    """To the digits that a file gets."""
    return float(f"{value:.{DIGITS}g}")
