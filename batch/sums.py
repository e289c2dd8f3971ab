"""The end of a batch: results.csv, failures.csv, and index.html with what needs a look on top."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

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


def write_sums(out: Path, outcomes: Sequence[InputOutcome], *, bulk: bool) -> None:
    """Write the two tables and the page; of one list of inputs they are the same whoever did the work, and when.

    With `bulk` the fits stand in files of their own already, which are the table of results.
    """
    rows = [row for outcome in outcomes for row in _rows(outcome)]
    failures = [row for outcome in outcomes for row in failures_of(outcome)]
    _write_table(out / "failures.csv", ("name", "input", "stage", "code", "error"), failures)
    if bulk:
        (out / "results.csv").unlink(missing_ok=True)
    else:
        _write_table(out / "results.csv", COLUMNS, rows)
    _write(out / "index.html", _page(out, outcomes, bulk))


def _write_table(file: Path, head: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    _write(file, csv_text([head, *([_text(cell) for cell in row] for row in rows)]))


def failures_of(outcome: InputOutcome) -> Iterator[tuple[str, str, str, int, str]]:
    """Name, input, stage, exit code and line of what failed: the input, or slices of a Parquet file."""
    if outcome.failed is not None:
        yield (outcome.name, outcome.path, *outcome.failed)
    for name, code, line in outcome.lost:
        yield (name, outcome.path, "fit", code, line)


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
    if outcome.failed is not None or outcome.lost:
        return "error"
    words = {fit["status"] for fit in outcome.channels.values()} | {*outcome.statuses}
    return next((word for word in _VERDICTS if word in words), "measured")


def _counts(outcome: InputOutcome) -> Counter[str]:
    """The verdict of an input, or how many curves and failed slices of rows of a Parquet file came to each."""
    if outcome.statuses or outcome.lost:
        return Counter(outcome.statuses) + Counter(error=len(outcome.lost))
    return Counter([verdict(outcome)])


def _page(out: Path, outcomes: Sequence[InputOutcome], bulk: bool) -> str:
    from jinja2 import Environment, StrictUndefined

    text = files("bssrdf.batch").joinpath("page_parts", "index.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    listed = sorted(outcomes, key=lambda each: _VERDICTS.index(verdict(each)))
    counts = sum(map(_counts, outcomes), Counter())
    said = ", ".join(f"{counts[word]} {word}" for word in _VERDICTS if counts[word])
    table = "fits" if bulk else "results.csv"
    return environment.from_string(text).render(
        said=said, table=table, rows=[_line(out, outcome) for outcome in listed]
    )


def _line(out: Path, outcome: InputOutcome) -> dict[str, Any]:
    pages = ("report.html", "fit.json", "measured/slice.png")
    page = next((page for page in pages if (out / outcome.name / page).is_file()), None)
    lines = [_words(channel, fit) for channel, fit in outcome.channels.items()]
    lines += [f"{count} {status}" for status, count in outcome.statuses.items()] + [line for *_, line in outcome.lost]
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
