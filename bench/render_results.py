"""What `bssrdf bench render` found: a table, numbers as JSON, and error against time as a plot."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bssrdf.bench.render_cases import REFERENCE

KNOWN = ("terms", "terms, paper", "Monte Carlo table")


@dataclass(frozen=True)
class ResultRow:
    """One method on one case; triples are by channel."""

    scene: str
    material: str
    method: str
    samples: int
    seconds: float
    """Median of a run."""
    compile_s: float
    variance: float
    """Of a pixel of one run, over the mean's square."""
    mean: tuple[float, ...]
    ratio: tuple[float, ...]
    """Of the means, to the reference."""
    ratio_se: tuple[float, ...]
    rel_mse_bias: float
    """relMSE of tiles less the noise of this method and of the reference; ε = 0.01 mean²."""

    @property
    def cost(self) -> float:
        """Variance × time [s]."""
        return self.variance * self.seconds


@dataclass(frozen=True)
class CaseResult:
    """The methods on one case, and how good its reference is."""

    rows: tuple[ResultRow, ...]
    reference: str
    cut: tuple[float, ...]
    """Relative share of the light that the reference's longest path cuts off, estimated; by channel."""
    known: dict[str, tuple[float, ...]]
    """Means that are known without rendering."""


def table(results: list[CaseResult]) -> str:
    """A line a case and method; under a case what is known about its reference."""
    lines = [
        "| scene | material | method | s a run | compile s | variance × s | over points | mean ratio R, G, B "
        "| ± | relMSE of the bias |",
        "|---|---|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for result in results:
        exact = next(row for row in result.rows if row.method == "points")
        lines += [
            f"| {row.scene} | {row.material} | {row.method} | {row.seconds:.3f} | {row.compile_s:.1f} | {row.cost:.3g} "
            f"| {row.cost / exact.cost:.3g} | {_numbers(row.ratio, '.3f')} | {max(row.ratio_se):.3f} "
            f"| {row.rel_mse_bias:.3g} |"
            for row in result.rows
        ]
    return "\n".join([*lines, "", *_notes(results)])


def _notes(results: list[CaseResult]) -> list[str]:
    lines = []
    for result in results:
        row = result.rows[0]
        name = f"{row.scene}, {row.material}"
        if result.reference == REFERENCE:
            lines.append(
                f"- {name}: paths longer than the reference's carry {_numbers(result.cut, '.2%')} of its light"
            )
        if result.known:
            lines.append(f"- {name}: {_known_text(result)}")
    return lines


def _known_text(result: CaseResult) -> str:
    """Rendered over closed form, and the closed forms over Monte Carlo of a half space, which no path cuts off."""
    exact = np.array(_mean_of(result, "points"))
    terms, paper, truth = (np.array(result.known[key]) for key in KNOWN)
    return (
        f"points over the closed form {_numbers(exact / truth, '.4f')}; the paper's sum of terms over it "
        f"{_numbers(terms / truth, '.3f')}, with the paper's exit lobe {_numbers(paper / truth, '.3f')}"
    )


def _mean_of(result: CaseResult, method: str) -> tuple[float, ...]:
    return next(row.mean for row in result.rows if row.method == method)


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
    seconds = np.geomspace(0.01, 1000, 60)
    for axes, result in zip(panels.flat, reversed(first.values()), strict=False):
        for row in result.rows:
            bias = 0.0 if row.method == result.reference else max(row.rel_mse_bias, 0.0)
            axes.loglog(seconds, bias + row.cost / seconds, label=row.method)
        axes.set_title(f"{result.rows[0].scene}, {result.rows[0].material}", fontsize=9)
        axes.set_xlabel("seconds")
        axes.set_ylabel("relMSE")
    panels.flat[0].legend(fontsize=7)
    for axes in panels.flat[len(first) :]:
        axes.set_axis_off()
    figure.savefig(path, dpi=110)
