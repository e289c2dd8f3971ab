"""`bssrdf report`."""

from __future__ import annotations

from pathlib import Path

import click

from bssrdf.commands.console import FILE, FOLDER, Command, force_option, is_quiet


@click.command(cls=Command)
@click.argument("path", type=FOLDER, metavar="SESSION_OR_FIT")
@click.option("--out", type=FILE, help="HTML file to write (default: the session's report.html).")
@force_option
def report(path: Path, out: Path | None, force: bool) -> None:
    """Write one HTML page that says which numbers hold, and why."""
    from bssrdf.report import steps, write_report

    with steps(quiet=is_quiet()) as progress:
        written = write_report(path, out, force=force, progress=progress)
    click.echo(written)
