"""Draw the figures that come from results kept in the sources: `python docs/figures.py`."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
UNIT = "scipy least_squares exact"
"""The method whose rate is 1."""


def speed_of_fits() -> dict[str, float]:
    """Ratios of the last run that `make bench` kept."""
    line = (ROOT / "bench" / "history.jsonl").read_text(encoding="utf-8").splitlines()[-1]
    ratios: dict[str, float] = json.loads(line)["ratios"]
    return ratios


def draw(ratios: dict[str, float], file: Path) -> None:
    figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
    names = sorted(ratios, key=lambda name: ratios[name])
    ours = [name.split()[0] in ("dipole", "mc") for name in names]
    bars = axes.barh(names, [ratios[name] for name in names], color=["#3465a4" if own else "#999999" for own in ours])
    axes.bar_label(bars, fmt="%.1f", padding=3)
    axes.set_xscale("log")
    axes.set_xlabel(f"fits per second over those of {UNIT}")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    draw(speed_of_fits(), ROOT / "docs" / "images" / "speed_fit.png")
