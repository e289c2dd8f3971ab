"""`bssrdf bench`: speed against error, beside other tools that are installed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import click

from bssrdf.commands.console import FILE, FOLDER, Command, Group, force_option, fresh, is_quiet
from bssrdf.errors import UsageError

OUT = click.option("--out", type=click.Path(path_type=Path), help="Folder for the results as JSON and as a plot.")


@click.group(cls=Group)
def bench() -> None:
    """Speed against error, beside other tools that are installed."""


@bench.command()
@OUT
@force_option
def hdr(out: Path | None, force: bool) -> None:
    """Merge one bracket by every method there is."""
    from bssrdf.bench.hdr import run_hdr_bench, table
    from bssrdf.report import steps

    with steps(quiet=is_quiet()) as progress:
        result = run_hdr_bench(out=out and fresh(out, force), progress=progress)
    click.echo(table(result))


@bench.command()
@OUT
@force_option
@click.option(
    "--history",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Append the ratios to SciPy, with the commit, to this file of JSON lines, and tell which have fallen.",
)
def fit(out: Path | None, force: bool, history: Path | None) -> None:
    """The same curves by all models, jaxopt, SciPy; a cold command."""
    from bssrdf.bench.camera_curves import command_seconds
    from bssrdf.bench.fit import ratios, run_fit_bench, table
    from bssrdf.bench.history import appended, read_ratios
    from bssrdf.report import steps

    if history is not None:
        read_ratios(history)

    with steps(quiet=is_quiet()) as progress:
        scores = run_fit_bench(out=out and fresh(out, force), progress=progress)
    click.echo(table(scores))
    click.echo("\n`bssrdf fit` of a camera's slice, three channels, from a cold process:")
    click.echo("{:.2f} CPU s with an empty cache, {:.2f} again".format(*command_seconds()))
    for remark in appended(history, ratios(scores)) if history is not None else ():
        click.echo(f"slower: {remark}", err=True)


@bench.command()
@OUT
@force_option
@click.option("--trials", type=click.IntRange(2), default=64, show_default=True, help="For each cell.")
@click.option("--scale-sd", type=float, default=0.0, help="Relative error of the scale, drawn for each trial.")
@click.option("--length-sd", type=float, default=0.0, help="Relative error of lengths, drawn for each trial.")
@click.option(
    "--own-light",
    type=click.FloatRange(0),
    default=0.0,
    metavar="MILLIONS",
    help="Walk light afresh for each trial, some million collisions.",
)
@click.option(
    "--model", "models", multiple=True, type=click.Choice(["mc", "dipole", "auto"]), help="Default: all three."
)
def trials(
    out: Path | None,
    force: bool,
    trials: int,
    scale_sd: float,
    length_sd: float,
    own_light: float,
    models: tuple[Literal["mc", "dipole", "auto"], ...],
) -> None:
    """Do errors, bounds and intervals hold on the engine's own light?

    Fits every cell of the table, again and again.
    """
    from bssrdf.bench.trials import MODELS, Drawn, run_trials, table
    from bssrdf.report import steps

    with steps(quiet=is_quiet()) as progress:
        outcomes = run_trials(
            out=out and fresh(out, force),
            progress=progress,
            trials=trials,
            models=models or MODELS,
            drawn=Drawn(scale_sd, length_sd),
            own_steps=1e6 * own_light,
        )
    click.echo(table(outcomes))


@bench.command()
@OUT
@force_option
@click.option("--sessions", type=click.IntRange(1), default=20, show_default=True, help="Of each fault.")
@click.option("--fault", "faults", multiple=True, help="Only this one; may be given again.")
@click.option("--material", default="marble", show_default=True, help="What lies under the beam.")
@click.option("--view-angle", "view_angle_deg", default=45.0, show_default=True, help="Of the camera [deg].")
@click.option("--incidence", "incidence_deg", default=0.0, show_default=True, help="Of the beam [deg].")
@click.option("--spot-aspect", default=1.0, show_default=True, help="Length of the spot over its width.")
@click.option("--spread-aspect", default=1.0, show_default=True, help="The same of the light in a fibrous sample.")
def frames(out: Path | None, force: bool, sessions: int, faults: tuple[str, ...], **setup: Any) -> None:
    """Sessions with faults: are they refused, or do intervals hold?

    Faults of lamp, black, darks and labels.
    """
    from bssrdf.bench.frame_faults import FAULTS, Setup
    from bssrdf.bench.frames import run_frames_bench, table
    from bssrdf.report import steps

    for fault in faults:
        if fault not in FAULTS:
            raise UsageError(f"--fault {fault} is not known; choose of {', '.join(FAULTS)}")
    with steps(quiet=is_quiet()) as progress:
        found = run_frames_bench(
            seeds=sessions,
            faults=faults or tuple(FAULTS),
            setup=Setup(**setup),
            out=out and fresh(out, force),
            progress=progress,
        )
    click.echo(table(found))


@bench.command()
@click.option("--out", type=click.Path(path_type=Path), default=Path("bench-transport"), show_default=True)
@force_option
def transport(out: Path, force: bool) -> None:
    """Time to 1 % error in every bin; a table beside the dipole."""
    from bssrdf.bench.transport import run

    click.echo(json.dumps(run(fresh(out, force)), indent=1))


@bench.command()
@click.option("--out", type=click.Path(path_type=Path), default=Path("bench-capture"), show_default=True)
@click.option("--kills", type=int, default=100, show_default=True, help="Captures ended by SIGKILL.")
def capture(out: Path, kills: int) -> None:
    """Every fault of the bench at every step, and captures killed.

    At random moments, on the simulated bench.
    """
    from bssrdf.bench.capture import run_bench

    click.echo(run_bench(fresh(out, force=False), kills=kills))


@bench.command()
@OUT
@force_option
@click.option("--material", "materials", multiple=True, help="Only this one; may be given again.")
@click.option("--scene", "scenes", multiple=True, help="Only this one, such as `ball 10`; may be given again.")
@click.option("--quick", is_flag=True, help="Two scenes of marble, to see that it works.")
def render(out: Path | None, force: bool, materials: tuple[str, ...], scenes: tuple[str, ...], quick: bool) -> None:
    """Noise and bias of BRDF, BSSRDF and full Monte Carlo.

    On slabs, balls and a bust of six materials.
    """
    from dataclasses import replace

    from bssrdf.bench.render import QUICK, Effort, run_render_bench
    from bssrdf.bench.render_results import table
    from bssrdf.report import steps

    effort = QUICK if quick else Effort()
    effort = replace(effort, materials=materials or effort.materials, scenes=scenes or effort.scenes)
    with steps(quiet=is_quiet()) as progress:
        results = run_render_bench(out and fresh(out, force), effort=effort, progress=progress)
    click.echo(table(results))


@bench.command()
@OUT
@force_option
@click.option(
    "--python", "pythons", multiple=True, type=FILE, help="Python of an environment with bpy; may be given again."
)
@click.option("--material", "materials", multiple=True, help="Only this one; may be given again.")
@click.option("--quick", is_flag=True, help="Few samples, to see that it works.")
def export(out: Path | None, force: bool, pythons: tuple[Path, ...], materials: tuple[str, ...], quick: bool) -> None:
    """Render exported files in Cycles and Mitsuba.

    Total R and a shadow's edge against the measured medium's.
    """
    from dataclasses import replace

    from bssrdf.bench.export import QUICK, RenderEffort, run_export_bench
    from bssrdf.bench.export_results import table
    from bssrdf.report import steps

    effort = replace(QUICK if quick else RenderEffort(), materials=materials)
    with steps(quiet=is_quiet()) as progress:
        points, skipped = run_export_bench(out and fresh(out, force), pythons, effort=effort, progress=progress)
    click.echo(table(points, skipped))


@bench.command()
@OUT
@force_option
@click.option("--slices", "sizes", type=click.IntRange(1), multiple=True, help="In a Parquet file; may be given again.")
@click.option("--files", type=click.IntRange(1), default=300, show_default=True, help="slice.csv files.")
@click.option("--workers", type=click.IntRange(1), multiple=True, help="Of a batch; may be given again.")
@click.option("--sessions", type=click.IntRange(1), default=8, show_default=True, help="For each worker to measure.")
@click.option("--rounds", type=click.IntRange(1), default=4, show_default=True, help="Workers, then plain processes.")
@click.option("--jax", "jax_curves", type=click.IntRange(0), default=0, help="Curves to fit by JAX too, on its device.")
def scale(
    out: Path | None,
    force: bool,
    sizes: tuple[int, ...],
    files: int,
    workers: tuple[int, ...],
    sessions: int,
    rounds: int,
    jax_curves: int,
) -> None:
    """Curves per second by size, sessions per second by workers.

    Each beside the fits alone, and beside plain processes.
    """
    from bssrdf.bench.scale import SIZES, WORKERS, run_scale_bench, table
    from bssrdf.report import steps

    with steps(quiet=is_quiet()) as progress:
        scores = run_scale_bench(
            out=out and fresh(out, force),
            sizes=sizes or SIZES,
            files=files,
            workers=workers or WORKERS,
            sessions=sessions,
            rounds=rounds,
            jax_curves=jax_curves,
            progress=progress,
        )
    click.echo(table(scores))


@bench.command()
@click.option("--cluster", default="local:2", show_default=True, help="As for `batch`.")
@click.option("--core-seconds", type=click.FloatRange(min=0, min_open=True), default=60.0, show_default=True)
def tables(cluster: str, core_seconds: float) -> None:
    """Walk a Monte Carlo table here and on a cluster, bit for bit."""
    from bssrdf.bench.scale import run_tables_bench
    from bssrdf.report import steps

    with steps(quiet=is_quiet()) as progress:
        result = run_tables_bench(cluster, core_seconds, progress=progress)
    click.echo(json.dumps(result, indent=1))


@click.command(cls=Command)
@click.option("--out", type=FOLDER, default=Path("demo"), show_default=True, help="Folder for sessions and table.")
@click.option("--seed", type=int, default=2001, show_default=True, help="Draws the errors of scale and tile.")
@force_option
def demo(out: Path, seed: int, force: bool) -> None:
    """Simulate, measure and fit twelve materials; compare with print.

    Each is a session as a camera makes it; the values found stand beside the published ones.
    """
    from bssrdf.bench.demo import run_demo
    from bssrdf.report import stages

    folder = fresh(out, force)
    with stages("demo", quiet=is_quiet()) as progress:
        text = run_demo(folder, seed=seed, progress=progress)
    click.echo(f"{text}\n{folder}/*/report.html: a page on each")
