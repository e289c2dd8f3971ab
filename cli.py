"""The command line: each command parses, calls one function, prints its result and sets the exit code."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from bssrdf import __version__
from bssrdf.cli_bench import bench
from bssrdf.cli_calibrate import calibrate
from bssrdf.cli_render import compare, doctor, render
from bssrdf.console import BAD_INPUT, Group, is_quiet, run, warn
from bssrdf.errors import BssrdfError, UsageError

if TYPE_CHECKING:
    from bssrdf.session.records import Fit

FLAGGED = 5

Decorated = TypeVar("Decorated", bound=Callable[..., Any])
FOLDER = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)


@click.group(cls=Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="bssrdf")
def cli() -> None:
    """Measure, fit and render light under the surface of translucent materials."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit code."""
    sys.exit(run(cli, sys.argv[1:] if arguments is None else arguments))


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


RIG_FILE = click.option("--rig", type=FILE, help="What the bench is made of; rig.toml here if not given.")


@cli.group()
def rig() -> None:
    """What is connected, how exact its pulses are, and the panic button."""


@rig.command("list")
def rig_list() -> None:
    """Serial ports and cameras that are connected; a board is reset by asking, and says whether it is a controller."""
    from bssrdf.rig import commands

    click.echo("\n".join(commands.rig_list(listen=True)))


@rig.command("status")
@RIG_FILE
def rig_status(rig: Path | None) -> None:
    """Each device of the bench and its state."""
    from bssrdf.rig import commands

    click.echo("\n".join(commands.rig_status(rig)))


@rig.command("test")
@RIG_FILE
@click.option("--set-clock", is_flag=True, help="Measure the controller's clock for a minute and keep its error there.")
def rig_test(rig: Path | None, set_clock: bool) -> None:
    """Open and close the project's controller for known times and show what it read back; the beam is on meanwhile."""
    from bssrdf.rig import commands

    for line in commands.rig_test(rig, set_clock=set_clock):
        click.echo(line)


@rig.command("close")
@RIG_FILE
def rig_close(rig: Path | None) -> None:
    """Close the shutter and switch the beam off, even while another program holds the ports."""
    from bssrdf.rig import commands

    click.echo("\n".join(commands.rig_close(rig)))


@cli.command()
@click.argument("plan", type=FILE)
@click.option("--out", type=FOLDER, required=True, metavar="SESSION", help="The session to make.")
@RIG_FILE
@click.option("--simulate", is_flag=True, help="Use a simulated bench.")
@click.option("--resume", is_flag=True, help="Go on with a capture that was stopped.")
@click.option("--dry-run", is_flag=True, help="Only say which frames would be taken.")
def capture(plan: Path, out: Path, rig: Path | None, simulate: bool, resume: bool, dry_run: bool) -> None:
    """Capture what PLAN asks for into a session."""
    from bssrdf.rig import commands
    from bssrdf.rig.progress import live

    if dry_run:
        click.echo(commands.dry_run(plan, out, rig=rig, simulate=simulate))
        return
    with live(quiet=is_quiet()) as report:
        done = commands.run_capture(plan, out, rig=rig, simulate=simulate, resume=resume, report=report)
    click.echo(f"{out}: {done.frames} frames, {done.taken_now} of them taken now")


@cli.command()
@click.argument("folder", type=FOLDER)
@click.option("--out", type=FOLDER, required=True, metavar="SESSION", help="The session to make.")
@click.option(
    "--kind", "kinds", multiple=True, metavar="GLOB=KIND", help="Kind of the files that match; the last match wins."
)
@click.option("--select", metavar="TEXT", help="Only light frames with TEXT in their path; darks are kept.")
@click.option(
    "--exposure-from",
    metavar="REGEX_OR_CSV",
    help="Where exposures stand, instead of metadata and names: a regular expression with one group that finds them in "
    "the path, or a .csv file with the columns file,exposure_s (and page, for stacks).",
)
@click.option("--layout", help='Colour filter pattern such as RGGB, "mono" or "rgb", where the file does not tell.')
@click.option("--black", type=float, help="DN without light, where the file does not tell.")
@click.option("--white", type=float, help="DN at saturation, where the file does not tell.")
@click.option("--response", is_flag=True, help="Take JPEG and PNG as well, and have their response curve fitted.")
@_force
def ingest(
    folder: Path,
    out: Path,
    kinds: tuple[str, ...],
    select: str | None,
    exposure_from: str | None,
    response: bool,
    force: bool,
    **camera: Any,
) -> None:
    """Copy the RAW, TIFF or other frames of FOLDER into a session; exposures from metadata or from file names."""
    from bssrdf.session.ingest import ingest_folder

    frames = ingest_folder(
        folder,
        _fresh(out, force),
        kinds=kinds,
        select=select,
        camera=camera,
        exposure_from=exposure_from,
        response=response,
    )
    counts = {kind: sum(frame.kind == kind for frame in frames) for kind in sorted({frame.kind for frame in frames})}
    click.echo(f"{out}: " + ", ".join(f"{n} {kind}" for kind, n in counts.items()))
    click.echo(
        f"{out / 'session.toml'}: put in what was measured and with what; `measure --hdr-only` needs [camera] alone"
    )


