"""A fit in a notebook: as HTML with its tiles, as a figure, and as the page of `bssrdf report`."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jinja2 import Environment

from bssrdf.report.bare import bare_curve, model_of
from bssrdf.report.evidence import Evidence, Piece
from bssrdf.report.page import coefficient_row, write_evidence
from bssrdf.report.tiles import channel_tiles
from bssrdf.report.verdict import verdict_of
from bssrdf.session.records import Fit, Slice

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HTML = """\
<div><p><b>{{ name }}</b>: {{ verdict.sentence }}</p>
<table><tr><th></th><th>σs′, 1/mm</th><th>σa, 1/mm</th><th>R of the medium</th><th>status</th>
{% for question in questions %}<th>{{ question }}</th>{% endfor %}</tr>
{% for row in rows %}<tr><th>{{ row.name }}</th><td>{{ row.sigma_sp }}</td><td>{{ row.sigma_a }}</td>
<td>{{ row.r_model }}</td><td>{{ row.status }}</td>
{% for tile in tiles[row.name] %}<td title="{{ tile.threshold }}"
style="background:{{ colours[tile.holds] }};color:#111">
{{ words[tile.holds] }}: {{ tile.figure }}</td>{% endfor %}</tr>{% endfor %}</table>
<ul>{% for each in verdict.advice %}<li>{{ each }}</li>{% endfor %}</ul></div>"""
_COLOURS = {True: "#cdeed6", False: "#f7cfcb", None: "#e6e8ea"}
_WORDS = {True: "yes", False: "no", None: "not known"}


def fit_html(fit: Fit, curve: Slice | None) -> str:
    """The verdict, the coefficients and the tiles of each channel; every name is escaped."""
    verdict = verdict_of(fit)
    tiles = {name: channel_tiles(channel, name, curve) for name, channel in fit.channels.items()}
    template = Environment(autoescape=True).from_string(_HTML)
    return template.render(
        name=fit.material or fit.input_path,
        verdict=verdict,
        rows=[coefficient_row(name, channel, verdict) for name, channel in fit.channels.items()],
        tiles=tiles,
        questions=list(dict.fromkeys(tile.question for each in tiles.values() for tile in each)),
        colours=_COLOURS,
        words=_WORDS,
    )


def write_page(path: Path, fit: Fit, curve: Slice, name: str) -> Path:
    """The page of `bssrdf report` on a fit that is in memory."""
    none = "a fit in memory has none"
    pieces = (Piece(Path(name), curve),)
    evidence = Evidence(Path(name), None, fit, pieces, missing={"images": none, "frames": none})
    return write_evidence(evidence, path)


def draw_fit(fit: Fit, curve: Slice) -> Figure:
    """One column per channel: data with error bars, model and dipole above, standardised residuals below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """One that a notebook shows, although no window opens it."""

        def _repr_png_(self) -> bytes:
            buffer = BytesIO()
            self.savefig(buffer, format="png", dpi=100)
            return buffer.getvalue()

    figure = ShownFigure(figsize=(4.6 * len(fit.channels), 5), layout="constrained")
    FigureCanvasAgg(figure)
    two, log = {"height_ratios": [3, 1]}, {"xscale": "log"}
    axes = figure.subplots(2, len(fit.channels), sharex="col", squeeze=False, gridspec_kw=two, subplot_kw=log)
    for column, name in enumerate(fit.channels):
        _draw(axes[0, column], axes[1, column], fit, name, curve)
    return figure


def _draw(above: Axes, below: Axes, fit: Fit, name: str, curve: Slice) -> None:
    found, part = fit.channels[name], curve.channels[name]
    above.set(yscale="log", title=name, ylabel="R_d, 1/mm²")
    below.set(xlabel="r, mm", ylabel="residual, sd")
    if not found.sigma_sp_per_mm > 0 or not found.sigma_a_per_mm >= 0:
        lit = (part.r_mm > 0) & (part.rd_per_mm2 > 0)
        above.errorbar(part.r_mm[lit], part.rd_per_mm2[lit], np.nan_to_num(part.sd_per_mm2[lit]), fmt=".", ms=3)
        above.set_title(f"{name}: {found.status}")
        return
    seen = bare_curve(curve, name, found.sigma_a_per_mm, found.sigma_sp_per_mm, model_of(curve, found.model))
    order = np.argsort(seen.r_mm, kind="stable")
    r, rd, sd, model, dipole = (
        each[order] for each in (seen.r_mm, seen.rd_per_mm2, seen.sd_per_mm2, seen.model_per_mm2, seen.dipole_per_mm2)
    )
    lit = rd > 0
    above.errorbar(r[lit], rd[lit], np.nan_to_num(sd[lit]), fmt=".", ms=3, lw=0.7, color="0.5", label="measured")
    above.plot(r, model, color="tab:red", lw=1, label=found.model)
    if found.model != "dipole":
        above.plot(r, dipole, "k--", lw=1, label="dipole")
    above.axvspan(*found.window_mm, color="0.95", zorder=0)
    above.legend()
    below.plot(r, (rd - model) / sd, ".", ms=3, color="0.4")
    below.axhline(0, color="tab:red", lw=0.8)
