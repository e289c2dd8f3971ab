"""The command line: the group of all commands, each of which lives in commands/."""

from __future__ import annotations

import gc
import os
import sys

import click

from bssrdf import __version__
from bssrdf.commands.batch import batch, convert
from bssrdf.commands.bench import bench, demo
from bssrdf.commands.calibrate import calibrate
from bssrdf.commands.console import Group, run
from bssrdf.commands.curve import curve
from bssrdf.commands.export import export
from bssrdf.commands.fit import fit, table, validate
from bssrdf.commands.measure import measure, views
from bssrdf.commands.render import compare, doctor, render
from bssrdf.commands.report import report
from bssrdf.commands.rig import capture, rig
from bssrdf.commands.sessions import ingest, init, verify

COMMANDS = (
    batch,
    bench,
    calibrate,
    capture,
    compare,
    convert,
    curve,
    demo,
    doctor,
    export,
    fit,
    ingest,
    init,
    measure,
    render,
    report,
    rig,
    table,
    validate,
    verify,
    views,
)


_GARBAGE = 100_000
"""New objects after which Python looks for cycles among them. At its own 700 that is 5 % of a small `measure`: imports
alone make many more, all to stay."""


@click.group(cls=Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="bssrdf")
def cli() -> None:
    """Measure, fit and render light under the surface of translucent materials."""


for command in COMMANDS:
    cli.add_command(command)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit code."""
    gc.set_threshold(_GARBAGE)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy: it would wait for work on every other core
    sys.exit(run(cli, sys.argv[1:] if arguments is None else arguments))


if __name__ == "__main__":
    main()
