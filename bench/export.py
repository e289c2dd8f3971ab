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

from bssrdf.errors import InputError
from bssrdf.export import Closure, Material, find_materials
from bssrdf.export.blender import LIMITS, blender_text, verbatim_text, verbatim_walks
from bssrdf.export.closure import solve
from bssrdf.export.loss import depth_for, lost_share
from bssrdf.export.mitsuba import LOST, MOST_DEPTH, mitsuba_xml
from bssrdf.export.solved import Setting
from bssrdf.session.atomic import atomic_write, make_folder
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
class Effort:
    """How much is rendered."""

    materials: tuple[str, ...] = ()
    """None: all that are published."""
    edges: tuple[str, ...] = EDGES
    sky_samples: int = 512
    edge_samples: int = 1536
    mitsuba_samples: int = 128
    mitsuba_edge_samples: int = 96


QUICK = Effort(sky_samples=32, edge_samples=64, mitsuba_samples=8, mitsuba_edge_samples=8)


@dataclass(frozen=True)
class Point:
    """One number of a picture beside what it should be."""

    renderer: str
    kept: str
    material: str
    channel: str
    depth: float | None
    """Into the shadow in 1/σtr, negative in the light; None for the total under an even sky."""
    measured: float
    predicted: float
    """What the file says it will be."""
    rendered: float
    se: float

    @property
    def off(self) -> float:
        """Relative to the measured medium."""
        return self.rendered / self.measured - 1

    @property
    def off_predicted(self) -> float:
        """Relative to what the file says."""
        return self.rendered / self.predicted - 1

    @property
    def noise(self) -> float:
        """Two relative standard errors."""
        return 2 * self.se / self.predicted


@dataclass(frozen=True)
class Job:
    """One picture: of all channels under a sky, of one under an edge."""

    material: Material
    kept: str
    channel: int | None = None


def run_export_bench(
    out: Path | None, pythons: Sequence[Path], *, effort: Effort = Effort(), progress: Progress | None = None
) -> tuple[list[Point], list[str]]:
    """All points, and what was skipped and why; export.json into `out` where it is given."""
    materials = [find_materials(name)[0] for name in effort.materials or load_materials()]
    edged = [material for material in materials if material.name in effort.edges]
    points: list[Point] = []
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
    return points, skipped


def _jobs(materials: Sequence[Material], edged: Sequence[Material], kept: Sequence[str]) -> list[Job]:
    skies = [Job(material, each) for material in materials for each in kept]
    return skies + [Job(material, kept[0], channel) for material in edged for channel in range(3)]


def _cycles(
    python: Path, materials: Sequence[Material], edged: Sequence[Material], effort: Effort, progress: Progress | None
) -> Iterator[Point]:
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
            for job, answer in zip(jobs, answers, strict=False):
                done += 1
                if progress is not None:
                    progress(f"Cycles {answer['version']}: {job.material.name}", done, len(jobs))
                name = f"Cycles {answer['version']}"
                closures = [solve(medium, LIMITS) for medium in job.material.media]
                predicted = [closure.light.total for closure in closures]
                if job.kept == "verbatim":
                    predicted = [walk.spread(LIMITS).total for walk in verbatim_walks(job.material)]
                yield from _points(name, job, closures, predicted, np.array(answer["mean"]))
        if done < len(jobs):
            last = (said.read_text(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise InputError(f"{python}: rendered {done} of {len(jobs)} pictures ({last}); is bpy installed there?")


def _order(job: Job, number: int, folder: Path, effort: Effort) -> dict[str, Any]:
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


def _view(job: Job, sky_samples: int, edge_samples: int) -> dict[str, Any]:
    if job.channel is None:
        return {"light": "sky", "half_mm": SKY_HALF_MM, "field_mm": SKY_FIELD_MM, "samples": sky_samples}
    length = solve(job.material.media[job.channel], LIMITS).length_mm
    return {"light": "edge", "half_mm": EDGE_HALF * length, "field_mm": FIELD * length, "samples": edge_samples}


def _mitsuba(
    materials: Sequence[Material], edged: Sequence[Material], effort: Effort, progress: Progress | None
) -> Iterator[Point]:
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
            yield from _points(f"Mitsuba {mitsuba.__version__}", job, closures, predicted, picture)


def _points(
    renderer: str, job: Job, closures: Sequence[Closure], predicted: Sequence[float], picture: Floats
) -> Iterator[Point]:
    """What a picture shows, without the mirror's share."""
    mirror = float(fresnel_r(job.material.eta, 1.0))
    if job.channel is None:
        shown = (picture.reshape(-1, 3) - mirror) / (1 - mirror)
        se = shown.std(0) / np.sqrt(len(shown))
        for i, channel in enumerate(CHANNELS):
            yield Point(
                renderer,
                job.kept,
                job.material.name,
                channel,
                None,
                closures[i].measured.total,
                predicted[i],
                float(shown[:, i].mean()),
                float(se[i]),
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
        yield Point(
            renderer,
            job.kept,
            job.material.name,
            channel,
            round(float(x), 6),
            float(closure.measured.edge(at).mean()),
            float(light.edge(at).mean()),
            float(values[i]),
            float(se[i]),
        )


def table(points: Sequence[Point], skipped: Sequence[str]) -> str:
    """Totals, with the verbatim coefficients beside them, and edges."""
    lines = ["R under an even sky over the measured one, with two standard errors; verbatim: coefficients as they are"]
    totals = [point for point in points if point.depth is None]
    for key in dict.fromkeys((point.renderer, point.material) for point in totals):
        here = [point for point in totals if (point.renderer, point.material) == key]
        kept = [point for point in here if point.kept != "verbatim"]
        as_is = [f"{100 * point.off:+.0f}" for point in here if point.kept == "verbatim"]
        told = "  ".join(f"{100 * point.off:+5.2f} ± {100 * point.noise:.2f}" for point in kept)
        lines.append(f"{key[0]:<16} {key[1]:<10} {told} %" + (f"  verbatim {' '.join(as_is)} %" if as_is else ""))
    edges = [point for point in points if point.depth is not None]
    if edges:
        lines += [
            "",
            "Edge of a shadow: worst beyond two standard errors; lit side, to 1.5/σtr, and against the file to 3.2/σtr",
        ]
    for edge in dict.fromkeys((point.renderer, point.material, point.channel) for point in edges):
        here = [point for point in edges if (point.renderer, point.material, point.channel) == edge]
        lines.append(f"{edge[0]:<16} {edge[1]:<10} {edge[2]}  " + "  ".join(f"{100 * x:.1f} %" for x in worst(here)))
    return "\n".join([*lines, *(f"skipped {line}" for line in skipped)])


def worst(edge: Sequence[Point]) -> tuple[float, float, float]:
    """Beyond two standard errors: off the measured light when lit and to 1.5/σtr, anywhere off the file's."""

    def most(values: Iterator[float]) -> float:
        return max((value for value in values), default=0.0)

    depths = [(point.depth or 0.0, point) for point in edge]
    return (
        most(abs(point.off) - point.noise for depth, point in depths if depth < 0),
        most(abs(point.off) - point.noise for depth, point in depths if 0 < depth <= 1.5),
        most(abs(point.off_predicted) - point.noise for _, point in depths),
    )
