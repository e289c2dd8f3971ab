"""The chart of slice.png: places by value."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from bssrdf.measure.chart import Chart, LegendEntry

RED, BLUE = (255, 0, 0), (0, 0, 255)


def _rows(chart: Chart, colour: tuple[int, int, int]) -> np.ndarray:
    """Rows of the picture, its legend empty, that hold a colour."""
    picture = np.asarray(Image.open(io.BytesIO(chart.png("x", "y", "", [LegendEntry("", (0, 0, 0), is_dot=False)]))))
    strength = picture.astype(int) @ np.where(colour, 2, -1)  # 0 of grey; a line half on a pixel is half as strong
    return np.flatnonzero((strength > 200).any(axis=1))


def _height(value: float) -> float:
    chart = Chart((-1.0, 1.0), (1e-4, 1.0))
    chart.dots(np.array([0.0]), np.array([value]), RED)
    return float(_rows(chart, RED).mean())


def test_equal_ratios_are_equal_distances() -> None:
    heights = [_height(value) for value in (1e-3, 1e-2, 1e-1)]
    assert heights[0] > heights[1] > heights[2]
    np.testing.assert_allclose(np.diff(heights)[0], np.diff(heights)[1], atol=1)


def test_an_error_bar_that_reaches_below_zero_ends_at_the_bottom() -> None:
    chart = Chart((-1.0, 1.0), (1e-4, 1.0))
    chart.bars(np.array([0.0]), np.array([-1e-3]), np.array([1e-2]), RED)
    chart.dotted(1e-2, BLUE)
    assert abs(_rows(chart, RED).min() - _rows(chart, BLUE).min()) <= 1
    assert _rows(chart, RED).max() > _height(1.1e-4)


def test_what_lies_beyond_the_axes_is_not_drawn() -> None:
    chart = Chart((-1.0, 1.0), (1e-4, 1.0))
    chart.dots(np.array([0.0, 3.0]), np.array([1e-7, 1e-2]), RED)
    chart.dotted(1e-9, BLUE)
    assert not _rows(chart, RED).size
    assert not _rows(chart, BLUE).size


def test_a_chart_of_nothing_is_drawn() -> None:
    assert not _rows(Chart((0.0, 0.0), (1e-12, 1e-12)), RED).size
