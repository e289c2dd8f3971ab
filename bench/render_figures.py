"""The paper's Figs. 8 to 11, one command each: `python -m bssrdf.bench.render_figures 8 --out docs/images`."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.loop_subdivision import subdivided
from bssrdf.render import TERMS, Goal, RenderOptions, exposure, read_mesh, render, shown
from bssrdf.render.mesh_file import around, face_normals
from bssrdf.render.scenes.catalogue import build_scene
from bssrdf.render.scenes.record import Scene
from bssrdf.render.surface_nets import TriangleMesh
from bssrdf.session import atomic_write, make_folder

SEED = 2001
_GOAL = Goal(samples=64)
"""Of the background too, which a goal of noise leaves at eight."""
_TERM_GOAL = Goal(samples=16)
_DPI = 100
_GAP_PX = 16
_HEAD = 0.06
"""Height of a title over the width of its panel."""
_QUALITY = 88
"""Of the lossy WebP: 0.3 to 0.6 MB a figure."""
_SMOOTHINGS = 2
"""Subdivisions of a scan: 17,000 triangles become 270,000, of two pixels each."""


@dataclass(frozen=True)
class Panel:
    """One picture of a figure."""

    title: str
    options: RenderOptions
    material: str | None = None
    goal: Goal = _GOAL
    coarser: int = 1
    """Pixels of the figure over one of the panel's own, along each side."""


@dataclass(frozen=True)
class Figure:
    """Panels of one scene at one exposure, that of the one named, in rows of `columns`."""

    scene: str
    panels: tuple[Panel, ...]
    exposed_by: str
    columns: int
    wider: float = 1.0
    """Lamps over those of the scene, along each side; their power stays."""


class PanelImage(NamedTuple):
    """A panel's radiance (h, w, 3), its noise, and the processor time that it took, all cores together."""

    radiance: NDArray[np.float32]
    noise: float
    cpu_s: float


