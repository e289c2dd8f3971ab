"""`bssrdf bench export`: exported files, rendered in Cycles and in Mitsuba, against the light that they should show.

By reciprocity a slab seen along its normal under an even sky has the radiance F + (1 − F) R, with F the mirror's share
and R the total for light along the normal; under half a sky, the edge of a shadow. Lengths in mm.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bssrdf.bench.export_plot import draw_edges
from bssrdf.bench.export_results import EdgePoint
from bssrdf.errors import InputError
from bssrdf.export import Closure, ExportMaterial, find_materials
from bssrdf.export.blender import LIMITS, blender_text, verbatim_text, verbatim_walks
from bssrdf.export.closure import solve
from bssrdf.export.loss import depth_for, lost_share
from bssrdf.export.mitsuba import LOST, MOST_DEPTH, mitsuba_xml
from bssrdf.export.solved import Setting
from bssrdf.session import atomic_write, make_folder
from bssrdf.transport import CHANNELS, load_materials
from bssrdf.transport.fresnel import fresnel_r

Floats = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

PIXELS = 20
FIELD = 6.4
"""Width of a picture of an edge, in 1/σtr: 3.2 on each side."""
EDGE_HALF = 60.0
"""Half width of the slab under an edge, in 1/σtr."""
SKY_HALF_MM, SKY_FIELD_MM = 500.0, 16.0
EDGES = ("Marble", "Skin1", "Wholemilk")
_SUB = (np.arange(16) + 0.5) / 16 - 0.5


@dataclass(frozen=True)
class RenderEffort:
    """How much is rendered."""

    materials: tuple[str, ...] = ()
    """None: all that are published."""
    edges: tuple[str, ...] = EDGES
    sky_samples: int = 512
    edge_samples: int = 1536
    mitsuba_samples: int = 128
    mitsuba_edge_samples: int = 96


QUICK = RenderEffort(sky_samples=32, edge_samples=64, mitsuba_samples=8, mitsuba_edge_samples=8)


@dataclass(frozen=True)
class RenderJob:
    """One picture: of all channels under a sky, of one under an edge."""

    material: ExportMaterial
    kept: str
    channel: int | None = None


def run_export_bench(
    out: Path | None,
    pythons: Sequence[Path],
    *,
    effort: RenderEffort = RenderEffort(),
    progress: Progress | None = None,
) -> tuple[list[EdgePoint], list[str]]:
    """All points, and what was skipped and why; export.json and pictures of edges into `out` where it is given."""
    materials = [find_materials(name)[0] for name in effort.materials or load_materials()]
    edged = [material for material in materials if material.name in effort.edges]
    points: list[EdgePoint] = []
    skipped = (
        []
        if pythons
        else ["Cycles: no --python with bpy was given (a virtual environment of its own: pip install bpy)"]
    )
    for python in pythons:
        points += list(_cycles(python, materials, edged, effort, progress))
    try:
        points += list(_mitsuba(materials, edged, effort, progress))
    except InputError as error:
        skipped.append(f"Mitsuba: {error}")
    if out is not None:
        make_folder(out)
        with atomic_write(out / "export.json") as part:
            document = {"effort": asdict(effort), "points": [asdict(point) for point in points], "skipped": skipped}
            part.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        _draw(out, points)
    return points, skipped


def _draw(out: Path, points: Sequence[EdgePoint]) -> None:
    for material in dict.fromkeys(point.material for point in points if point.depth is not None):
        with atomic_write(out / f"edge_{material.lower()}.png") as part:
            draw_edges(part, points, material)


def _jobs(materials: Sequence[ExportMaterial], edged: Sequence[ExportMaterial], kept: Sequence[str]) -> list[RenderJob]:
    skies = [RenderJob(material, each) for material in materials for each in kept]
    return skies + [RenderJob(material, kept[0], channel) for material in edged for channel in range(3)]


def _cycles(
    python: Path,
    materials: Sequence[ExportMaterial],
    edged: Sequence[ExportMaterial],
    effort: RenderEffort,
    progress: Progress | None,
) -> Iterator[EdgePoint]:
    """Points by the Cycles of this Python, from a child process."""
    jobs = _jobs(materials, edged, ("appearance", "verbatim"))
    with tempfile.TemporaryDirectory() as folder, as_file(files(__package__) / "cycles_child.py") as child:
        orders = [_order(job, i, Path(folder), effort) for i, job in enumerate(jobs)]
        said = Path(folder) / "stderr"
        with (
            said.open("w") as stderr,
            subprocess.Popen(
                [python, child], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, text=True
            ) as process,
        ):
            assert process.stdin is not None
            assert process.stdout is not None
            with contextlib.suppress(BrokenPipeError):  # it has ended, and said why on stderr
                process.stdin.write("\n".join(map(json.dumps, orders)) + "\n")
                process.stdin.close()
            answers = (json.loads(line[7:]) for line in process.stdout if line.startswith("ANSWER "))
            done = 0
            for job, order, answer in zip(jobs, orders, answers, strict=False):
                done += 1
                if progress is not None:
                    progress(f"Cycles {answer['version']}: {job.material.name}", done, len(jobs))
                name = f"Cycles {answer['version']}"
                closures = [solve(medium, LIMITS) for medium in job.material.media]
                predicted = [closure.light.total for closure in closures]
                if job.kept == "verbatim":
                    predicted = [walk.spread(LIMITS).total for walk in verbatim_walks(job.material)]
                yield from _points(name, job, closures, predicted, np.array(answer["mean"]), order["samples"])
        if done < len(jobs):
            last = (said.read_text(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise InputError(f"{python}: rendered {done} of {len(jobs)} pictures ({last}); is bpy installed there?")


def _order(job: RenderJob, number: int, folder: Path, effort: RenderEffort) -> dict[str, Any]:
    file = folder / f"{number}.py"
    setting = Setting("Cycles", "appearance", "m", scene_unit=True)
    write = verbatim_text if job.kept == "verbatim" else blender_text
    file.write_text(write([job.material], setting), encoding="utf-8")
    return {
        "file": str(file),
        "pixels": PIXELS,
        "seed": number + 1,
        **_view(job, effort.sky_samples, effort.edge_samples),
    }


def _view(job: RenderJob, sky_samples: int, edge_samples: int) -> dict[str, Any]:
    if job.channel is None:
        return {"light": "sky", "half_mm": SKY_HALF_MM, "field_mm": SKY_FIELD_MM, "samples": sky_samples}
    length = solve(job.material.media[job.channel], LIMITS).length_mm
    return {"light": "edge", "half_mm": EDGE_HALF * length, "field_mm": FIELD * length, "samples": edge_samples}


def _mitsuba(
    materials: Sequence[ExportMaterial],
    edged: Sequence[ExportMaterial],
    effort: RenderEffort,
    progress: Progress | None,
) -> Iterator[EdgePoint]:
    """Points by Mitsuba's volumetric path tracer, in this process."""
    from bssrdf.bench.mitsuba_slab import render_slab
    from bssrdf.render.variant import use_variant

    use_variant()
    import mitsuba

    jobs = _jobs(materials, edged, ("medium",))
    with tempfile.TemporaryDirectory() as folder:
        for number, job in enumerate(jobs):
            if progress is not None:
                progress(f"Mitsuba: {job.material.name}", number, len(jobs))
            file = Path(folder) / f"{number}.xml"
            file.write_text(mitsuba_xml([job.material], Setting("Mitsuba", "medium", "mm")), encoding="utf-8")
            view = _view(job, effort.mitsuba_samples, effort.mitsuba_edge_samples)
            edge = view.pop("light") == "edge"
            picture = render_slab(file, job.material.name, edge=edge, pixels=PIXELS, seed=number + 1, **view)
            closures = [solve(medium, LIMITS) for medium in job.material.media]
            depth = depth_for(job.material.media, LOST, MOST_DEPTH)
            predicted = [medium.total * (1 - lost_share(medium, depth)) for medium in job.material.media]
            yield from _points(f"Mitsuba {mitsuba.__version__}", job, closures, predicted, picture, view["samples"])


