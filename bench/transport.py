"""`bssrdf bench transport`: how fast photons walk, how soon errors are small, what a table costs beside the dipole."""

from __future__ import annotations

import functools
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bssrdf.transport import MonteCarloMedium, simulate

MCML_PHOTONS_PER_S = {"marble_g": 26_000, "skin1_g": 471_000}
"""MCML 1.2.2, compiled -O3, one thread."""
MEDIA = {
    "marble_g": (MonteCarloMedium.reduced(0.0041, 2.62, 0.0, 1.5), 9.0),
    "skin1_g": (MonteCarloMedium.reduced(0.17, 0.88, 0.8, 1.3), 8.0),
}
"""Medium, and the farthest radius [mm] of its 40 bins."""
TARGET = 0.01
"""Relative standard error asked of every bin."""
N_RADII = 200
ROUNDS = 5


def run(out: Path, n_photons: int = 128_000) -> dict[str, Any]:
    """Measure, write `transport.json` and `transport.png` into `out`, and return what the first holds."""
    out.mkdir(parents=True, exist_ok=True)
    result = {name: _walk_speed(name, n_photons) for name in MEDIA}
    result["table"] = _table_cost()
    (out / "transport.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    _plot(out / "transport.png", result)
    return result


def _walk_speed(name: str, n_photons: int) -> dict[str, Any]:
    """Best of ROUNDS on one thread and on all, in turns: other work on the machine only ever slows a run down."""
    medium, far = MEDIA[name]
    edges = np.append(0, np.geomspace(far / 200, far, 40))
    simulate(medium, r_edges_mm=edges, n_photons=1, seed=0)
    cores = os.cpu_count() or 1
    wall = dict.fromkeys(sorted({1, cores}), np.inf)
    processor = np.inf
    for _ in range(ROUNDS):
        for n_threads in wall:
            began, used = time.perf_counter(), time.process_time()
            tally = simulate(medium, r_edges_mm=edges, n_photons=n_photons, seed=1, n_threads=n_threads)
            wall[n_threads] = min(wall[n_threads], time.perf_counter() - began)
            if n_threads == 1:
                processor = min(processor, time.process_time() - used)
    value, error = tally.rd()
    relative = error / value
    seconds = processor * (relative / TARGET) ** 2
    photons_per_s = tally.n_photons / processor
    return {
        "msteps_per_core_second": tally.steps / processor / 1e6,
        "photons_per_core_second": photons_per_s,
        "mcml_photons_per_second": MCML_PHOTONS_PER_S[name],
        "over_mcml": photons_per_s / MCML_PHOTONS_PER_S[name],
        "speed_up": wall[1] / wall[cores],
        "threads": cores,
        "r_mm": ((edges[1:] + edges[:-1]) / 2).tolist(),
        "core_seconds_to_1_percent": seconds.tolist(),
        "core_seconds_to_1_percent_worst": float(seconds.max()),
        "core_seconds_to_1_percent_median": float(np.median(seconds)),
    }


def _table_cost() -> dict[str, float]:
    """Time of one compiled evaluation of R_d at N_RADII radii, by table and by dipole, alternately."""
    import jax
    import jax.numpy as jnp

    from bssrdf.transport import DipoleModel, table_model
    from bssrdf.transport.dipole import Medium

    with jax.enable_x64(True):
        radii = jnp.geomspace(0.05, 12, N_RADII)
        evaluate = jax.jit(lambda model, sigma_a: model.rd(Medium(sigma_a, 2.62, model.eta), radii))
        models = {"table": table_model(1.5, 0.0), "dipole": DipoleModel(1.5)}
        at = jnp.asarray(0.0041)
        best = dict.fromkeys(models, np.inf)
        for _ in range(ROUNDS):
            for name, model in models.items():
                on_device = jax.tree.map(jnp.asarray, model)
                best[name] = min(best[name], _seconds(functools.partial(_wait, evaluate, on_device, at)))
    return {
        "table_us": best["table"] * 1e6,
        "dipole_us": best["dipole"] * 1e6,
        "table_over_dipole": best["table"] / best["dipole"],
    }


def _wait(evaluate: Callable[..., Any], *args: Any) -> None:
    evaluate(*args).block_until_ready()


def _seconds(call: Callable[[], object], repeats: int = 200) -> float:
    call()
    began = time.perf_counter()
    for _ in range(repeats):
        call()
    return (time.perf_counter() - began) / repeats


def _plot(path: Path, result: dict[str, Any]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for name in MEDIA:
        axes.loglog(result[name]["r_mm"], result[name]["core_seconds_to_1_percent"], label=name.replace("_", " "))
    axes.set_xlabel("r [mm]")
    axes.set_ylabel("core seconds to 1 % standard error")
    axes.legend()
    figure.savefig(path, dpi=150)