@cli.command()
@click.argument("session", type=FOLDER)
def verify(session: Path) -> None:
    """Look whether SESSION is complete and unchanged: tables, frames, checksums, darks."""
    from bssrdf.session.verify import verify_session

    verified = verify_session(session)
    for fault in verified.faults:
        warn(fault)
    if verified.faults:
        click.get_current_context().exit(BAD_INPUT)
    summed = sum(frame.sha256 is not None for frame in verified.frames)
    click.echo(f"{session}: complete, {len(verified.frames)} frames, {summed} of them with a checksum that holds")


@cli.command()
@click.argument("session", type=FOLDER)
@click.option("--hdr-only", is_flag=True, help="Only merge the brackets; session.toml needs [camera] alone.")
@click.option("--from-hdr", is_flag=True, help="Start from the images that an earlier run wrote; no frame is read.")
@click.option("--radial", is_flag=True, help="Average over the whole image instead of a band along the slice.")
@click.option(
    "--band-mm", type=click.FloatRange(min=0, min_open=True), help="Width of the band along the slice; else 10 pixels."
)
@click.option("--glare", is_flag=True, help="Take an even floor for veiling glare, and subtract it.")
@click.option(
    "--hdr-rel-sd",
    type=click.FloatRange(min=0, min_open=True),
    help="Relative error of a pixel in images merged elsewhere, instead of their scatter.",
)
def measure(session: Path, **options: Any) -> None:
    """Merge the brackets of SESSION; write HDR images, the slice and the total reflectance into measured/."""
    if options["from_hdr"] and (options["hdr_only"] or options["hdr_rel_sd"]):
        raise UsageError("--from-hdr makes no images; leave out --hdr-only and --hdr-rel-sd")

    from bssrdf.measure.session import measure_session
    from bssrdf.report.measured_text import measured_text
    from bssrdf.report.progress import steps
    from bssrdf.session.session_toml import read_session

    with steps(quiet=is_quiet()) as progress:
        known = read_session(session, complete=not options["hdr_only"])
        measured = measure_session(known, progress=progress, **options)
    click.echo(measured_text(measured))


@cli.command()
@click.argument("inputs", nargs=-1, required=True, type=FOLDER, metavar="SESSION_OR_SLICE...")
def views(inputs: tuple[Path, ...]) -> None:
    """Hold slices of one sample under several view angles against each other: do they follow the exit law?"""
    from bssrdf.measure.views import views_text
    from bssrdf.session.slice_csv import read_slice
    from bssrdf.workflow import slice_file

    click.echo(views_text([read_slice(slice_file(path)) for path in inputs]))


def _by_channel(_: click.Context, option: click.Parameter, given: tuple[str, ...]) -> float | dict[str, float] | None:
    """`CHANNEL=number` options as a table by channel, or one bare number for all channels."""
    try:
        if len(given) == 1 and "=" not in given[0]:
            return float(given[0])
        return {channel: float(value) for channel, value in (text.rsplit("=", 1) for text in given)} or None
    except ValueError:
        message = f"{' '.join(given)}: write one number, or CHANNEL=number for each channel, such as G=0.79"
        raise click.BadParameter(message, param=option) from None


def _channel_option(name: str, text: str) -> Callable[[Decorated], Decorated]:
    return click.option(name, multiple=True, callback=_by_channel, metavar="[CHANNEL=]NUMBER", help=text)


