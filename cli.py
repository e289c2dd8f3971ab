"""The command line: each command parses, calls one function, prints its result and sets the exit code.

0 done · 1 a bug of ours · 2 wrong usage · 3 bad input · 4 a device failed · 5 flagged, with --strict · 130 interrupted
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from bssrdf import __version__
from bssrdf.errors import BssrdfError, UsageError

Decorated = TypeVar("Decorated", bound=Callable[..., Any])
FOLDER = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)


class Command(click.Command):
    """A command with the options that every command has."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.params += [
            click.Option(["--quiet"], is_flag=True, expose_value=False, callback=_remember, help="No progress."),
            click.Option(["--debug"], is_flag=True, expose_value=False, callback=_remember, help="Show tracebacks."),
        ]


class Group(click.Group):
    """A group whose commands are `Command`s."""

    command_class = Command
    group_class = type


def _remember(context: click.Context, option: click.Parameter, given: bool) -> bool:
    settings = context.find_root().ensure_object(dict)
    settings[option.name] = settings.get(option.name, False) or given
    return given


def _quiet() -> bool:
    return bool(click.get_current_context().find_root().ensure_object(dict).get("quiet"))


@click.group(cls=Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="bssrdf")
@click.option("--quiet", is_flag=True, expose_value=False, callback=_remember, help="No progress.")
@click.option("--debug", is_flag=True, expose_value=False, callback=_remember, help="Show tracebacks.")
def cli() -> None:
    """Measure, fit and render light under the surface of translucent materials."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit code."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        code = cli.main(arguments, prog_name="bssrdf", standalone_mode=False)
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.ClickException as error:
        error.show()
        code = 2
    except (click.Abort, KeyboardInterrupt):
        click.echo("bssrdf: interrupted", err=True)
        code = 130
    except BssrdfError as error:
        code = _fail(arguments, error, f"bssrdf: {error}", error.exit_code)
    except Exception as error:
        code = _fail(arguments, error, f"bssrdf: a bug of ours: {error!r} (--debug shows where)", 1)
    sys.exit(code if isinstance(code, int) else 0)


def _fail(arguments: list[str], error: Exception, line: str, code: int) -> int:
    if "--debug" in arguments:
        traceback.print_exception(error)
    click.echo(line, err=True)
    return code


def _force(command: Decorated) -> Decorated:
    return click.option("--force", is_flag=True, help="Replace what stands at the output.")(command)


def _fresh(path: Path, force: bool) -> Path:
    if path.exists() and not force:
        raise UsageError(f"{path} exists already; choose another --out, or replace it with --force")
    return path


@cli.command()
@click.argument("session", type=FOLDER)
@_force
def init(session: Path, force: bool) -> None:
    """Make an empty SESSION with a commented session.toml."""
    from bssrdf.session.session_toml import write_template

    write_template(session, force=force)
    click.echo(f"{session / 'session.toml'}: fill it in, put frames into frames/ and list them in frames.csv")


@cli.command()
@click.argument("folder", type=FOLDER)
@click.option("--out", type=FOLDER, required=True, metavar="SESSION", help="The session to make.")
@click.option(
    "--kind", "kinds", multiple=True, metavar="GLOB=KIND", help="Kind of the files that match; the last match wins."
)
@click.option("--select", metavar="TEXT", help="Only files with TEXT in their path, and those that a --kind names.")
@click.option("--layout", help='Colour filter pattern such as RGGB, "mono" or "rgb", where the file does not tell.')
@click.option("--black", type=float, help="DN at no light.")
@click.option("--white", type=float, help="DN at saturation.")
@_force
def ingest(
    folder: Path,
    out: Path,
    kinds: tuple[str, ...],
    select: str | None,
    layout: str | None,
    black: float | None,
    white: float | None,
    force: bool,
) -> None:
    """Copy the RAW or TIFF files of FOLDER into a session; exposures from EXIF or from file names."""
    from bssrdf.session.ingest import ingest_folder
    from bssrdf.session.records import Camera

    frames = ingest_folder(
        folder, _fresh(out, force), kinds=kinds, select=select, camera=Camera(layout=layout, black=black, white=white)
    )
    counts = {kind: sum(frame.kind == kind for frame in frames) for kind in sorted({frame.kind for frame in frames})}
    click.echo(f"{out}: " + ", ".join(f"{n} {kind}" for kind, n in counts.items()))


@cli.command()
@click.argument("session", type=FOLDER)
@click.option("--hdr-only", is_flag=True, help="Only merge the brackets; session.toml needs [camera] alone.")
@click.option("--radial", is_flag=True, help="Average over the whole image instead of a band along the slice.")
def measure(session: Path, hdr_only: bool, radial: bool) -> None:
    """Merge the brackets of SESSION; write HDR images, the slice and the total reflectance into measured/."""
    from bssrdf.measure.session import measure_session
    from bssrdf.report.measured_text import measured_text
    from bssrdf.report.progress import steps
    from bssrdf.session.session_toml import read_session

    with steps(quiet=_quiet()) as progress:
        measured = measure_session(read_session(session), hdr_only=hdr_only, radial=radial, progress=progress)
    click.echo(measured_text(measured))


def _by_channel(_: click.Context, option: click.Parameter, given: tuple[str, ...]) -> dict[str, float]:
    """`CHANNEL=number` options as a table by channel."""
    try:
        return {channel: float(value) for channel, value in (text.rsplit("=", 1) for text in given)}
    except ValueError:
        raise click.BadParameter(f"{' '.join(given)}: write CHANNEL=number, such as G=0.79", param=option) from None


SLICE_KEYS = (
    click.option("--eta", type=float, help="Relative index of refraction."),
    click.option("--g", type=float, help="Mean cosine of the phase function."),
    click.option("--flux", type=click.Choice(["incident", "entering"])),
    click.option("--exit", type=click.Choice(["hemisphere", "lambertian", "fresnel"])),
    click.option("--view-angle-deg", type=float),
    click.option("--incidence-deg", type=float),
    click.option("--total-r", multiple=True, callback=_by_channel, metavar="CHANNEL=R", help="Total reflectance."),
    click.option("--total-r-sd", multiple=True, callback=_by_channel, metavar="CHANNEL=SD"),
    click.option("--spot-radius-mm", type=float, help="1/e² radius of the spot."),
    click.option("--scale-rel-sd", type=float, help="Relative error common to curve and total."),
    click.option("--mm-rel-sd", type=float, help="Relative error of the length scale."),
    click.option("--material", help="Name of the material."),
)


def _slice_keys(command: Decorated) -> Decorated:
    for option in reversed(SLICE_KEYS):
        command = option(command)
    return command


@cli.command()
@click.argument("inputs", nargs=-1, required=True, type=FOLDER, metavar="SESSION_OR_SLICE...")
@click.option("--model", type=click.Choice(["auto", "dipole", "mc"]), default="auto", show_default=True)
@click.option(
    "--constraint", type=click.Choice(["exact", "soft", "none"]), help="Default: soft where total_r_sd is given."
)
@click.option("--scale", type=click.Choice(["given", "free"]), default="given", show_default=True)
@click.option(
    "--window-mm", type=float, nargs=2, metavar="LO HI", help="Radii to use, instead of the automatic window."
)
@click.option("--json", "as_json", is_flag=True, help="One compact JSON object a line.")
@click.option("--out", type=FILE, help="Write the fit here (one input).")
@click.option("--strict", is_flag=True, help="Exit code 5 where a result is unidentifiable.")
@_force
@_slice_keys
def fit(
    inputs: tuple[Path, ...],
    model: Any,
    constraint: Any,
    scale: Any,
    window_mm: tuple[float, float] | None,
    as_json: bool,
    out: Path | None,
    strict: bool,
    force: bool,
    **keys: Any,
) -> None:
    """Fit σa and σs′ to each slice; a session's fit is written to its fit.json."""
    from bssrdf.fit.run import FitOptions
    from bssrdf.report.fit_text import fit_text
    from bssrdf.session.fit_json import failure_line, fit_line
    from bssrdf.workflow import fit_files

    if out is not None and len(inputs) > 1:
        raise UsageError(f"--out takes one input, not {len(inputs)}; fit them one by one, or use --json")
    options = FitOptions(model=model, constraint=constraint, scale=scale, window_mm=window_mm)
    keys = {name: value for name, value in keys.items() if value not in (None, {})}
    code = 0
    for path, outcome in zip(inputs, fit_files(inputs, options, keys, out=out and _fresh(out, force)), strict=True):
        if isinstance(outcome, BssrdfError):
            code = outcome.exit_code
            click.echo(failure_line(path, outcome) if as_json else f"bssrdf: {outcome}", err=not as_json)
            continue
        click.echo(fit_line(outcome) if as_json else fit_text(outcome))
        if strict and any(channel.status == "unidentifiable" for channel in outcome.channels.values()):
            code = code or 5
    click.get_current_context().exit(code)


@cli.command()
@click.argument("inputs", nargs=-1, type=FOLDER, metavar="[FIT_OR_SESSION]...")
@click.option("--format", "form", type=click.Choice(["md", "csv", "json", "latex"]), default="md", show_default=True)
def table(inputs: tuple[Path, ...], form: str) -> None:
    """Print the material table of the fits; with none, the published one checked against its own reflectances."""
    from bssrdf.report.table import fits_table, published_table
    from bssrdf.workflow import read_fits, stale

    fits = read_fits(inputs)
    for warning in filter(None, map(stale, fits)):
        click.echo(f"bssrdf: {warning}", err=True)
    click.echo(fits_table(fits, form) if fits else published_table(form))


@cli.command()
@click.option("--out", type=FOLDER, default=Path("demo"), show_default=True, help="Folder for sessions and table.")
@_force
def demo(out: Path, force: bool) -> None:
    """Make sessions on the simulated bench, measure and fit them, and print recovered against published values."""
    from bssrdf.bench.demo import run_demo
    from bssrdf.report.progress import stages

    with stages("demo", quiet=_quiet()) as progress:
        text = run_demo(_fresh(out, force), progress=progress)
    click.echo(text)


if __name__ == "__main__":
    main()
