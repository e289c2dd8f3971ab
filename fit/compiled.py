"""The search for a great many curves of one kind, compiled by JAX from the same text that NumPy runs."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from bssrdf.fit.problem import Neighbours, Plan, Problem
from bssrdf.fit.solve import Solution, settle
from bssrdf.fit.starts import start
from bssrdf.transport.arrays import ById
from bssrdf.transport.light import Light

FROM = 100_000
"""Curves of one kind from which on compiling pays: it takes 12 to 25 s, and then saves a fifth of NumPy's search, 75 µs
of plain curves and 250 of a camera's (CPU seconds)."""


def settled(plan: Plan, model: Light, data: Problem, aside: Neighbours, rows: int, *, single: bool = False) -> Solution:
    """The optimum of each problem from its first start; `rows` that are compiled for, the last problem repeated.

    It is found on JAX's default device, in float64, or with `single` in float32 (docs/scale.md states its error).
    """
    import jax

    run = _runner(plan, ById(model), ById(aside), data.factor_slopes)
    extra = rows - data.curves[0].r_lo.shape[0]
    arrays = (data.curves, data.totals, data.sds, data.samples)
    padded = jax.tree.map(lambda x: np.concatenate([x, np.repeat(x[-1:], extra, axis=0)]) if extra else x, arrays)
    exact = jax.default_matmul_precision("highest")  # else a GPU multiplies float32 in 10 bits
    with jax.enable_x64(not single), jax.numpy_rank_promotion("allow"), exact:
        ended = jax.block_until_ready(run(*padded))
        found: Solution = jax.tree.map(np.asarray, ended)  # which waits with the lock that JAX's first solve needs
    return jax.tree.map(lambda x: x[: rows - extra] if x.ndim else x, found)


@lru_cache(maxsize=16)
def _runner(plan: Plan, model: ById, aside: ById, slopes: Any) -> Callable[..., Solution]:
    import jax

    from bssrdf.transport.arrays import JaxEngine

    engine = JaxEngine()

    def run(curves: Any, totals: Any, sds: Any, samples: Any) -> Solution:
        data = Problem(curves, totals, sds, slopes, samples)
        return settle(engine, plan, model.it, data, start(engine, plan, model.it, data, 0), aside.it)

    compiled: Callable[..., Solution] = jax.jit(run)
    return compiled