SLICE_KEYS = (
    click.option("--eta", type=float, help="Relative index of refraction."),
    click.option("--g", type=float, help="Mean cosine of the phase function."),
    click.option("--eta-sd", type=float, help="Error of eta."),
    click.option("--g-sd", type=float, help="Error of g."),
    click.option("--flux", type=click.Choice(["incident", "entering"]), help="What R_d is per unit of."),
    click.option("--exit", type=click.Choice(["hemisphere", "lambertian", "fresnel"]), help="What the camera saw."),
    click.option("--view-angle-deg", type=float, help="Camera against the surface normal."),
    click.option("--view-angle-sd-deg", type=float, help="Error of the view angle."),
    click.option("--azimuth", type=click.Choice(["perpendicular", "mean"]), help="Of the camera about the normal."),
    click.option("--band-mm", type=float, help="Width along the view of the pixels that make a slice."),
    click.option("--incidence-deg", type=float, help="Beam against the surface normal."),
    _channel_option("--total-r", "Total reflectance, in the convention of the curve."),
    _channel_option("--total-r-sd", "Its standard deviation."),
    _channel_option("--lost-fraction", "Share of the light beyond the frame."),
    click.option("--spot-radius-mm", type=float, help="1/e² radius of the spot."),
    click.option("--spot-radius-sd-mm", type=float, help="Its error."),
    click.option("--scale-rel-sd", type=float, help="Relative error common to curve and total."),
    click.option("--mm-rel-sd", type=float, help="Relative error of the length scale."),
    click.option("--shared-errors", help="Slices of the same text share errors of scale and length."),
    click.option("--material", help="Name of the material."),
    click.option("--unit", type=click.Choice(["mm", "cm", "m", "um"]), help="Of radii; R_d is in 1 over its square."),
)
"""Keys of slice.csv, which win over the file's."""


def _slice_keys(command: Decorated) -> Decorated:
    for option in reversed(SLICE_KEYS):
        command = option(command)
    return command


@cli.command()
@click.argument("inputs", nargs=-1, required=True, type=FOLDER, metavar="SESSION_OR_SLICE...")
@click.option("--model", type=click.Choice(["auto", "dipole", "mc"]), default="auto", show_default=True)
@click.option(
    "--constraint",
    type=click.Choice(["exact", "soft", "none"]),
    help="Default: soft where total_r_sd is given, exact where total_r alone is, else none.",
)
@click.option("--scale", type=click.Choice(["given", "free"]), default="given", show_default=True)
@click.option(
    "--window-mm", type=float, nargs=2, metavar="LO HI", help="Radii to use, instead of the automatic window."
)
@click.option("--fit-g", is_flag=True, help="Fit g as well, from the shape near the source.")
@click.option("--joint", is_flag=True, help="Fit all inputs, of one material, together: one result.")
@click.option("--robust", is_flag=True, help="Huber's loss, for dust and glare; the fit is flagged.")
@click.option(
    "--tables",
    type=click.Choice(["make", "cached", "shipped"]),
    default="make",
    show_default=True,
    help="Monte Carlo tables to use: any, made where none is at hand; those at hand; those that ship.",
)
@click.option("--explain", is_flag=True, help="Say how --model auto chooses.")
@click.option("--json", "as_json", is_flag=True, help="One compact JSON object a line.")
@click.option("--out", type=FILE, help="Write the fit here (one input).")
@click.option("--strict", is_flag=True, help="Exit code 5 where a result is unidentifiable or rejected.")
@_force
@_slice_keys
def fit(
    inputs: tuple[Path, ...],
    model: Any,
    constraint: Any,
    scale: Any,
    window_mm: tuple[float, float] | None,
    fit_g: bool,
    joint: bool,
    robust: bool,
    tables: Any,
    explain: bool,
    as_json: bool,
    out: Path | None,
    strict: bool,
    force: bool,
    **keys: Any,
) -> None:
    """Fit σa and σs′ to each slice; a session's fit is written to its fit.json."""
    if out is not None and len(inputs) > 1 and not joint:
        raise UsageError(f"--out takes one input, not {len(inputs)}; fit them one by one or --joint, or use --json")
    if joint and fit_g:
        raise UsageError("--joint takes no --fit-g: give g by --g")
    if window_mm is not None and not 0 <= window_mm[0] < window_mm[1]:
        raise UsageError(f"--window-mm {window_mm[0]:g} {window_mm[1]:g} must be two radii, the smaller one first")
    target = out and _fresh(out, force)

    from bssrdf.fit.models import Making
    from bssrdf.fit.run import FitOptions
    from bssrdf.report.fit_text import fit_text
    from bssrdf.session.fit_json import failure_line, fit_line
    from bssrdf.workflow import fit_files, fit_joint_files

    if explain:
        from bssrdf.fit.models import RULE

        click.echo(RULE, err=as_json)
    options = FitOptions(
        model=model, constraint=constraint, scale=scale, window_mm=window_mm, robust=robust, tables=tables
    )
    given = {name: value for name, value in keys.items() if value is not None}
    outcomes: list[Fit | BssrdfError]
    making = Making(_announce, _progress if sys.stderr.isatty() and not is_quiet() else None)
    if joint:
        outcomes = [fit_joint_files(inputs, options, given, out=target, making=making, warn=warn)]
    else:
        outcomes = fit_files(inputs, options, given, out=target, with_g=fit_g, making=making, warn=warn)
    code = 0
    for path, outcome in zip(inputs, outcomes, strict=not joint):
        if isinstance(outcome, BssrdfError):
            code = outcome.exit_code
            click.echo(failure_line(path, outcome)) if as_json else warn(str(outcome))
            continue
        click.echo(fit_line(outcome) if as_json else fit_text(outcome))
        if strict and any(channel.status in ("unidentifiable", "rejected") for channel in outcome.channels.values()):
            code = code or FLAGGED
    click.get_current_context().exit(code)