def _points(
    renderer: str,
    job: RenderJob,
    closures: Sequence[Closure],
    predicted: Sequence[float],
    picture: Floats,
    samples: int,
) -> Iterator[EdgePoint]:
    """What a picture shows, without the mirror's share."""
    mirror = float(fresnel_r(job.material.eta, 1.0))
    if job.channel is None:
        shown = (picture.reshape(-1, 3) - mirror) / (1 - mirror)
        se = shown.std(0) / np.sqrt(len(shown))
        for i, channel in enumerate(CHANNELS):
            yield EdgePoint(
                renderer,
                job.kept,
                job.material.name,
                channel,
                None,
                closures[i].measured.total,
                predicted[i],
                float(shown[:, i].mean()),
                float(se[i]),
                samples * PIXELS**2,
            )
        return
    closure, channel = closures[job.channel], CHANNELS[job.channel]
    width = FIELD / PIXELS
    depth = -(np.arange(PIXELS) + 0.5 - PIXELS / 2) * width
    columns = (picture[..., job.channel] - mirror * (depth < 0)) / (1 - mirror)
    values, se = columns.mean(0), columns.std(0) / np.sqrt(len(columns))
    light = closure.measured if job.kept == "medium" else closure.light
    for i, x in enumerate(depth):
        at = (x + width * _SUB) * closure.length_mm
        yield EdgePoint(
            renderer,
            job.kept,
            job.material.name,
            channel,
            round(float(x), 6),
            float(closure.measured.edge(at).mean()),
            float(light.edge(at).mean()),
            float(values[i]),
            float(se[i]),
            samples * PIXELS,
        )
