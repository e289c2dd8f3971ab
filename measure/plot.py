"""slice.png and scene.png: what was measured, and where, at a glance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bssrdf.measure.chart import GREY, Chart, LegendEntry
from bssrdf.measure.image import Image
from bssrdf.measure.scene import Marks, light_of, marks_of, picture, saturation_map
from bssrdf.session import atomic_write
from bssrdf.session.records import ChannelSlice, Session, Slice

_COLOURS = {"R": (214, 39, 40), "G": (44, 160, 44), "B": (31, 119, 180)}
_OTHERS = ((31, 119, 180), (255, 127, 14), (44, 160, 44), (214, 39, 40), (148, 103, 189), (140, 86, 75))
"""RGB."""
_LEAST = 1e-12
"""R_d [1/mm²] below which nothing is drawn."""
_PANEL_PX = 900
_SPOT, _SLICE, _ISOPHOTE, _SATURATED = (165, 90, 255), (74, 213, 255), (255, 201, 92), (48, 59, 255)
"""BGR."""
_KEYS = (("spot, 1/e2", _SPOT), ("slice and its band", _SLICE), ("isophote", _ISOPHOTE), ("saturated", _SATURATED))
_FAR = 0.8
"""Of the slice's reach: from there on its own errors are the floor that noise sets."""


def write_slice_png(path: Path, curve: Slice) -> None:
    """Draw R_d(r) of every channel with its error bars and the floor of its noise; nothing is shown on a screen."""
    bins = {name: _bins(part) for name, part in curve.channels.items()}
    x, value, sd = np.concatenate([np.stack(part)[:, part[1] > 0] for part in bins.values()], axis=1)
    bottom = max(_lowest(curve) / 3, _LEAST) if value.size else _LEAST
    chart = Chart((x.min(initial=0.0), x.max(initial=0.0)), (bottom, (value + sd).max(initial=10 * bottom)))
    keys = [LegendEntry("noise floor, 1 sd", GREY, is_dot=False)]
    for number, (name, (x, value, sd)) in enumerate(bins.items()):
        lit = value > 0
        colour = _COLOURS.get(name, _OTHERS[number % len(_OTHERS)])
        chart.bars(x[lit], (value - sd)[lit], (value + sd)[lit], colour)
        chart.dots(x[lit], value[lit], colour)
        if floor := _floor(x, sd):
            chart.dotted(floor, colour)
        total = f", R seen {curve.total_r[name]:.3f}" if name in curve.total_r else ""
        keys.append(LegendEntry(f"{name}{total}", colour, is_dot=True))
    with atomic_write(path) as unfinished:
        unfinished.write_bytes(chart.png("distance from the beam, mm", "R_d, 1/mm²", curve.material or "", keys))


def _bins(part: ChannelSlice) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Place (left of the beam below 0), value and sd of each bin once, in order."""
    place = part.r_mm * (1 if part.side is None else part.side)
    x, first = np.unique(place, return_index=True)
    return x, part.rd_per_mm2[first], np.nan_to_num(part.sd_per_mm2[first])


def _floor(x: NDArray[np.float64], sd: NDArray[np.float64]) -> float:
    """Median sd of the farthest bins: light below it is not seen."""
    far = np.abs(x) > _FAR * np.abs(x).max(initial=0.0)
    return float(np.median(sd[far])) if far.any() else 0.0


def _lowest(curve: Slice) -> float:
    """The least that the picture has to show."""
    floors = [_floor(x, sd) for x, _, sd in map(_bins, curve.channels.values())]
    values = [part.rd_per_mm2[part.rd_per_mm2 > 0].min(initial=np.inf) for part in curve.channels.values()]
    return float(min(max(value, floor) for value, floor in zip(values, floors, strict=True)))


def write_scene_png(path: Path, session: Session, images: Mapping[str, Image], curve: Slice | None) -> None:
    """Draw sample and reference side by side with spot, slice, band, isophote and saturated pixels marked."""
    marks = marks_of(session, images, curve)
    white = light_of(images.get("reference") or next(iter(images.values())))
    panels = [_panel(kind, image, marks[kind], white) for kind, image in images.items()]
    height = min(len(panel) for panel in panels)
    whole = np.concatenate([panel[:height] for panel in panels], axis=1)
    done, encoded = cv2.imencode(".png", whole)
    assert done
    with atomic_write(path) as unfinished:
        unfinished.write_bytes(encoded.tobytes())


def _panel(kind: str, image: Image, marks: Marks, white: Mapping[str, float]) -> NDArray[np.uint8]:
    """One image, BGR, with its marks and what they are called."""
    height, width = image.hdr.shape[:2]
    scale = _PANEL_PX / width
    size = (_PANEL_PX, round(height * scale))
    shown = cv2.resize(np.ascontiguousarray(picture(image, white)[..., ::-1]), size, interpolation=cv2.INTER_LINEAR)
    clipped = cv2.resize(saturation_map(image).astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) != 0
    shown[clipped] = _SATURATED
    for points, colour, closed in _lines(marks):
        if len(points):
            places = np.rint(8 * ((points + 0.5) * scale - 0.5)).astype(np.int32)
            cv2.polylines(shown, [places], closed, colour, 1, cv2.LINE_AA, shift=3)
    there = (len(marks.spot_px), len(marks.slice_px), len(marks.isophote_px), clipped.any())
    keys = [key for key, drawn in zip(_KEYS, there, strict=True) if drawn]
    for line, (text, colour) in enumerate([(kind, (255, 255, 255)), *keys]):
        cv2.putText(shown, text, (10, 22 + 20 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
    return np.asarray(shown, np.uint8)


def _lines(marks: Marks) -> Iterator[tuple[NDArray[np.float64], tuple[int, int, int], bool]]:
    """Points, colour and whether the line is closed."""
    yield marks.band_px, _SLICE, True
    yield marks.slice_px, _SLICE, False
    yield marks.isophote_px, _ISOPHOTE, True
    yield marks.spot_px, _SPOT, True
