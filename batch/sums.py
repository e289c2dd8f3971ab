"""The end of a batch: results.csv, failures.csv, and index.html with what needs a look on top."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bssrdf.batch.inputs import Stage
from bssrdf.batch.state import InputOutcome
from bssrdf.session import atomic_write
from bssrdf.session.text_file import csv_text

VALUES = (
    "model", "sigma_sp_per_mm", "sigma_sp_sd_per_mm", "sigma_a_per_mm", "sigma_a_sd_per_mm", "total_r_measured",
    "total_r_model", "chi2_reduced", "n",
)  # fmt: skip
COLUMNS = ("name", "input", "material", "channel", "status", *VALUES, "flags")
_VERDICTS = ("error", "failed", "rejected", "unidentifiable", "upper_bound", "converged", "measured")
"""From what needs a look to what does not."""


def write_sums(out: Path, outcomes: Sequence[InputOutcome], stages: Sequence[Stage]) -> None:
    """Write the two tables and the page; of one list of inputs they are the same whoever did the work, and when."""
    rows = [row for outcome in outcomes for row in _rows(outcome)]
    failures = [(each.name, each.path, *each.failed) for each in outcomes if each.failed is not None]
    heads = (COLUMNS, ("name", "input", "stage", "code", "error"))
    for name, head, body in zip(("results.csv", "failures.csv"), heads, (rows, failures), strict=True):
        _write(out / name, csv_text([head, *([_text(cell) for cell in row] for row in body)]))
    _write(out / "index.html", _page(out, outcomes))


def _write(file: Path, text: str) -> None:
    with atomic_write(file) as part:
        part.write_text(text, encoding="utf-8", newline="")


def _rows(outcome: InputOutcome) -> Iterator[tuple[Any, ...]]:
    for channel, fit in outcome.channels.items():
        values = (fit.get(key) for key in VALUES)
        flags = " ".join(fit["flags"])
        yield (outcome.name, outcome.path, outcome.material, channel, fit["status"], *values, flags)


def _text(cell: Any) -> str:
    return "" if cell is None else repr(cell) if isinstance(cell, float) else str(cell)


def verdict(outcome: InputOutcome) -> str:
    """The gravest word on the input's channels; error where it came to none."""
    if outcome.failed is not None:
        return "error"
    words = {fit["status"] for fit in outcome.channels.values()}
    return next((word for word in _VERDICTS if word in words), "measured")


def _page(out: Path, outcomes: Sequence[InputOutcome]) -> str:
    from jinja2 import Environment, StrictUndefined

    text = files("bssrdf.batch").joinpath("page_parts", "index.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    listed = sorted(outcomes, key=lambda each: _VERDICTS.index(verdict(each)))
    counts = {word: sum(verdict(each) == word for each in outcomes) for word in _VERDICTS}
    said = ", ".join(f"{count} {word}" for word, count in counts.items() if count)
    return environment.from_string(text).render(said=said, rows=[_line(out, outcome) for outcome in listed])


def _line(out: Path, outcome: InputOutcome) -> dict[str, Any]:
    pages = ("report.html", "fit.json", "measured/slice.png")
    page = next((page for page in pages if (out / outcome.name / page).is_file()), None)
    lines = [_words(channel, fit) for channel, fit in outcome.channels.items()]
    return {
        "verdict": verdict(outcome),
        "order": _VERDICTS.index(verdict(outcome)),
        "name": outcome.name,
        "page": page and f"{quote(outcome.name)}/{page}",
        "material": outcome.material or "",
        "lines": lines if outcome.failed is None else [f"{outcome.failed[0]}: {outcome.failed[2]}"],
    }


def _words(channel: str, fit: dict[str, Any]) -> str:
    values = [
        f"{symbol} {fit[key]:.4g}{'' if fit[sd] is None else f' ± {fit[sd]:.2g}'} /mm"
        for symbol, key, sd in (
            ("σs′", "sigma_sp_per_mm", "sigma_sp_sd_per_mm"),
            ("σa", "sigma_a_per_mm", "sigma_a_sd_per_mm"),
        )
        if fit[key] is not None
    ]
    return f"{channel}: {', '.join([fit['status'], *values, *fit['flags']])}"
