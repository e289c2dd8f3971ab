"""`bssrdf fit`, `bssrdf table` and `bssrdf validate`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bssrdf.commands.console import FILE, FLAGGED, FOLDER, Command, Decorated, force_option, fresh, is_quiet, warn
from bssrdf.errors import BssrdfError, UsageError

if TYPE_CHECKING:
    from bssrdf.session.records import Fit


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


@click.command(cls=Command)
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
@force_option
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
    target = out and fresh(out, force)

    from bssrdf.commands.files import fit_files, fit_joint_files
    from bssrdf.fit.models import Making
    from bssrdf.fit.run import FitOptions
    from bssrdf.report import fit_text
    from bssrdf.session.fit_json import failure_line, fit_line

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


@click.command(cls=Command)
@click.argument("inputs", nargs=-1, type=FOLDER, metavar="[FIT_OR_SESSION]...")
@click.option("--format", "form", type=click.Choice(["md", "csv", "json", "latex"]), default="md", show_default=True)
def table(inputs: tuple[Path, ...], form: Any) -> None:
    """Print the material table of the fits; with none, the published one checked against its own reflectances."""
    from bssrdf.commands.files import read_fits, stale
    from bssrdf.report import fits_table, published_table

    fits = read_fits(inputs)
    for message in filter(None, map(stale, inputs, fits)):
        warn(message)
    click.echo(fits_table(fits, form) if fits else published_table(form))


@click.command(cls=Command)
@click.argument("fit_path", type=FOLDER, metavar="FIT_OR_SESSION")
@click.option("--out", type=FILE, help="Picture to write; validation.png beside the fit if not given.")
@force_option
def validate(fit_path: Path, out: Path | None, force: bool) -> None:
    """Simulate the fitted coefficients photon by photon and draw data, dipole and Monte Carlo (the paper's Fig. 6)."""
    from bssrdf.commands.files import validate_fit
    from bssrdf.report import steps, validation_text

    picture = fresh(out, force) if out else (fit_path if fit_path.is_dir() else fit_path.parent) / "validation.png"
    with steps(quiet=is_quiet()) as progress:
        checks = validate_fit(fit_path, picture, progress=progress)
    click.echo(f"{validation_text(checks)}\n{picture}")
