"""`bssrdf measure` and `bssrdf views`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bssrdf.commands.console import FOLDER, Command, is_quiet
from bssrdf.errors import UsageError


@click.command(cls=Command)
@click.argument("session", type=FOLDER)
@click.option("--hdr-only", is_flag=True, help="Only merge the brackets; session.toml needs [camera] alone.")
@click.option("--from-hdr", is_flag=True, help="Start from the images that an earlier run wrote; no frame is read.")
@click.option("--radial", is_flag=True, help="Average over the whole image instead of a band along the slice.")
@click.option(
    "--band-mm",
    type=click.FloatRange(min=0, min_open=True),
    help="Width of the band along the slice (default: 10 pixels).",
)
@click.option("--glare", is_flag=True, help="Take an even floor for veiling glare, and subtract it.")
@click.option(
    "--hdr-rel-sd",
    type=click.FloatRange(min=0, min_open=True),
    help="Relative error of a pixel in images merged elsewhere, instead of their scatter.",
)
@click.option(
    "--space",
    type=click.Choice(["lin_rec709", "acescg", "camera"]),
    help="Convert the slice by the matrix of `calibrate colour`, for export to a renderer.",
)
def measure(session: Path, **options: Any) -> None:
    """Merge the brackets of SESSION; write images, slice and R.

    HDR images, the slice with the total reflectance, and pictures of both go into measured/.
    """
    if options["hdr_only"] and options["space"]:
        raise UsageError("--hdr-only makes no slice; leave out --space")
    if options["from_hdr"] and (options["hdr_only"] or options["hdr_rel_sd"]):
        raise UsageError("--from-hdr makes no images; leave out --hdr-only and --hdr-rel-sd")

    from bssrdf.measure import measure_session
    from bssrdf.report import measured_text, steps
    from bssrdf.session import read_session

    with steps(quiet=is_quiet()) as progress:
        known = read_session(session, complete=not options["hdr_only"])
        measured = measure_session(known, progress=progress, **options)
    click.echo(measured_text(measured))


@click.command(cls=Command)
@click.argument("inputs", nargs=-1, required=True, type=FOLDER, metavar="SESSION_OR_SLICE...")
def views(inputs: tuple[Path, ...]) -> None:
    """Compare slices of one sample taken at several view angles."""
    from bssrdf.batch import slice_file
    from bssrdf.report import views_text
    from bssrdf.session import read_slice

    click.echo(views_text([read_slice(slice_file(path)) for path in inputs]))
