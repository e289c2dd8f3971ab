"""One frame as its file holds it: the numbers, and the card that the EXIF and DNG tags of the file fill."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.session.records import Card

MACHINE_VISION_REL_SD = 1e-3
"""Of an exposure that a machine-vision or microscope program wrote; a camera's EXIF is a rounded label."""


SECONDS = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec"), 1e-3),
    **dict.fromkeys(("µs", "μs", "us", "usec"), 1e-6),
    "ns": 1e-9,
}
"""By the units that metadata give exposures in."""


@dataclass(frozen=True)
class RawFrame:
    """A frame as the camera made it, and what its file says about it."""

    data: NDArray[Any]
    """uint8, uint16 or float32 [DN], (h, w) of a mosaic or a mono camera, or (h, w, 3) RGB."""
    card: Card = field(default_factory=Card)
    exposure_s: float | None = None
    """From the file's own metadata."""
    exposure_rel_sd: float | None = None
    """None: unknown, as of a rounded label."""
    utc: str | None = None
    masked_dn: tuple[float, ...] | None = None
    """Mean of the optically black pixels [DN], by place in the pattern, where the file has them."""

    @property
    def layout(self) -> str | None:
        """2×2 colour filter pattern at the first pixel, "mono" or "rgb"; None where the file does not tell."""
        return self.card.layout

    @property
    def black(self) -> float | NDArray[np.float64] | None:
        """[DN]; of a mosaic (2, 2), by place in the pattern; of RGB by channel."""
        return by_place(self.card.black)

    @property
    def white(self) -> float | None:
        """[DN], the lowest of the channels."""
        return None if self.card.white is None else min(self.card.white)


def by_place(levels: Sequence[float] | None) -> float | NDArray[np.float64] | None:
    """Levels of a card in the shape that they have in the frame."""
    if levels is None or len(levels) == 1:
        return None if levels is None else float(levels[0])
    return np.array(levels, np.float64).reshape((2, 2) if len(levels) == 4 else -1)


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


def card_of_attributes(data: NDArray[Any], attributes: Tags) -> Card:
    """The same as OpenImageIO names it, and what the picture itself shows: its size, and whether it has colours."""
    return Card(
        camera=label(attributes.get("Model")),
        iso=positive(real(attributes.get("Exif:PhotographicSensitivity"))),
        f_number=positive(real(attributes.get("FNumber"))),
        layout="rgb" if data.ndim == 3 else None,
        width_px=data.shape[1],
        height_px=data.shape[0],
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
    """The number where it is above 0, as the decimal number that a float32 stood for.

    Not by `str`, which libraries shorten for all (colour sets NumPy's printing to that of 1.13).
    """
    if number is None or not 0 < number < math.inf:
        return None
    return float(np.format_float_scientific(np.float32(number), unique=True))


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


def without_alpha(path: Path, data: NDArray[Any]) -> NDArray[Any]:
    """The picture where its last channel is opaque everywhere."""
    opaque = np.iinfo(data.dtype).max if data.dtype.kind in "ui" else 1.0
    if not (data[..., -1] == opaque).all():
        channels = data.shape[2]
        raise InputError(
            f"{path}: has {channels} channels, the last not opaque; save one (mosaic or mono) or three (RGB)"
        )
    return data[..., :-1]
