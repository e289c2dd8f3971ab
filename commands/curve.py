"""`bssrdf curve`: the forward question."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bssrdf.commands.console import FILE, Command, force_option, fresh, warn
from bssrdf.errors import UsageError


def _radii(_: click.Context, option: click.Parameter, given: str | None) -> list[float] | None:
    try:
        return None if given is None else [float(text) for text in given.split(",")]
    except ValueError:
        raise click.BadParameter(f"{given}: write radii such as 0.5,1,2", param=option) from None


@click.command(cls=Command)
@click.option("--sigma-a", type=float, required=True, help="Absorption, 1/mm or by --unit.")
@click.option("--sigma-sp", type=float, required=True, help="Reduced scattering, 1/mm or by --unit.")
@click.option("--eta", type=float, required=True, help="Relative index of refraction.")
@click.option("--g", type=float, default=0.0, show_default=True, help="Mean cosine of the phase function.")
@click.option("--r", callback=_radii, metavar="R1,R2,...", help="Radii (default: 60 over 0.3 to 30 mean free paths).")
@click.option("--unit", type=click.Choice(["mm", "cm", "m", "um"]), default="mm", show_default=True, help="Of lengths.")
@click.option("--model", type=click.Choice(["mc", "dipole"]), default="mc", show_default=True)
@click.option("--out", type=FILE, help="Write the curve here as slice.csv, instead of printing it.")
@click.option("--plot", type=FILE, help="Draw it here as PNG, dipole beside Monte Carlo.")
@force_option
def curve(r: list[float] | None, out: Path | None, plot: Path | None, force: bool, **medium: Any) -> None:
    """Print R_d(r) and R that given coefficients make."""
    from bssrdf.report import curve_csv, draw_curve
    from bssrdf.transport import Making

    if out is not None and out == plot:
        raise UsageError(f"{out}: --out and --plot name one file; give each its own")
    for path in filter(None, (out, plot)):
        fresh(path, force)
    making = Making(lambda seconds: warn(f"a Monte Carlo table is made now, in about {seconds:.0f} s, and kept"))
    text = curve_csv(r, making=making, **medium)
    if plot is not None:
        draw_curve(plot, r, making=making, **medium)
    if out is None:
        click.echo(text)
    else:
        out.write_text(f"{text}\n", encoding="utf-8")
        click.echo(out)
