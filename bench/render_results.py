"""What `bssrdf bench render` found, as a table, JSON and a plot."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bssrdf.bench.render_cases import METHODS, REFERENCE

_COLOURS = {method: f"C{number}" for number, method in enumerate(METHODS)}


@dataclass(frozen=True)
class ResultRow:
    """One method on one case; triples are by channel."""

    scene: str
    material: str
    method: str
    samples: int
    prepare_s: float
    """CPU time to find the light under surfaces."""
    draw_s: float
    """CPU time of a run's picture."""
    variance: float
    """Of a pixel of one run, relative."""
    ratio: tuple[float, ...]
    """Of the means, to the truth."""
    ratio_se: tuple[float, ...]
    rel_mse_bias: float
    """relMSE of tiles less the noise of this method and of the reference; ε = 0.01 mean²."""
    worst: float
    """Largest relative error of a column of pixels, where the truth is known."""

    @property
    def seconds(self) -> float:
        """Of a run."""
        return self.prepare_s + self.draw_s

    @property
    def cost(self) -> float:
        """Variance × time [s]."""
        return self.variance * self.seconds


@dataclass(frozen=True)
class CaseResult:
    """The methods on one case, and how good its truth is."""

    rows: tuple[ResultRow, ...]
    rendered: bool
    """Whether volpath stands for the truth."""
    truth_se: tuple[float, ...]
    """Relative, of the truth's mean."""
    cut: tuple[float, ...]
    """Relative share of the light that volpath's longest path cuts off, estimated."""


def table(results: list[CaseResult]) -> str:
    """A line a case and method; under it what is known of rendered truths."""
    lines = [
        "| scene | material | method | prepare | draw | noise | volpath costs | brdf costs | over truth: R G B | ± | "
        "bias² |",
        "|---|---|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for result in results:
        lines += [_line(row, result) for row in result.rows]
    lines += [
        "",
        "CPU seconds; noise of a run's pixels on bodies; variance × time of volpath and of brdf over the method's; "
        "bias² is relMSE of tiles without the noise.",
    ]
    return "\n".join([*lines, *(_note(result) for result in results if result.rendered)])


def _line(row: ResultRow, result: CaseResult) -> str:
    return (
        f"| {row.scene} | {row.material} | {row.method} | {row.prepare_s:.2f} | {row.draw_s:.2f} "
        f"| {math.sqrt(row.variance):.1%} | {_costs(REFERENCE, row, result)} | {_costs('brdf', row, result)} "
        f"| {_numbers(row.ratio, '.4f')} | {max(row.ratio_se):.4f} | {row.rel_mse_bias:.2g} |"
    )


def _costs(method: str, row: ResultRow, result: CaseResult) -> str:
    """Its variance × time over the row's."""
    known = [other.cost for other in result.rows if other.method == method]
    return f"{known[0] / row.cost:.3g} ×" if known and row.cost > 0 else ""


def _note(result: CaseResult) -> str:
    row = result.rows[0]
    return (
        f"- {row.scene}, {row.material}: volpath is sure to {_numbers(result.truth_se, '.2%')}, and paths longer than "
        f"its own carry {_numbers(result.cut, '.2%')} of the light"
    )


def _numbers(values: Iterable[float], form: str) -> str:
    return " ".join(format(value, form) for value in values)


def write_results(out: Path, results: list[CaseResult], effort: dict[str, Any]) -> None:
    """render.json, render.md and render.png."""
    document = {"effort": effort, "cases": [_document(result) for result in results]}
    (out / "render.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    (out / "render.md").write_text(table(results) + "\n", encoding="utf-8")
    _plot(out / "render.png", results)


def _document(result: CaseResult) -> dict[str, Any]:
    rows = [asdict(row) | {"variance_x_time": row.cost} for row in result.rows]
    return asdict(result) | {"rows": rows}


def _plot(path: Path, results: list[CaseResult]) -> None:
    """relMSE against time, one panel a scene, for its first material: noise falls with time, bias stays."""
    from matplotlib.figure import Figure

    first = {result.rows[0].scene: result for result in reversed(results)}
    columns = min(3, len(first))
    rows = math.ceil(len(first) / columns)
    figure = Figure(figsize=(3.8 * columns, 2.9 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for axes, result in zip(panels.flat, reversed(first.values()), strict=False):
        for row in result.rows:
            seconds = np.geomspace(max(0.01, 1.05 * row.prepare_s), 10_000, 60)
            bias = 0.0 if result.rendered and row.method == REFERENCE else max(row.rel_mse_bias, 0.0)
            noise = row.variance * row.draw_s / (seconds - row.prepare_s)
            axes.loglog(seconds, bias + noise, label=row.method, color=_COLOURS[row.method])
        axes.set_title(f"{result.rows[0].scene}, {result.rows[0].material}", fontsize=9)
        axes.set_xlabel("CPU seconds")
        axes.set_ylabel("relMSE")
    panels.flat[len(first) - 1].legend(fontsize=7)
    for axes in panels.flat[len(first) :]:
        axes.set_axis_off()
    figure.savefig(path, dpi=110)