def _announce(seconds: float) -> None:
    warn(f"no Monte Carlo table ships for this medium: one is made now, in about {seconds:.0f} s, and kept")


def _progress(done: int, total: int) -> None:
    click.echo(f"\rMonte Carlo table: {100 * done // max(total, 1)} %", nl=done >= total, err=True)


@cli.command()
@click.argument("inputs", nargs=-1, type=FOLDER, metavar="[FIT_OR_SESSION]...")
@click.option("--format", "form", type=click.Choice(["md", "csv", "json", "latex"]), default="md", show_default=True)
def table(inputs: tuple[Path, ...], form: Any) -> None:
    """Print the material table of the fits; with none, the published one checked against its own reflectances."""
    from bssrdf.report.table import fits_table, published_table
    from bssrdf.workflow import read_fits, stale

    fits = read_fits(inputs)
    for message in filter(None, map(stale, inputs, fits)):
        warn(message)
    click.echo(fits_table(fits, form) if fits else published_table(form))


@cli.command()
@click.option("--out", type=FOLDER, default=Path("demo"), show_default=True, help="Folder for sessions and table.")
@click.option("--seed", type=int, default=2001, show_default=True, help="Draws the errors of scale and tile.")
@_force
def demo(out: Path, seed: int, force: bool) -> None:
    """Make sessions on the simulated bench, measure and fit them, and print recovered against published values."""
    from bssrdf.bench.demo import run_demo
    from bssrdf.report.progress import stages

    folder = _fresh(out, force)
    with stages("demo", quiet=is_quiet()) as progress:
        text = run_demo(folder, seed=seed, progress=progress)
    click.echo(text)


@cli.command()
@click.argument("fit_path", type=FOLDER, metavar="FIT_OR_SESSION")
@click.option("--out", type=FILE, help="Picture to write; validation.png beside the fit if not given.")
@_force
def validate(fit_path: Path, out: Path | None, force: bool) -> None:
    """Simulate the fitted coefficients photon by photon and draw data, dipole and Monte Carlo (the paper's Fig. 6)."""
    from bssrdf.report.progress import steps
    from bssrdf.report.validation import validation_text
    from bssrdf.workflow import validate_fit

    picture = _fresh(out, force) if out else (fit_path if fit_path.is_dir() else fit_path.parent) / "validation.png"
    with steps(quiet=is_quiet()) as progress:
        checks = validate_fit(fit_path, picture, progress=progress)
    click.echo(f"{validation_text(checks)}\n{picture}")


cli.add_command(calibrate)
cli.add_command(render)
cli.add_command(compare)
cli.add_command(doctor)
cli.add_command(bench)


if __name__ == "__main__":
    main()
