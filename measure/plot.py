"""slice.png: the measured curve at a glance."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bssrdf.session.atomic import atomic_write
from bssrdf.session.records import Slice

_COLOURS = {"R": "tab:red", "G": "tab:green", "B": "tab:blue"}


def write_slice_png(path: Path, curve: Slice) -> None:
    """Draw R_d(r) of every channel with its error band; nothing is shown on a screen."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.5))
    figure.subplots_adjust(left=0.12, right=0.98, bottom=0.12, top=0.97)  # a layout engine takes as long as the rest
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(xlabel="distance from the beam, mm", ylabel="R_d, 1/mm²", yscale="log")
    for name, part in curve.channels.items():
        x = part.r_mm * (1 if part.side is None else part.side)
        order = np.argsort(x)
        positive = order[part.rd_per_mm2[order] > 0]
        total = f", R = {curve.total_r[name]:.3f}" if name in curve.total_r else ""
        (line,) = axes.plot(
            x[positive], part.rd_per_mm2[positive], lw=1, color=_COLOURS.get(name), label=f"{name}{total}"
        )
        sd = np.nan_to_num(part.sd_per_mm2[positive])
        low = np.maximum(part.rd_per_mm2[positive] - sd, 1e-2 * part.rd_per_mm2[positive])
        axes.fill_between(x[positive], low, part.rd_per_mm2[positive] + sd, color=line.get_color(), alpha=0.25, lw=0)
    axes.legend(title=curve.material)
    with atomic_write(path) as unfinished:
        figure.savefig(unfinished, dpi=110, format="png")
