"""`bssrdf fit`, `bssrdf table` and `bssrdf validate`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bssrdf.commands.batch import warn_of
from bssrdf.commands.console import BAD_INPUT, FILE, FLAGGED, FOLDER, Command, force_option, fresh, is_quiet, warn
from bssrdf.commands.key_options import KeyCommand
from bssrdf.errors import BssrdfError, UsageError

if TYPE_CHECKING:
    from bssrdf.session.keys import Declared
    from bssrdf.session.records import Fit


def _slice_keys() -> Mapping[str, Declared]:
    from bssrdf.session import HEADER

    return HEADER


@click.command(cls=KeyCommand, keys=_slice_keys, heading="Keys of slice.csv, which win over the file's")
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
@click.option("--json", "as_json", is_flag=True, help="One compact JSON object per line.")
@click.option("--out", type=FILE, help="Write the fit here (one input).")
@click.option("--strict", is_flag=True, help="Exit code 5 where a result is unidentifiable or rejected.")
@force_option
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
    """Fit σa and σs′ to each slice.

    A session's fit is written to its fit.json.
    """
    if out is not None and len(inputs) > 1 and not joint:
        raise UsageError(f"--out takes one input, not {len(inputs)}; fit them one by one or --joint, or use --json")
    if joint and fit_g:
        raise UsageError("--joint takes no --fit-g: give g by --g")
    if window_mm is not None and not 0 <= window_mm[0] < window_mm[1]:
        raise UsageError(f"--window-mm {window_mm[0]:g} {window_mm[1]:g} must be two radii, the smaller one first")
    target = out and fresh(out, force)
    if any(path.suffix == ".parquet" for path in (*inputs, *([out] if out else []))):
        bulk = {"joint": joint, "fit-g": fit_g, "json": as_json, "strict": strict}
        asked = {"model": model, "constraint": constraint, "scale": scale, "window_mm": window_mm}
        return _fit_bulk(inputs, target, bulk, asked | {"robust": robust, "tables": tables}, keys)

    from bssrdf.batch import fit_files, fit_joint_files
    from bssrdf.fit import RULE, FitOptions
    from bssrdf.report import fit_text
    from bssrdf.session import failure_line, fit_line
    from bssrdf.transport import Making

    if explain:
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


def _fit_bulk(
    inputs: tuple[Path, ...], out: Path | None, bulk: Mapping[str, bool], options: dict[str, Any], keys: dict[str, Any]
) -> None:
    """One Parquet file, or a folder of them, to another."""
    unfit = next((f"--{name}" for name, given in bulk.items() if given), None)
    if unfit is not None:
        raise UsageError(f"{unfit} is for files of one slice; leave it out, or `bssrdf convert` the Parquet file")
    if len(inputs) != 1 or out is None or out.suffix != ".parquet":
        raise UsageError("a Parquet file is fitted by itself into another: give one, and --out FITS.parquet")

    from bssrdf.batch import fit_parquet, is_parquet
    from bssrdf.fit import FitOptions
    from bssrdf.report import steps
    from bssrdf.transport import Making

    if not is_parquet(inputs[0]):
        raise UsageError(f"{inputs[0]} is not a Parquet file; make one of slices by `bssrdf convert`")
    given = {name: value for name, value in keys.items() if value is not None}
    with steps(quiet=is_quiet()) as progress:
        counts = fit_parquet(inputs[0], out, FitOptions(**options), given, making=Making(_announce), progress=progress)
    said = ", ".join(f"{count} {status}" for status, count in counts.statuses.most_common())
    failed = f"; {len(counts.failures)} slices failed" if counts.failures else ""
    click.echo(f"{out}: {said or 'no curve'}{failed}")
    warn_of(counts.doubts, " whose units look wrong")
    warn_of([line for _, _, line in counts.failures], f": see `error` in {out}")
    click.get_current_context().exit(BAD_INPUT if counts.failures else 0)


def _announce(seconds: float) -> None:
    warn(f"no Monte Carlo table ships for this medium: one is made now, in about {seconds:.0f} s, and kept")


def _progress(done: int, total: int) -> None:
    click.echo(f"\rMonte Carlo table: {100 * done // max(total, 1)} %", nl=done >= total, err=True)


@click.command(cls=Command)
@click.argument("inputs", nargs=-1, type=FOLDER, metavar="[FIT_OR_SESSION_OR_FOLDER]...")
@click.option("--format", "form", type=click.Choice(["md", "csv", "json", "latex"]), default="md", show_default=True)
def table(inputs: tuple[Path, ...], form: Any) -> None:
    """Print the material table of fits, or the published one.

    A folder stands for all fits in it. Without a fit the published one is
    checked against its own reflectances.
    """
    from bssrdf.batch import read_fits, stale
    from bssrdf.report import fits_table, published_table
    from bssrdf.session import fits_in

    paths = [fit for given in inputs for fit in fits_in(given)]
    fits = read_fits(paths)
    for message in filter(None, map(stale, paths, fits)):
        warn(message)
    click.echo(fits_table(fits, form) if fits else published_table(form))


@click.command(cls=Command)
@click.argument("fit_path", type=FOLDER, metavar="FIT_OR_SESSION")
@click.option("--out", type=FILE, help="Picture to write (default: validation.png beside the fit).")
@force_option
def validate(fit_path: Path, out: Path | None, force: bool) -> None:
    """Simulate the fitted coefficients and draw them over the data.

    Photon by photon; data, dipole and Monte Carlo as in the paper's Fig. 6.
    """
    from bssrdf.batch import validate_fit
    from bssrdf.report import steps, validation_text

    picture = fresh(out, force) if out else (fit_path if fit_path.is_dir() else fit_path.parent) / "validation.png"
    with steps(quiet=is_quiet()) as progress:
        checks = validate_fit(fit_path, picture, progress=progress)
    click.echo(f"{validation_text(checks)}\n{picture}")
