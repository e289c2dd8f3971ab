"""`bssrdf calibrate`: what a camera and a bench are like, written as tables that a session can name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from bssrdf.commands.console import Group, is_quiet, warn
from bssrdf.errors import UsageError

PATHS = click.Path(path_type=Path)
OUT = click.option("--out", type=PATHS, default=Path("calibration.toml"), show_default=True)
FORCE = click.option("--force", is_flag=True, help="Replace a table that the file has already.")


@click.group(cls=Group)
def calibrate() -> None:
    """Measure camera, geometry, spot or colour.

    A table goes into calibration.toml, beside those that it holds.
    """


@calibrate.command()
@click.argument("session", type=PATHS)
@OUT
@FORCE
def camera(session: Path, out: Path, force: bool) -> None:
    """Gain, read noise and saturation from the frames of SESSION."""
    from bssrdf.measure import calibrate_camera
    from bssrdf.report import steps
    from bssrdf.session import read_session

    with steps(quiet=is_quiet()) as progress:
        found = calibrate_camera(read_session(session), progress=progress)
    _add(out, {"camera": _given(asdict(found.camera))}, force)
    ratios = ", ".join(f"{label:g} s × {ratio:.4f}" for label, ratio in sorted(found.exposure_ratio.items()))
    click.echo(
        f"gain {found.camera.gain_e_per_dn:.4g} e⁻/DN (± {100 * found.gain_rel_sd:.2g} %), read noise "
        f"{found.camera.read_noise_e:.3g} e⁻, saturation {found.camera.white:.6g} DN, response bent by "
        f"{100 * found.nonlinearity:.2g} %, {found.n_hot} hot pixels\nexposures: {ratios}\n{out}: [camera] written"
    )
    for flag in found.flags:
        warn(f"flag: {flag}")


@calibrate.command()
@click.argument("images", type=PATHS, nargs=-1, required=True)
@click.option("--columns", type=int, required=True, help="Squares, or dots, across the target.")
@click.option("--rows", type=int, required=True, help="Squares, or dots, down the target.")
@click.option("--pitch-mm", type=float, required=True, help="Side of a square, or distance of the dots.")
@click.option("--kind", type=click.Choice(["charuco", "dots"]), default="charuco", show_default=True)
@click.option("--dictionary", default="DICT_4X4_250", show_default=True, help="OpenCV's name of the set of markers.")
@click.option("--layout", help="Colour filter pattern, where the files do not tell.")
@OUT
@FORCE
def geometry(
    images: tuple[Path, ...],
    columns: int,
    rows: int,
    pitch_mm: float,
    kind: Any,
    dictionary: str,
    layout: str | None,
    out: Path,
    force: bool,
) -> None:
    """Pixels to mm and lens distortion from IMAGES of a target.

    It lies on the sample's plane; the first image gives the map.
    """
    from bssrdf.calib import Target, calibrate_geometry
    from bssrdf.report import steps

    target = Target(columns, rows, pitch_mm, kind=kind, dictionary=dictionary)
    with steps(quiet=is_quiet()) as progress:
        found = calibrate_geometry(images, target, layout, progress=progress)
    tables = {"geometry": _given(asdict(found.geometry)), "distortion": asdict(found.distortion)}
    _add(out, tables, force)
    click.echo(
        f"{found.n_points} points, residual {found.residual_mm:.3g} mm ({found.residual_px:.2g} px), view "
        f"{found.geometry.view_angle_deg:.2f}°, for pictures of {found.size_px[0]} x {found.size_px[1]} px\n"
        f"{out}: [geometry] and [distortion] written"
    )


@calibrate.command()
@click.argument("image", type=PATHS)
@click.option("--layout", help="Colour filter pattern, where the file does not tell.")
@click.option("--black", type=float, help="DN at no light, where the file does not tell.")
@OUT
@FORCE
def colour(image: Path, layout: str | None, black: float | None, out: Path, force: bool) -> None:
    """Camera RGB to linear sRGB from an IMAGE of a colour chart.

    Of 24 patches; for `measure --space`.
    """
    from bssrdf.calib import calibrate_colour
    from bssrdf.session.records import Camera

    found = calibrate_colour(image, Camera(layout=layout, black=black))
    _add(out, {"colour": {"matrix": found.matrix.tolist(), "rms": found.rms}}, force)
    click.echo(f"patches missed by {found.rms:.3g} (root mean square, linear sRGB)\n{out}: [colour] written")


@calibrate.command()
@click.argument("path", type=PATHS, metavar="IMAGE_OR_CSV")
@click.option("--mm-per-px", type=click.FloatRange(min=0, min_open=True), help="Scale across the view, for an image.")
@click.option("--view-angle-deg", type=click.FloatRange(0, 90, max_open=True), default=45.0, show_default=True)
@click.option("--view-axis", type=click.Choice(["x", "y"]), default="y", show_default=True)
@click.option("--layout", help="Colour filter pattern, where the image does not tell.")
@OUT
@FORCE
def spot(
    path: Path,
    mm_per_px: float | None,
    view_angle_deg: float,
    view_axis: Any,
    layout: str | None,
    out: Path,
    force: bool,
) -> None:
    """The beam's 1/e² radius from an IMAGE of its spot.

    On a thin opaque target, or from a knife edge.

    A knife edge is a CSV table of position_mm, light.
    """
    from bssrdf.measure import radius_of_edge, radius_on_target
    from bssrdf.session.records import Geometry

    if path.suffix.lower() == ".csv":
        radius = radius_of_edge(path)
    elif mm_per_px is None:
        raise UsageError(f"{path} is an image: give its scale by --mm-per-px")
    else:
        geometry = Geometry(mm_per_px, view_angle_deg=view_angle_deg, view_axis=view_axis)
        radius = radius_on_target(path, geometry, layout)
    _add(out, {"beam": {"spot_radius_mm": radius}}, force)
    click.echo(f"spot radius {radius:.4g} mm (1/e²)\n{out}: [beam] written")


def _add(out: Path, tables: Mapping[str, Mapping[str, Any]], force: bool) -> None:
    from bssrdf.session import read_calibration, write_calibration

    present = read_calibration(out) if out.exists() else {}
    doubled = [name for name in tables if name in present]
    if doubled and not force:
        raise UsageError(f"{out} has [{doubled[0]}] already; choose another --out, or replace it with --force")
    write_calibration(out, {**present, **tables})


def _given(values: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}
