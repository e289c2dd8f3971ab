"""`bssrdf export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bssrdf.commands.console import FOLDER, Command, force_option, fresh, is_quiet, warn
from bssrdf.errors import UsageError


@click.command(cls=Command)
@click.argument("material", metavar="FIT_OR_MATERIAL")
@click.option(
    "--to",
    "target",
    type=click.Choice(["blender", "mitsuba", "pbrt", "openpbr", "usd"]),
    required=True,
    help="For what.",
)
@click.option("--renderer-version", metavar="X.Y", help="Only for this version (default: all that are known).")
@click.option(
    "--unit", type=click.Choice(["mm", "cm", "m"]), help="Of the scene. Default: Blender's scene, m for usd, else mm."
)
@click.option(
    "--keep",
    type=click.Choice(["appearance", "medium"]),
    help="Looks or coefficients. Default: medium for mitsuba and pbrt, appearance for others.",
)
@click.option(
    "--space",
    type=click.Choice(["lin_rec709", "acescg", "camera"]),
    help="Colour space that the fit must be in. Default: as it is.",
)
@click.option(
    "--rgb", metavar="NAME,NAME,NAME", default="R,G,B", show_default=True, help="Channels for red, green, blue."
)
@click.option("--untrusted", is_flag=True, help="Write what the fit does not vouch for, and say so in the file.")
@click.option("--out", type=FOLDER, required=True, help="File to write, or a folder for one file a material.")
@force_option
def export(
    material: str,
    target: Any,
    renderer_version: str | None,
    unit: Any,
    keep: Any,
    space: str | None,
    rgb: str,
    untrusted: bool,
    out: Path,
    force: bool,
) -> None:
    """Write fits or a published material for a renderer.

    A fit, a folder of fits, or the name of a material.
    """
    channels = tuple(name.strip() for name in rgb.split(","))
    if len(channels) != 3 or not all(channels):
        raise UsageError(f"--rgb {rgb}: give three channels, such as --rgb 633nm,532nm,473nm")
    fresh(out, force)
    if not out.parent.is_dir():
        raise UsageError(f"{out.parent} is not a folder; make it first, or choose another --out")

    from bssrdf.export import export_files, find_materials, read_version
    from bssrdf.report.progress import stages

    version = read_version(target, renderer_version)
    materials = find_materials(material, channels=channels, space=space, untrusted=untrusted)
    for each in materials:
        for remark in each.remarks:
            warn(f"{each.name}: {remark}")
    with stages("matching", quiet=is_quiet()):
        written = export_files(materials, target, out, keep=keep, unit=unit, version=version)
    for path in written:
        click.echo(str(path))
