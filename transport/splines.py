"""Piecewise cubics of even knots, read at many places with their slopes, on NumPy or JAX (`arrays`)."""

from __future__ import annotations

from typing import Any

from bssrdf.transport.arrays import Engine


def locate(xp: Any, at: Any, n: int) -> tuple[Any, Any]:
    """Which of n cells holds a place in [0, n], and where in it."""
    cell = xp.maximum(xp.minimum(at, n - 1).astype(xp.int32), 0)  # what is not a number has to lie somewhere
    return cell, at - cell


def cubic(powers: tuple[Any, ...], f: Any) -> tuple[Any, Any]:
    """Value and slope of cubics at f ∈ [0, 1]."""
    _, b, c, d = powers
    return cubic_value(powers, f), (3 * d * f + 2 * c) * f + b


def cubic_value(powers: tuple[Any, ...], f: Any) -> Any:
    a, b, c, d = powers
    return ((d * f + c) * f + b) * f + a


def powers_at(e: Engine, cells: Any, cell: Any) -> tuple[Any, ...]:
    """Those of one spline (4, n) for all rows, in the shape of `cell`."""
    return tuple(each.reshape(cell.shape) for each in e.take(cells[None], cell.reshape(1, -1)))


def spline(e: Engine, cells: Any, t: Any) -> tuple[Any, Any]:
    """One spline (1, 4, n) for all rows at t ∈ [0, 1] of any shape; value and slope by t."""
    n = cells.shape[-1]
    cell, f = locate(e.xp, t * n, n)
    value, slope = cubic(powers_at(e, cells[0], cell), f)
    return value, slope * n


def spline_rows(xp: Any, table: Any, t: Any) -> tuple[Any, Any]:
    """What B-spline coefficients along a table's first axis hold at t (b,) in [0, 1], and the slope by t."""
    n_cells = table.shape[0] - 3
    table = xp.asarray(table)
    first = xp.clip((t * n_cells).astype(xp.int32), 0, n_cells - 1)
    f = t * n_cells - first
    h = 1 - f
    weights = (h**3 / 6, 2 / 3 - f * f * (1 - f / 2), 2 / 3 - h * h * (1 - h / 2), f**3 / 6)
    slopes = (-h * h / 2, f * (1.5 * f - 2), h * (2 - 1.5 * h), f * f / 2)
    both = xp.stack([*weights, *(n_cells * each for each in slopes)], axis=-1).reshape(-1, 2, 4)
    rows = xp.matmul(both, table.reshape(table.shape[0], -1)[first[:, None] + xp.arange(4)])
    return rows[:, 0].reshape(-1, *table.shape[1:]), rows[:, 1].reshape(-1, *table.shape[1:])
