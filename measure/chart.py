"""A small chart with a log axis upwards, drawn at once: matplotlib would take as long as all of a small `measure`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from bssrdf.session.records import Array

Colour = tuple[int, int, int]
"""RGB."""
BLACK, GREY, PALE = (0, 0, 0), (102, 102, 102), (204, 204, 204)

_SIZE_PX = (770, 495)
_LEFT, _RIGHT, _TOP, _BOTTOM = 92, 755, 15, 436
_DOT_PX = 1.7
_SHIFT = 4
"""Bits of a pixel's fraction by which lines and dots are placed."""
_TEXT_PX, _LINE_PX, _KEY_PX = 15, 23, 34
_MARGIN = 0.05
"""Beyond the data, of their range, as matplotlib has it."""
_MOST_TICKS, _MOST_DECADES = 8, 9
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class LegendEntry(NamedTuple):
    """A line of the legend: its words, and a dot, or a dotted line, in its colour."""

    text: str
    colour: Colour
    is_dot: bool


class Chart:
    """What is drawn between `x`, (low, high), and `y`, (low, high) > 0 on a log axis; what lies beyond is cut off."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float]) -> None:
        self.x = _widened(*x)
        low, high = math.log10(y[0]), math.log10(max(y[1], y[0] * 1.01))
        self.y = low, high + _MARGIN * (high - low)
        self._inside = np.full((_BOTTOM - _TOP, _RIGHT - _LEFT, 3), 255, np.uint8)

    def dots(self, x: Array, y: Array, colour: Colour) -> None:
        for place in self._places(x, y):
            cv2.circle(self._inside, place.tolist(), int(_DOT_PX * 2**_SHIFT), colour, cv2.FILLED, cv2.LINE_AA, _SHIFT)

    def bars(self, x: Array, low: Array, high: Array, colour: Colour) -> None:
        """Upright lines; a low end that is not above 0 lies below the chart."""
        ends = np.stack([self._places(x, low), self._places(x, high)], axis=1)
        cv2.polylines(self._inside, list(ends), False, colour, 1, cv2.LINE_AA, _SHIFT)

    def dotted(self, y: float, colour: Colour) -> None:
        """A dotted line at this height over the whole width."""
        row = int(self._places(np.array(self.x[:1]), np.array([y]))[0, 1]) >> _SHIFT
        if 0 <= row < len(self._inside):
            self._inside[row, np.arange(self._inside.shape[1]) % 3 == 0] = colour

    def png(self, x_label: str, y_label: str, title: str, keys: Sequence[LegendEntry]) -> bytes:
        """The chart with its axes, what they are called, and the legend, as a PNG."""
        canvas = np.full((_SIZE_PX[1], _SIZE_PX[0], 3), 255, np.uint8)
        canvas[_TOP:_BOTTOM, _LEFT:_RIGHT] = self._inside
        picture = Image.fromarray(canvas)
        draw = ImageDraw.Draw(picture)
        draw.rectangle((_LEFT, _TOP, _RIGHT, _BOTTOM), outline=BLACK)
        self._draw_ticks(draw)
        draw.text(((_LEFT + _RIGHT) / 2, _BOTTOM + 38), x_label, BLACK, _font(), "mm")
        upright = Image.new("L", (_BOTTOM - _TOP, 24), 255)
        ImageDraw.Draw(upright).text(((_BOTTOM - _TOP) / 2, 12), y_label, 0, _font(), "mm")
        picture.paste(upright.rotate(90, expand=True).convert("RGB"), (18, _TOP))
        _draw_legend(draw, title, keys)
        done, encoded = cv2.imencode(".png", np.asarray(picture)[..., ::-1])  # Pillow would import all its formats
        assert done
        return encoded.tobytes()

    def _places(self, x: Array, y: Array) -> NDArray[np.int32]:
        """Places (n, 2) in the inside, in fractions of a pixel."""
        height, width = self._inside.shape[:2]
        log_y = np.log10(np.maximum(y, 10 ** (self.y[0] - 1)))
        right = (x - self.x[0]) / (self.x[1] - self.x[0]) * width
        down = (self.y[1] - log_y) / (self.y[1] - self.y[0]) * height
        return np.rint(2**_SHIFT * np.stack([right, down], axis=1)).astype(np.int32)

    def _draw_ticks(self, draw: ImageDraw.ImageDraw) -> None:
        step = _step(self.x[1] - self.x[0])
        numbers = np.array([step * n for n in range(math.ceil(self.x[0] / step), math.floor(self.x[1] / step) + 1)])
        for number, (right, _) in zip(numbers, self._places(numbers, np.ones_like(numbers)), strict=True):
            x_px = _LEFT + (right >> _SHIFT)
            draw.line((x_px, _BOTTOM, x_px, _BOTTOM + 5), BLACK)
            draw.text((x_px, _BOTTOM + 17), f"{number:g}".replace("-", "−"), BLACK, _font(), "mm")
        first, last = math.floor(self.y[0]), math.floor(self.y[1])
        stride = 1 + (last - first) // _MOST_DECADES
        for decade in range(first, last + 1):
            for digit in range(1, 10) if stride == 1 else (1,):
                self._draw_y_tick(draw, decade, digit, stride)

    def _draw_y_tick(self, draw: ImageDraw.ImageDraw, decade: int, digit: int, stride: int) -> None:
        value = decade + math.log10(digit)
        if not self.y[0] <= value <= self.y[1]:
            return
        y_px = _TOP + round((self.y[1] - value) / (self.y[1] - self.y[0]) * (_BOTTOM - _TOP))
        draw.line((_LEFT - (5 if digit == 1 else 3), y_px, _LEFT, y_px), BLACK)
        few = self.y[1] - self.y[0] < 1.5
        if digit == 1 and decade % stride == 0:
            draw.text((_LEFT - 10, y_px), f"10{str(decade).translate(_RAISED)}", BLACK, _font(), "rm")
        elif few and digit in (2, 5):
            draw.text((_LEFT - 10, y_px), f"{digit}·10{str(decade).translate(_RAISED)}", BLACK, _font(), "rm")


def _draw_legend(draw: ImageDraw.ImageDraw, title: str, keys: Sequence[LegendEntry]) -> None:
    """In the corner that a curve which falls from the middle or the left leaves free."""
    lines = [key.text for key in keys]
    width = max(draw.textlength(title, _font()), *(_KEY_PX + draw.textlength(line, _font()) for line in lines)) + 20
    left, top = _RIGHT - 8 - width, _TOP + 8
    box = (left, top, _RIGHT - 8, top + _LINE_PX * (len(keys) + bool(title)) + 8)
    draw.rounded_rectangle(box, 4, (255, 255, 255), PALE)
    if title:
        draw.text((left + width / 2, top + 14), title, BLACK, _font(), "mm")
    for i, (text, colour, is_dot) in enumerate(keys):
        y = top + 15 + _LINE_PX * (i + bool(title))
        if is_dot:
            middle = left + 6 + _KEY_PX / 2
            draw.line((middle, y - 7, middle, y + 7), colour)
            draw.ellipse((middle - 2, y - 2, middle + 2, y + 2), colour)
        else:
            for x in range(6, _KEY_PX, 3):
                draw.point((left + x, y), colour)
        draw.text((left + 10 + _KEY_PX, y), text, BLACK, _font(), "lm")


def _widened(low: float, high: float) -> tuple[float, float]:
    margin = _MARGIN * ((high - low) or 1.0)
    return low - margin, high + margin


def _step(span: float) -> float:
    """1, 2 or 5 times a power of ten that divides the span by no more than is read at ease."""
    power = 10.0 ** math.floor(math.log10(span / _MOST_TICKS))
    return next(power * digit for digit in (1, 2, 5, 10) if span / (power * digit) <= _MOST_TICKS)


@cache
def _font() -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """DejaVu Sans out of matplotlib, which is not imported: Pillow's own has Latin letters alone."""
    spec = find_spec("matplotlib")
    file = Path((spec and spec.origin) or "").parent / "mpl-data/fonts/ttf/DejaVuSans.ttf"
    return ImageFont.truetype(str(file), _TEXT_PX) if file.is_file() else ImageFont.load_default(_TEXT_PX)