BRDF, BSSRDF = Panel("BRDF", RenderOptions("brdf")), Panel("BSSRDF", RenderOptions("bssrdf"))
FIGURES = {
    8: Figure("block", (BRDF, BSSRDF), "BSSRDF", 2),
    9: Figure(
        "bust",
        (
            BRDF,
            BSSRDF,
            Panel("full Monte Carlo", RenderOptions("mc"), goal=Goal(samples=2048), coarser=8),
            *(
                Panel(
                    f"the paper's {term}",
                    RenderOptions("bssrdf", kernel="dipole", method="points", terms=(term,)),
                    goal=_TERM_GOAL,
                )
                for term in TERMS
            ),
        ),
        "BSSRDF",
        3,
        wider=2.0,
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


def make_figure(
    number: int,
    *,
    width_px: int = 1024,
    goal: Goal | None = None,
    mesh: TriangleMesh | None = None,
    kept: Path | None = None,
) -> dict[str, PanelImage]:
    """Every panel by its title; `goal` in place of its own. In the folder `kept` they stay, and are not drawn again."""
    figure = FIGURES[number]

    def panel(each: Panel) -> PanelImage:
        width = width_px // each.coarser
        scene = build_scene(figure.scene, material=each.material, width_px=width, own={"mesh": mesh})
        began = time.process_time()
        options = replace(each.options, seed=SEED)
        picture = render(_with_wider_lamps(scene, figure.wider), options, goal or each.goal, seed=SEED)
        return PanelImage(picture.radiance, picture.noise, time.process_time() - began)

    return {each.title: _once(kept, f"figure{number} {each.title}", partial(panel, each)) for each in figure.panels}


def _once(folder: Path | None, name: str, draw: Callable[[], PanelImage]) -> PanelImage:
    """What was drawn before under that name, or is drawn now and stays there."""
    if folder is None:
        return draw()
    path = folder / f"{name}.npz"
    if not path.is_file():
        drawn = draw()
        with atomic_write(path) as part, part.open("wb") as file:
            np.savez(file, **drawn._asdict())
    with np.load(path) as held:
        return PanelImage(held["radiance"], float(held["noise"]), float(held["cpu_s"]))


def _with_wider_lamps(scene: Scene, times: float) -> Scene:
    """Full Monte Carlo finds a lamp by chance only, so that one of a few degrees would leave nothing but noise."""
    return replace(scene, lights={name: _widened(light, times) for name, light in scene.lights.items()})


def _widened(light: Any, times: float) -> Any:
    if light["type"] != "rectangle":
        return light
    radiance = light["emitter"]["radiance"]
    dimmed = radiance | {"value": [value / times**2 for value in radiance["value"]]}
    matrix = light["to_world"] @ np.diag([times, times, 1.0, 1.0])
    return light | {"to_world": matrix, "emitter": light["emitter"] | {"radiance": dimmed}}


def smooth_mesh(path: Path, height_mm: float | None) -> TriangleMesh:
    """A scan, its few flat triangles rounded off."""
    mesh = read_mesh(path, height_mm=height_mm).mesh
    vertices, faces = mesh.vertices, mesh.faces
    for _ in range(_SMOOTHINGS):
        vertices, faces = subdivided(vertices, faces)
    return TriangleMesh(vertices, face_normals(vertices, faces), around(vertices), faces)


def draw(path: Path, number: int, drawn: dict[str, PanelImage]) -> None:
    """All panels as one lossy picture, pixel for pixel, each with the time that it took."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Sheet

    figure = FIGURES[number]
    percentile = build_scene(figure.scene, width_px=8).white_percentile
    factor = exposure(drawn[figure.exposed_by].radiance, percentile)
    height, width = drawn[figure.exposed_by].radiance.shape[:2]
    head, rows = round(_HEAD * width), -(-len(drawn) // figure.columns)
    across, down = width + _GAP_PX, height + head + _GAP_PX
    size = (figure.columns * across - _GAP_PX, rows * down - _GAP_PX)
    sheet = Sheet(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI)
    FigureCanvasAgg(sheet)
    for place, (panel, each) in enumerate(zip(figure.panels, drawn.values(), strict=True)):
        row, column = divmod(place, figure.columns)
        left, top = column * across, size[1] - row * down
        image = shown(each.radiance, factor).repeat(panel.coarser, axis=0).repeat(panel.coarser, axis=1)
        sheet.figimage(image, left, top - head - len(image), origin="upper")
        middle = ((left + width / 2) / size[0], (top - head / 2) / size[1])
        sheet.text(*middle, _title(panel, each), ha="center", va="center", fontsize=width / 42)
    with atomic_write(path) as part:
        sheet.savefig(part, format="webp", pil_kwargs={"quality": _QUALITY, "method": 6})


def _title(panel: Panel, drawn: PanelImage) -> str:
    size = f"{drawn.radiance.shape[1]} px, " if panel.coarser > 1 else ""
    return f"{panel.title}: {size}{drawn.cpu_s:.0f} CPU s, noise {100 * drawn.noise:.2g} %"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("number", type=int, choices=sorted(FIGURES))
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--width", type=int, default=1024, help="pixels of a panel")
    parser.add_argument("--samples", type=int, help="per pixel, for a quick look")
    parser.add_argument("--mesh", type=Path, help="9 and 11: this figure, as of a scan")
    parser.add_argument("--height-mm", type=float, help="height of the mesh")
    parser.add_argument("--kept", type=Path, help="folder for panels, which are drawn once")
    arguments = parser.parse_args()
    for folder in filter(None, (arguments.out, arguments.kept)):
        make_folder(folder)
    path = arguments.out / f"figure{arguments.number}.webp"
    mesh = smooth_mesh(arguments.mesh, arguments.height_mm) if arguments.mesh else None
    goal = Goal(samples=arguments.samples) if arguments.samples else None
    panels = make_figure(arguments.number, width_px=arguments.width, goal=goal, mesh=mesh, kept=arguments.kept)
    draw(path, arguments.number, panels)
    print(path)


if __name__ == "__main__":
    main()
