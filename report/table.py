"""The material table (Jensen et al. 2001, Fig. 5b): from fits, or the published one checked against itself."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

from bssrdf.session.records import ChannelFit, Fit
from bssrdf.transport import load_materials, table_check, table_source

Format = Literal["md", "csv", "json", "latex"]
Row = dict[str, Any]
_LATEX = {sign: f"\\{sign}" for sign in "_%&#${}"} | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}"}


def published_table(form: Format) -> str:
    """The 36 published cells, the total R that each one's coefficients give, and the difference."""
    materials = load_materials()
    rows: list[Row] = []
    for cell in table_check():
        medium = materials[cell.name].medium(cell.channel)
        rows.append(
            {
                "material": cell.name,
                "channel": cell.channel,
                "sigma_sp_per_mm": medium.sigma_sp,
                "sigma_a_per_mm": medium.sigma_a,
                "eta": medium.eta,
                "r_published": cell.published,
                "r_computed": round(cell.computed, 4),
                "difference": round(cell.difference, 4),
            }
        )
    return format_rows(rows, form, note=table_source())


def fits_table(fits: Sequence[Fit], form: Format) -> str:
    """One row per channel of each material; repeats are combined, and `inflation` says how far they disagree."""
    groups: dict[tuple[str, str, float, float | None], list[ChannelFit]] = {}
    for fit in fits:
        for name, channel in fit.channels.items():
            groups.setdefault((fit.material or fit.input_path, name, fit.eta, fit.g), []).append(channel)
    return format_rows([_fitted_row(*key, channels) for key, channels in groups.items()], form)


def _fitted_row(material: str, name: str, eta: float, g: float | None, channels: Sequence[ChannelFit]) -> Row:
    sigma_sp = combine([c.sigma_sp_per_mm for c in channels], [c.sigma_sp_sd_per_mm for c in channels])
    sigma_a = combine([c.sigma_a_per_mm for c in channels], [c.sigma_a_sd_per_mm for c in channels])
    known = [c.total_r_model for c in channels if not math.isnan(c.total_r_model)]
    return {
        "material": material,
        "channel": name,
        "sigma_sp_per_mm": _digits(sigma_sp.mean),
        "sigma_sp_sd_per_mm": _digits(sigma_sp.sd, 2),
        "sigma_a_per_mm": _digits(sigma_a.mean),
        "sigma_a_sd_per_mm": _digits(sigma_a.sd, 2),
        "n": len(channels),
        "inflation_sigma_sp": _digits(sigma_sp.inflation, 3),
        "inflation_sigma_a": _digits(sigma_a.inflation, 3),
        "eta": eta,
        "g": g,
        "r": _digits(sum(known) / len(known) if known else math.nan),
        "model": " ".join(sorted({c.model for c in channels})),
        "status": " ".join(sorted({c.status for c in channels})),
        "flags": " ".join(sorted({flag for c in channels for flag in c.flags})),
    }


def format_rows(rows: Sequence[Row], form: Format, note: str = "") -> str:
    """The rows, all with the same keys, as Markdown, CSV, JSON or LaTeX; `note` goes where prose can stand."""
    if form == "json":
        return json.dumps(list(rows), ensure_ascii=False, indent=1)
    head = list(rows[0])
    nothing = "" if form == "csv" else "–"
    cells = [[nothing if row[key] is None else str(row[key]) for key in head] for row in rows]
    if form == "csv":
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([head, *cells])
        return text.getvalue().rstrip("\n")
    if form == "latex":
        body = [" & ".join(_latex(cell) for cell in line) + r" \\" for line in [head, *cells]]
        return "\n".join([rf"\begin{{tabular}}{{{'l' * len(head)}}}", body[0], r"\hline", *body[1:], r"\end{tabular}"])
    cells = [[cell.replace("|", r"\|") for cell in line] for line in cells]
    widths = [max(len(line[i]) for line in [head, *cells]) for i in range(len(head))]
    lines = [" | ".join(map(str.ljust, line, widths)) for line in [head, *cells]]
    rule = "|".join("-" * (width + 2) for width in widths)
    table = "\n".join([f"| {lines[0]} |", f"|{rule}|", *(f"| {line} |" for line in lines[1:])])
    return f"{table}\n\n{note}" if note else table


def _digits(value: float, digits: int = 4) -> float | None:
    return None if value != value else float(f"{value:.{digits}g}")


def _latex(cell: str) -> str:
    return "".join(_LATEX.get(sign, sign) for sign in cell)


class Combined(NamedTuple):
    """A mean of repeats; `inflation` is Birge's ratio, by which the stated errors were too small (at least 1)."""

    n: int
    mean: float
    sd: float
    """Of the mean, inflated."""
    spread: float
    """Standard deviation between the repeats; NaN of one."""
    inflation: float


def combine(values: Sequence[float], sds: Sequence[float]) -> Combined:
    """Mean weighted by 1/sd² (Birge 1932); plain where an sd is missing. Values that are NaN are left out."""
    pairs = [(value, sd) for value, sd in zip(values, sds, strict=True) if math.isfinite(value)]
    if not pairs:
        return Combined(0, math.nan, math.nan, math.nan, math.nan)
    known = all(math.isfinite(sd) and sd > 0 for _, sd in pairs)
    weights = [1 / sd**2 if known else 1.0 for _, sd in pairs]
    mean = sum(w * value for w, (value, _) in zip(weights, pairs, strict=True)) / sum(weights)
    n = len(pairs)
    if n == 1:
        return Combined(1, mean, pairs[0][1], math.nan, 1.0)
    spread = math.sqrt(sum((value - mean) ** 2 for value, _ in pairs) / (n - 1))
    if not known:
        return Combined(n, mean, spread / math.sqrt(n), spread, math.nan)
    chi2 = sum(w * (value - mean) ** 2 for w, (value, _) in zip(weights, pairs, strict=True))
    inflation = max(1.0, math.sqrt(chi2 / (n - 1)))
    return Combined(n, mean, inflation / math.sqrt(sum(weights)), spread, inflation)
