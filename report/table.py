"""The material table (Jensen et al. 2001, Fig. 5b): from fits, or the published one checked against itself."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

from bssrdf.report.text import with_error, wrapped
from bssrdf.session.records import ChannelFit, Fit
from bssrdf.transport import load_materials, table_check, table_source

Format = Literal["md", "csv", "json", "latex"]
Row = dict[str, Any]
_SHORT = {
    "channel": "ch",
    "sigma_sp_per_mm": "σs′, 1/mm",
    "sigma_a_per_mm": "σa, 1/mm",
    "r_published": "R publ.",
    "r_computed": "R comp.",
    "difference": "diff.",
}
"""Heads of columns for a terminal."""
_NAME = 14
"""Signs of a material's name that a terminal's table has room for."""
_Z95 = 1.96
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
    shown = [{_SHORT.get(key, key): value for key, value in row.items()} for row in rows] if form == "md" else rows
    return format_rows(shown, form, note=table_source())


def fits_table(fits: Sequence[Fit], form: Format) -> str:
    """One row per channel of each material; repeats are combined, and `inflation` says how far they disagree."""
    groups: dict[tuple[str, str, float, float | None], list[ChannelFit]] = {}
    for fit in fits:
        for name, channel in fit.channels.items():
            groups.setdefault((fit.material or fit.input_path, name, fit.eta, fit.g), []).append(channel)
    rows = [_fitted_row(*key, channels) for key, channels in groups.items()]
    if form == "md":
        return _for_a_terminal(rows, list(groups.values()))
    return _booktabs(rows, list(groups.values())) if form == "latex" else format_rows(rows, form)


def _for_a_terminal(rows: Sequence[Row], groups: Sequence[Sequence[ChannelFit]]) -> str:
    """Coefficients with their errors, and under the table what a number cannot say."""
    cells: list[Row] = []
    notes = []
    for row, channels in zip(rows, groups, strict=True):
        stated = row["sigma_sp_per_mm"] is not None
        cells.append(
            {
                "material": row["material"] if len(row["material"]) <= _NAME else "…" + row["material"][1 - _NAME :],
                "ch": row["channel"],
                "σs′, 1/mm": _with_sd(row, "sigma_sp") if stated else row["status"],
                "σa, 1/mm": _bound(channels) or _with_sd(row, "sigma_a"),
                "R": row["r"],
            }
        )
        told = [f"η {row['eta']:g}", *([] if row["g"] is None else [f"g {row['g']:g}"]), row["model"], row["status"]]
        told += [f"{row['n']} repeats, errors × {row['inflation_sigma_a']}"] if row["n"] > 1 else []
        told += [row["flags"]] if row["flags"] else []
        notes.append(f"{row['material']} {row['channel']}: {', '.join(told)}")
    return f"{format_rows(cells, 'md')}\n\n{wrapped(notes)}"


def _bound(channels: Sequence[ChannelFit]) -> str | None:
    """The upper bound of σa where the only fit gives no more than that."""
    bound = len(channels) == 1 and channels[0].status == "upper_bound"
    return f"< {channels[0].sigma_a_interval95_per_mm[1]:.2g}" if bound else None


def _with_sd(row: Row, key: str) -> str | None:
    value, sd = row[f"{key}_per_mm"], row[f"{key}_sd_per_mm"]
    return None if value is None else with_error(value, math.nan if sd is None else sd)


def _booktabs(rows: Sequence[Row], groups: Sequence[Sequence[ChannelFit]]) -> str:
    """For a paper: ± one standard deviation and the 95 % interval of each coefficient; needs the package booktabs."""
    lines = [
        r"\begin{tabular}{llcccccl}",
        r"\toprule",
        r"Material & & $\sigma_s'$ [1/mm] & 95\,\% & $\sigma_a$ [1/mm] & 95\,\% & $R$ & Status \\",
        r"\midrule",
    ]
    for row, channels in zip(rows, groups, strict=True):
        cells = [_latex(row["material"]), _latex(row["channel"])]
        for key in ("sigma_sp", "sigma_a"):
            value = (_bound(channels) if key == "sigma_a" else None) or _with_sd(row, key)
            cells += [
                "--" if value is None else f"${value.replace('±', chr(92) + 'pm')}$",
                _interval(row, key, channels),
            ]
        cells += ["--" if row["r"] is None else f"{row['r']:.3f}", _latex(row["status"].replace("_", " "))]
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])


def _interval(row: Row, key: str, channels: Sequence[ChannelFit]) -> str:
    """A single fit's own interval; of repeats ± 1.96 sd of their mean."""
    value, sd = row[f"{key}_per_mm"], row[f"{key}_sd_per_mm"]
    ends = getattr(channels[0], f"{key}_interval95_per_mm")
    if len(channels) > 1 and value is not None and sd is not None:
        ends = (value - _Z95 * sd, value + _Z95 * sd)
    return (
        "--"
        if not any(map(math.isfinite, ends))
        else "--".join(f"{end:.4g}" if math.isfinite(end) else r"$\infty$" for end in ends)
    )


def half_space_r(channel: ChannelFit) -> float:
    """R of the medium, whatever its sample was; fits of earlier versions knew half spaces only."""
    return channel.total_r_model if math.isnan(channel.total_r_half_space) else channel.total_r_half_space


def _fitted_row(material: str, name: str, eta: float, g: float | None, channels: Sequence[ChannelFit]) -> Row:
    sigma_sp = combine([c.sigma_sp_per_mm for c in channels], [c.sigma_sp_sd_per_mm for c in channels])
    sigma_a = combine([c.sigma_a_per_mm for c in channels], [c.sigma_a_sd_per_mm for c in channels])
    known = [r for r in map(half_space_r, channels) if not math.isnan(r)]
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
        rules = [
            rf"\begin{{tabular}}{{{'l' * len(head)}}}",
            r"\toprule",
            body[0],
            r"\midrule",
            *body[1:],
            r"\bottomrule",
        ]
        return "\n".join([*rules, r"\end{tabular}"])
    cells = [[cell.replace("|", r"\|") for cell in line] for line in cells]
    widths = [max(len(line[i]) for line in [head, *cells]) for i in range(len(head))]
    lines = [" | ".join(map(str.ljust, line, widths)) for line in [head, *cells]]
    rule = "|".join("-" * (width + 2) for width in widths)
    table = "\n".join([f"| {lines[0]} |", f"|{rule}|", *(f"| {line} |" for line in lines[1:])])
    return f"{table}\n\n{wrapped([note], indent='')}" if note else table


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
