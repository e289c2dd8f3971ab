"""What a merged image tells without its pixels: small pictures, sums, and blocks of 8 pixels a side and more.

It is written beside the image, so that a curve can be read again from the pixels near the beam alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.measure.hdr import HOT, SATURATED, Plane, Planes
from bssrdf.measure.pixels import Grid, grids_of, mosaic_period
from bssrdf.measure.pyramid import BlockSums, kept_levels
from bssrdf.session import atomic_write
from bssrdf.session.records import Array

_OVERVIEW_PIXELS = 100_000
"""Of the small image in which spots are looked for."""
_DISPLAY_PX = 900
"""Width of a picture to look at."""
_ROWS = 256
"""That are looked at together."""


@dataclass(frozen=True)
class GridSummary:
    """Of the pixels of one grid of a channel."""

    light_by_count: Array
    """Light of the good pixels by the number of samples that were merged for each."""
    n_saturated: int
    """Pixels saturated in every exposure, hot ones left out."""
    display: Plane
    """At display size; saturated pixels as bright as any."""
    clipped: NDArray[np.bool_]
    """At display size: whether some pixel is one of these."""
    levels: tuple[BlockSums, ...]


@dataclass(frozen=True)
class Summary:
    """Of an image."""

    overview: Plane
    """A small image, the mean of the channels, bad pixels black."""
    n_saturated: int
    """Pixels saturated in every exposure, hot ones left out, in any channel."""
    grids: dict[int, GridSummary]
    """By their place."""


def summary_of(image: Planes, layout: str, channels: Sequence[str]) -> Summary:
    """The summary of these channels, from all pixels."""
    n_saturated = _n_saturated(image)  # asks for all pixels of a stored image at once
    grids = (grid for channel in channels for grid in grids_of(image, layout, channel))
    return Summary(_overview(image, layout), n_saturated, {grid.place: _of_grid(grid, layout) for grid in grids})


def overview_side(shape: tuple[int, ...], layout: str) -> int:
    """Side of a pixel of the overview [px]."""
    period = mosaic_period(layout)
    return period * max(1, int(np.sqrt(shape[0] * shape[1] / _OVERVIEW_PIXELS) / period))


def _overview(image: Planes, layout: str) -> Plane:
    (height, width), side = image.shape[:2], overview_side(image.shape, layout)
    rows, columns = max(1, height // side), max(1, width // side)
    step = side * max(1, _ROWS // side)
    strips = []
    for top in range(0, rows * side, step):
        pixels = image.window(slice(top, min(top + step, rows * side)), slice(0, columns * side))
        good = np.where(pixels.good, pixels.radiance, np.float32(0))
        size = (columns, max(1, len(good) // side))
        strips.append(cv2.resize(good, size, interpolation=cv2.INTER_AREA))
    small = np.concatenate(strips)
    small = small if small.ndim == 2 else small.mean(axis=2)
    return np.asarray(cv2.blur(small, (3, 3), borderType=cv2.BORDER_REPLICATE), np.float32)


def _n_saturated(image: Planes) -> int:
    saturated = image.mask & (SATURATED | HOT) == SATURATED
    return int(np.count_nonzero(saturated if saturated.ndim == 2 else saturated.any(axis=2)))


def _of_grid(grid: Grid, layout: str) -> GridSummary:
    saturated = grid.mask & (SATURATED | HOT) == SATURATED
    return GridSummary(
        _light_by_count(grid),
        int(np.count_nonzero(saturated)),
        _display(grid, layout),
        _reduced(saturated.astype(np.float32), grid, layout) > 0,
        kept_levels(grid),
    )


def _light_by_count(grid: Grid) -> Array:
    count = grid.count
    sums = np.zeros(int(count.max()) + 1)
    for low in range(0, grid.shape[0], _ROWS):
        high = min(low + _ROWS, grid.shape[0])
        strip = grid.strip(low, high)
        light = np.where(strip.good, strip.radiance, np.float32(0))
        sums += np.bincount(count[low:high].ravel(), light.ravel(), len(sums))
    return sums


def _display(grid: Grid, layout: str) -> Plane:
    light, mask = np.nan_to_num(grid.radiance), grid.mask
    top = light.max(initial=0.0, where=mask == 0)
    return _reduced(np.where(mask & SATURATED, top, light).astype(np.float32), grid, layout)


def _reduced(plane: Plane, grid: Grid, layout: str) -> Plane:
    height, width = grid.image.shape[:2]
    period = mosaic_period(layout)
    share = min(1.0, _DISPLAY_PX / width) if period == 1 else min(1 / period, _DISPLAY_PX / width)
    size = (max(1, round(width * share)), max(1, round(height * share)))
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)


def write_summary(path: Path, summary: Summary, image: Path) -> None:
    """Write the summary of the EXR `image`, with what tells whether that has changed since."""
    arrays: dict[str, Any] = {"of": _state(image), "overview": summary.overview, "saturated": summary.n_saturated}
    for place, grid in summary.grids.items():
        own = {each.name: getattr(grid, each.name) for each in fields(grid) if each.name != "levels"}
        of_levels = {
            f"level{k}.{name}": plane for k, level in enumerate(grid.levels) for name, plane in level._asdict().items()
        }
        arrays |= {f"{place}.{name}": values for name, values in (own | of_levels).items()}
    with atomic_write(path) as unfinished, unfinished.open("wb") as file:
        np.savez(file, **arrays)


def read_summary(path: Path, image: Path) -> Summary | None:
    """What `write_summary` wrote; None where that is not there, or the image has changed since."""
    try:
        with np.load(path) as stored:
            if stored["of"].tolist() != _state(image).tolist():
                return None
            places = {int(name.partition(".")[0]) for name in stored.files if name.endswith(".n_saturated")}
            grids = {place: _grid_in(stored, f"{place}.") for place in sorted(places)}
            return Summary(stored["overview"], int(stored["saturated"]), grids)
    except (OSError, KeyError, ValueError, BadZipFile):
        return None


def _grid_in(stored: Any, prefix: str) -> GridSummary:
    n_levels = sum(name.startswith(f"{prefix}level") and name.endswith(".light") for name in stored.files)
    return GridSummary(
        stored[prefix + "light_by_count"],
        int(stored[prefix + "n_saturated"]),
        stored[prefix + "display"],
        stored[prefix + "clipped"],
        tuple(BlockSums(*(stored[f"{prefix}level{k}.{name}"] for name in BlockSums._fields)) for k in range(n_levels)),
    )


def _state(image: Path) -> NDArray[np.int64]:
    """Size and time of the last change: a copy that does not keep the time is summed up anew."""
    state = image.stat()
    return np.array([state.st_size, state.st_mtime_ns])
