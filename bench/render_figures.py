"""The paper's Figs. 8 to 11, one command each: `python -m bssrdf.bench.render_figures 9 --out docs/images`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from bssrdf.render import TERMS, Pixels, RenderOptions, exposure, render, shown
from bssrdf.render.scenes.catalogue import build_scene
from bssrdf.session import atomic_write, make_folder

SEED = 2001
_DPI = 100


@dataclass(frozen=True)
class Panel:
    """One picture of a figure."""

    title: str
    options: RenderOptions
    material: str | None = None
    samples: int = 128


@dataclass(frozen=True)
class Figure:
    """Panels of one scene at one exposure, that of the one named, in rows of `columns`."""

    scene: str
    panels: tuple[Panel, ...]
    exposed_by: str
    columns: int
    brighter: float = 1.0


BRDF, BSSRDF = Panel("BRDF", RenderOptions("brdf")), Panel("BSSRDF", RenderOptions("bssrdf"))
FIGURES = {
    8: Figure("block", (BRDF, BSSRDF), "BSSRDF", 2, brighter=6.0),
    9: Figure(
        "bust",
        (
            BRDF,
            replace(BSSRDF, samples=512),
            Panel("full Monte Carlo", RenderOptions("mc"), samples=192),
            *(
                Panel(f"{term} alone", RenderOptions("bssrdf", kernel="dipole", terms=(term,)), samples=512)
                for term in TERMS
            ),
        ),
        "BSSRDF",
        3,
        brighter=3.0,
    ),
    10: Figure(
        "milk",
        (
            Panel("whole milk, BRDF", RenderOptions("brdf"), "Wholemilk"),
            Panel("skim milk", RenderOptions("bssrdf"), "Skimmilk", samples=256),
            Panel("whole milk", RenderOptions("bssrdf"), "Wholemilk", samples=256),
        ),
        "whole milk",
        3,
        brighter=1.5,
    ),
    11: Figure("face", (BRDF, BSSRDF), "BSSRDF", 2),
}


def make_figure(number: int, *, width_px: int = 200, fewer: int = 1) -> dict[str, Pixels]:
    """Every panel's radiance, by its title; `fewer` divides the samples."""
    figure = FIGURES[number]
    images = {}
    for panel in figure.panels:
        scene = build_scene(figure.scene, material=panel.material, width_px=width_px)
        images[panel.title] = render(scene, panel.options, samples=max(2, panel.samples // fewer), seed=SEED).radiance
    return images


def draw(path: Path, number: int, images: dict[str, Pixels]) -> None:
    """All panels as one PNG."""
    import matplotlib.figure
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = FIGURES[number]
    factor = figure.brighter * exposure(images[figure.exposed_by])
    height, width = next(iter(images.values())).shape[:2]
    rows = -(-len(images) // figure.columns)
    size = (figure.columns * (width + 4) / _DPI, rows * (height + 22) / _DPI)
    drawn = matplotlib.figure.Figure(figsize=size, layout=ConstrainedLayoutEngine(w_pad=0.01, h_pad=0.01), dpi=_DPI)
    FigureCanvasAgg(drawn)
    for axes, (title, image) in zip(
        drawn.subplots(rows, figure.columns, squeeze=False).flat, images.items(), strict=True
    ):
        axes.imshow(shown(image, factor))
        axes.set_title(title, fontsize=8, pad=2)
        axes.set_axis_off()
    with atomic_write(path) as part:
        drawn.savefig(part, format="png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("number", type=int, choices=sorted(FIGURES))
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--width", type=int, default=200, help="pixels of a panel")
    parser.add_argument("--fewer", type=int, default=1, help="divides the samples")
    arguments = parser.parse_args()
    make_folder(arguments.out)
    path = arguments.out / f"figure{arguments.number}.png"
    draw(path, arguments.number, make_figure(arguments.number, width_px=arguments.width, fewer=arguments.fewer))
    print(path)


if __name__ == "__main__":
    main()
