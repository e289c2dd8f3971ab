"""`bssrdf convert` and `bssrdf batch`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from bssrdf.commands.console import BAD_INPUT, FOLDER, Command, force_option, fresh, is_quiet, warn
from bssrdf.errors import UsageError

MOST_LINES = 10
"""Failures that are named on stderr; the others stand in the result."""


def warn_of(lines: Sequence[str], rest: str) -> None:
    """The first lines, and how many more there are."""
    for line in lines[:MOST_LINES]:
        warn(line)
    if len(lines) > MOST_LINES:
        warn(f"and {len(lines) - MOST_LINES} more{rest}")


@click.command(cls=Command)
@click.argument("inputs", nargs=-1, required=True, type=FOLDER, metavar="INPUT...")
@click.option("--out", type=FOLDER, required=True, help="A .parquet file, or a folder for files of their own.")
@click.option("--fits", is_flag=True, help="Take the fit.json of sessions and folders, not their slices.")
@force_option
def convert(inputs: tuple[Path, ...], out: Path, fits: bool, force: bool) -> None:
    """Slices or fits to one Parquet file, and back.

    From CSV or JSON, or from Parquet to a file for each.
    """
    from bssrdf.batch import from_parquet, is_parquet, to_parquet
    from bssrdf.report import steps

    fits = fits or all(path.suffix == ".json" for path in inputs)
    backwards = out.suffix != ".parquet"
    if backwards and (len(inputs) > 1 or not is_parquet(inputs[0])):
        raise UsageError(f"--out {out} is not a .parquet file; name one, or give one Parquet input to convert it back")
    target = fresh(out, force)
    with steps(quiet=is_quiet()) as progress:
        if backwards:
            done = from_parquet(inputs[0], target, progress=progress)
        else:
            done = to_parquet(inputs, target, fits=fits, progress=progress)
    click.echo(f"{out}: {done.written} {'files' if backwards else 'fits' if fits else 'slices'}")
    warn_of(done.failures, " that could not be read")
    if done.failures:
        click.get_current_context().exit(BAD_INPUT)
