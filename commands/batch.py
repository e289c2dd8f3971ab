"""`bssrdf convert` and `bssrdf batch`."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bssrdf.commands.console import BAD_INPUT, FILE, FOLDER, Command, force_option, fresh, is_quiet, warn
from bssrdf.commands.key_options import KeyCommand
from bssrdf.errors import UsageError

if TYPE_CHECKING:
    from bssrdf.session.keys import Declared

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


def _slice_keys() -> Mapping[str, Declared]:
    from bssrdf.session.keys import keys_of
    from bssrdf.session.records import Slice

    return keys_of(Slice)


def _bytes(_: click.Context, option: click.Parameter, given: str | None) -> float | None:
    match = re.fullmatch(r"([\d.]+) ?([kMGT]?)B?", given or "0")
    try:
        size = float(match[1]) * 1000 ** " kMGT".index(match[2] or " ") if match else math.nan
    except ValueError:
        size = math.nan
    if not size >= 0:
        raise click.BadParameter(f"{given}: write a size such as 2GB", param=option)
    return size or None


@click.command(cls=KeyCommand, keys=_slice_keys, heading="Keys of slice.csv, which win over the files'")
@click.argument("what", nargs=-1, required=True, metavar="WHAT...")
@click.option("--out", type=FOLDER, required=True, help="Folder of the results; a batch that was cut short goes on.")
@click.option("--stages", default="measure,fit", show_default=True, help="Of ingest, measure, fit, report.")
@click.option("--settings", type=FILE, help="A session.toml for the sessions that ingest makes.")
@click.option("--model", type=click.Choice(["auto", "dipole", "mc"]), default="auto", show_default=True)
@click.option("--constraint", type=click.Choice(["exact", "soft", "none"]), help="As for `fit`.")
@click.option("--tables", type=click.Choice(["make", "cached", "shipped"]), default="make", show_default=True)
@click.option(
    "--cluster", metavar="local:N|ADDRESS", help="Work on N processes, or on a Dask cluster (tcp://, tls://)."
)
@click.option(
    "--chunk",
    type=click.IntRange(1),
    help="Inputs that are finished, or lost by a break, together. Default: 4 with frames, 256 without, 2048 slices of "
    "Parquet.",
)
@click.option("--memory", callback=_bytes, metavar="SIZE", help="What a worker may take, such as 2GB.")
def batch(
    what: tuple[str, ...],
    out: Path,
    stages: str,
    settings: Path | None,
    model: Any,
    constraint: Any,
    tables: Any,
    cluster: str | None,
    chunk: int | None,
    memory: float | None,
    **keys: Any,
) -> None:
    """Run stages for many sessions, here or on a cluster.

    An input is a session, a folder of them, a slice, a Parquet file of slices, a list in a .txt file, or an address.

    Nothing is written into them. Run the same command again after a break: what is done is not done again.
    """
    from bssrdf.batch import STAGES, StageOptions, run_batch
    from bssrdf.fit import FitOptions
    from bssrdf.report import steps

    named = [name.strip() for name in stages.split(",")]
    if unknown := [name for name in named if name not in STAGES]:
        raise UsageError(f"--stages {unknown[0]} is not known; choose of {','.join(STAGES)}")
    chosen = [stage for stage in STAGES if stage in named]
    given = {name: value for name, value in keys.items() if value is not None}
    options = StageOptions(
        FitOptions(model=model, constraint=constraint, tables=tables),
        given,
        str(settings.absolute()) if settings else None,
    )
    with steps(quiet=is_quiet()) as progress:
        result = run_batch(what, out, chosen, options, chunk=chunk, cluster=cluster, memory=memory, progress=progress)
    failures = result.failures
    same = f", {result.skipped} of them done before" if result.skipped else ""
    click.echo(f"{out}: {result.total} {result.unit}{same}; {len(failures)} failed; see {out / 'index.html'}")
    warn_of(failures, f": see {out / 'failures.csv'}")
    click.get_current_context().exit(BAD_INPUT if failures else 0)
