"""The paper's Figs. 8 to 11, one command each: `python -m bssrdf.bench.render_figures 8 --out docs/images`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bssrdf.render import TERMS, Goal, Picture, RenderOptions, exposure, read_mesh, render, shown
from bssrdf.render.scenes.catalogue import build_scene
from bssrdf.session import atomic_write, make_folder

SEED = 2001
_GOAL = Goal()
_DPI = 100
_QUALITY = 88
"""Of the lossy WebP: 0.3 to 0.6 MB a figure."""


@dataclass(frozen=True)
class Panel:
    """One picture of a figure."""

    title: str
    options: RenderOptions
    material: str | None = None
    goal: Goal = _GOAL


@dataclass(frozen=True)
class Figure:
    """Panels of one scene at one exposure, that of the one named, in rows of `columns`."""

    scene: str
    panels: tuple[Panel, ...]
    exposed_by: str
    columns: int
    roughness: float | None = None
    """In place of the scene's own."""


BRDF, BSSRDF = Panel("BRDF", RenderOptions("brdf")), Panel("BSSRDF", RenderOptions("bssrdf"))
FIGURES = {
    8: Figure("block", (BRDF, BSSRDF), "BSSRDF", 2),
    9: Figure(
        "bust",
        (
            BRDF,
            BSSRDF,
            Panel("full Monte Carlo", RenderOptions("mc"), goal=Goal(samples=8)),
            *(
                Panel(f"the paper's {term}", RenderOptions("bssrdf", kernel="dipole", method="points", terms=(term,)))
                for term in TERMS
            ),
        ),
        "BSSRDF",
        3,
        roughness=0.2,
    ),
    10: Figure(
        "milk",
        (
            Panel("whole milk, BRDF", RenderOptions("brdf"), "Wholemilk"),
            Panel("skim milk", RenderOptions("bssrdf"), "Skimmilk"),
            Panel("whole milk", RenderOptions("bssrdf"), "Wholemilk"),
        ),
        "whole milk",
        3,
    ),
    11: Figure("face", (BRDF, BSSRDF), "BSSRDF", 2),
}


def make_figure(number: int, *, width_px: int = 1024, goal: Goal | None = None, mesh: Any = None) -> dict[str, Picture]:
    """Every panel's picture, by its title; `goal` in place of its own."""
    figure = FIGURES[number]
    pictures = {}
    for panel in figure.panels:
        scene = build_scene(
            figure.scene,
            material=panel.material,
            roughness=figure.roughness,
            width_px=width_px,
            own={"mesh": mesh},
        )
        pictures[panel.title] = render(scene, replace(panel.options, seed=SEED), goal or panel.goal, seed=SEED)
    return pictures


def draw(path: Path, number: int, pictures: dict[str, Picture]) -> None:
    """All panels as one lossy picture, each with the time that it took."""
    import matplotlib.figure
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = FIGURES[number]
    percentile = build_scene(figure.scene, width_px=8).white_percentile
    factor = exposure(pictures[figure.exposed_by].radiance, percentile)
    height, width = next(iter(pictures.values())).radiance.shape[:2]
    rows = -(-len(pictures) // figure.columns)
    size = (figure.columns * (width + 12) / _DPI, rows * (height + 0.08 * width) / _DPI)
    drawn = matplotlib.figure.Figure(figsize=size, layout=ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02), dpi=_DPI)
    FigureCanvasAgg(drawn)
    for axes, (title, picture) in zip(
        drawn.subplots(rows, figure.columns, squeeze=False).flat, pictures.items(), strict=True
    ):
        axes.imshow(shown(picture.radiance, factor), interpolation="none")
        axes.set_title(f"{title}, {_took(picture)}", fontsize=width / 45, pad=width / 90)
        axes.set_axis_off()
    with atomic_write(path) as part:
        drawn.savefig(part, format="webp", pil_kwargs={"quality": _QUALITY, "method": 6})


def _took(picture: Picture) -> str:
    return f"{picture.prepare_s + picture.seconds:.0f} s, noise {picture.noise:.0%}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("number", type=int, choices=sorted(FIGURES))
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--width", type=int, default=1024, help="pixels of a panel")
    parser.add_argument("--samples", type=int, help="per pixel, for a quick look")
    parser.add_argument("--mesh", type=Path, help="9 and 11: this figure, as of a scan")
    parser.add_argument("--height-mm", type=float, help="height of the mesh")
    arguments = parser.parse_args()
    make_folder(arguments.out)
    path = arguments.out / f"figure{arguments.number}.webp"
    mesh = read_mesh(arguments.mesh, height_mm=arguments.height_mm).mesh if arguments.mesh else None
    goal = Goal(samples=arguments.samples) if arguments.samples else None
    draw(path, arguments.number, make_figure(arguments.number, width_px=arguments.width, goal=goal, mesh=mesh))
    print(path)


if __name__ == "__main__":
    main()
