"""`bssrdf init`, `bssrdf ingest` and `bssrdf verify`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bssrdf.commands.console import BAD_INPUT, FOLDER, Command, force_option, fresh, is_quiet, warn
from bssrdf.commands.key_options import KeyCommand

if TYPE_CHECKING:
    from bssrdf.session.keys import Declared


@click.command(cls=Command)
@click.argument("session", type=FOLDER)
@force_option
def init(session: Path, force: bool) -> None:
    """Make an empty SESSION with a commented session.toml."""
    from bssrdf.session import write_template

    write_template(session, force=force)
    click.echo(f"{session / 'session.toml'}: fill it in, put frames into frames/ and list them in frames.csv")


def _camera_keys() -> Mapping[str, Declared]:
    from bssrdf.session.keys import keys_of
    from bssrdf.session.records import Camera

    return {name: key for name, key in keys_of(Camera).items() if name in ("layout", "black", "white")}


def _numbers(_: click.Context, option: click.Parameter, given: str | None) -> list[float] | None:
    try:
        return None if given is None else [float(text) for text in given.split(",")]
    except ValueError:
        raise click.BadParameter(f"{given}: write numbers such as 0.99,0.98,0.97", param=option) from None


@click.command(cls=KeyCommand, keys=_camera_keys, heading="Keys of [camera], where the files do not tell")
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
@click.option("--material", metavar="NAME", help="What was filmed, for session.toml.")
@click.option("--eta", type=float, help="Its relative index of refraction.")
@click.option("--g", type=float, help="Its mean cosine of the phase function.")
@click.option("--mm-per-px", type=float, help="Scale in the surface, along the slice.")
@click.option("--view-angle-deg", type=float, help="Camera against the surface normal.")
@click.option("--reference", callback=_numbers, metavar="R[,R,R]", help="Radiance factor of the tile, by channel.")
@click.option("--reference-sd", callback=_numbers, metavar="R[,R,R]", help="Its error.")
@click.option("--response", is_flag=True, help="Take JPEG and PNG as well, and have their response curve fitted.")
@force_option
def ingest(
    folder: Path,
    out: Path,
    kinds: tuple[str, ...],
    select: str | None,
    exposure_from: str | None,
    response: bool,
    force: bool,
    material: str | None,
    eta: float | None,
    g: float | None,
    mm_per_px: float | None,
    view_angle_deg: float | None,
    reference: list[float] | None,
    reference_sd: list[float] | None,
    **camera: Any,
) -> None:
    """Copy the frames of FOLDER into a session.

    RAW, TIFF or others; exposures come from metadata or from file names.
    """
    from bssrdf.report import steps
    from bssrdf.session import ingest_folder

    with steps(quiet=is_quiet()) as progress:
        frames = ingest_folder(
            folder,
            fresh(out, force),
            kinds=kinds,
            select=select,
            camera=camera,
            exposure_from=exposure_from,
            response=response,
            told={
                "material": {"name": material, "eta": eta, "g": g},
                "geometry": {"mm_per_px": mm_per_px, "view_angle_deg": view_angle_deg},
                "reference": {"reflectance": reference, "reflectance_sd": reference_sd},
            },
            progress=progress,
        )
    counts = {kind: sum(frame.kind == kind for frame in frames) for kind in sorted({frame.kind for frame in frames})}
    click.echo(f"{out}: " + ", ".join(f"{n} {kind}" for kind, n in counts.items()))
    click.echo(
        f"{out / 'session.toml'}: put in what was measured and with what; `measure --hdr-only` needs [camera] alone"
    )


@click.command(cls=Command)
@click.argument("session", type=FOLDER)
def verify(session: Path) -> None:
    """Check that SESSION is complete and unchanged."""
    from bssrdf.report import steps
    from bssrdf.session import verify_session

    with steps(quiet=is_quiet()) as progress:
        verified = verify_session(session, progress=progress)
    for fault in verified.faults:
        warn(fault)
    if verified.faults:
        click.get_current_context().exit(BAD_INPUT)
    summed = sum(frame.sha256 is not None for frame in verified.frames)
    click.echo(f"{session}: complete, {len(verified.frames)} frames, {summed} of them with a checksum that holds")
