"""The card of a frame from the EXIF and DNG tags of its file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from typing import Any

import numpy as np

from bssrdf.session.records import Card

Tags = Mapping[str, Any]
"""Values by the name of the tag, as tifffile reads them: a rational is a pair."""

_OVERFLOWN_ISO = 65535
"""What the 16-bit tag holds where the ISO stands elsewhere."""


def card_of_tags(tags: Tags) -> Card:
    """What the tags say of camera, lens, ISO and the like."""
    iso = next((real(value) for value in _listed(tags.get("ISOSpeedRatings"))), None)
    if iso is None or iso >= _OVERFLOWN_ISO:
        iso = real(tags.get("RecommendedExposureIndex"))
    return Card(
        camera=label(tags.get("Model") or tags.get("UniqueCameraModel")),
        lens=label(tags.get("LensModel")),
        iso=positive(iso),
        f_number=positive(real(tags.get("FNumber"))),
        focal_mm=positive(real(tags.get("FocalLength"))),
        temperature_c=real(tags.get("Temperature")),
        orientation=_orientation(tags.get("Orientation")),
    )


def exposure_of_tags(tags: Tags) -> float | None:
    """ExposureTime [s]."""
    return positive(real(tags.get("ExposureTime")))


def time_of_tags(tags: Tags) -> str | None:
    """DateTimeOriginal in ISO 8601, with its zone where that is known."""
    date, zone = label(tags.get("DateTimeOriginal")), label(tags.get("OffsetTimeOriginal"))
    try:
        taken = datetime.strptime(date or "", "%Y:%m:%d %H:%M:%S").isoformat()
        return datetime.fromisoformat(taken + (zone or "")).isoformat()
    except ValueError:
        return None


def filled(card: Card, other: Card) -> Card:
    """`card`, and what it does not say by `other`."""
    missing = {name: value for name, value in vars(other).items() if getattr(card, name) is None}
    return replace(card, **missing)


def real(value: Any) -> float | None:
    """A finite number, of a rational too; None for anything else."""
    try:
        if isinstance(value, tuple | list) and len(value) == 2:
            value = value[0] / value[1]
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def positive(number: float | None) -> float | None:
    """The number where it is above 0, as the decimal number that a float32 stood for."""
    return float(str(np.float32(number))) if number is not None and 0 < number < math.inf else None


def label(text: Any) -> str | None:
    """A text in one line of printable characters; None where nothing is left."""
    if isinstance(text, bytes):
        text = text.decode(errors="replace")
    words = "".join(c if c.isprintable() else " " for c in text).split() if isinstance(text, str) else []
    return " ".join(words) or None


def _listed(value: Any) -> list[Any]:
    return list(value) if isinstance(value, tuple | list) else [value]


def _orientation(value: Any) -> int | None:
    number = real(value)
    return int(number) if number is not None and 1 <= number <= 8 else None
