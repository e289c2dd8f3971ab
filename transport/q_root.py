"""The q of a medium whose total reflectance is R, for any model of light and either engine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bssrdf.transport.arrays import Engine
from bssrdf.transport.light import SMALLEST_Q, Light


def q_of_total(e: Engine, model: Light, total_r: Any) -> Any:
    """The q in the model's range whose total is nearest to R."""
    return root_of_total(e, lambda q, _: model.total(e, q), model.q_max, total_r, ())


def root_of_total(
    e: Engine, total_at: Callable[[Any, Any], tuple[Any, Any]], q_max: float, total_r: Any, fixed: Any
) -> Any:
    """The q up to `q_max` whose total is nearest to R: Newton in ln R, kept in a bracket.

    `total_at` gives R and dR/dq at q (b, 1) and what is `fixed` of those rows.
    """
    xp = e.xp

    def narrow(state: tuple[Any, ...], given: tuple[Any, Any]) -> tuple[Any, ...]:
        n, lo, hi, q, _ = state
        total_r, fixed = given
        total, slope = total_at(q, fixed)
        above = total > total_r
        lo, hi = xp.where(above, q, lo), xp.where(above, hi, q)
        new = q - xp.log(total / total_r) * total / slope
        new = xp.where((new >= lo) & (new <= hi), new, (lo + hi) / 2)
        return n + 1, lo, hi, new, xp.abs(new - q)[:, 0]

    lo = xp.zeros_like(total_r)
    hi = lo + q_max
    first = xp.clip(-xp.log(total_r) / 1.5, 1e-3, q_max)
    moved = xp.ones(total_r.shape[0])
    begun = (xp.zeros(total_r.shape[0], dtype=xp.int32), lo, hi, first, moved)
    *_, q, _ = e.loop(lambda s: (s[0] < 24) & (s[4] > SMALLEST_Q), narrow, begun, (total_r, fixed))
    q = xp.where(total_at(lo, fixed)[0] <= total_r, 0.0, q)
    return xp.where(total_at(lo + q_max, fixed)[0] >= total_r, q_max, q)
