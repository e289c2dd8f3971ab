"""The edge of a shadow as renderers show it, under the measured curve."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np

from bssrdf.bench.export_results import EdgePoint

_COLOURS = {"R": "tab:red", "G": "tab:green", "B": "tab:blue"}
_MARKS = "o^sDv"


def draw_edges(path: Path, points: Sequence[EdgePoint], material: str) -> None:
    """One panel a channel: strips of the pictures above, brightness by depth into the shadow below."""
    edges = [point for point in points if point.depth is not None and point.material == material]
    renderers = list(dict.fromkeys(point.renderer for point in edges))
    subplots: Any = plt.subplots
    figure, axes = subplots(2, 3, figsize=(10, 5.2), sharex=True, height_ratios=[1, 3], layout="constrained")
    for column, (channel, colour) in enumerate(_COLOURS.items()):
        strips, panel = axes[0][column], axes[1][column]
        here = [[p for p in edges if (p.renderer, p.channel) == (name, channel)] for name in renderers]
        depth = np.array([point.depth for point in here[0]], float)
        order = np.argsort(depth)
        rows: list[Any] = [
            np.array([point.measured for point in here[0]]),
            *(np.array([p.rendered for p in each]) for each in here),
        ]
        light = np.clip(np.array(rows)[:, order], 0, 1) ** (1 / 2.2)
        strips.imshow(
            light, cmap="gray", vmin=0, vmax=1, aspect="auto", extent=(depth.min(), depth.max(), len(rows), 0)
        )
        strips.set_yticks(np.arange(len(rows)) + 0.5, ["measured", *renderers] if column == 0 else [""] * len(rows))
        panel.plot(depth[order], rows[0][order], color=colour, label="measured")
        for mark, name, each in zip(_MARKS, renderers, here, strict=False):
            value, noise = np.array([p.rendered for p in each]), np.array([p.noise * p.predicted for p in each])
            panel.errorbar(depth, value, noise, fmt=mark, ms=4, lw=0.8, color="black", mfc="none", label=name)
        panel.set(yscale="log", ylim=(3e-4, 1.2), xlabel="depth into the shadow [1/σtr]")
        panel.set_title(f"{material}, {channel}", fontsize=9)
    axes[1][0].set_ylabel("light, over that which falls in")
    axes[1][0].legend(fontsize=7)
    figure.savefig(path, dpi=110)
    plt.close(figure)
