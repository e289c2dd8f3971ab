"""`bssrdf rig` and `bssrdf capture`."""

from __future__ import annotations

from pathlib import Path

import click

from bssrdf.commands.console import FILE, FOLDER, Command, Group, is_quiet

RIG_FILE = click.option("--rig", type=FILE, help="Bench description (default: ./rig.toml).")


@click.group(cls=Group)
def rig() -> None:
    """What is connected, its pulses, and the panic button."""


@rig.command("list")
def rig_list() -> None:
    """Serial ports and cameras that are connected.

    A board is reset by asking, and says whether it is a controller.
    """
    from bssrdf.rig import commands

    click.echo("\n".join(commands.rig_list(listen=True)))


@rig.command("status")
@RIG_FILE
def rig_status(rig: Path | None) -> None:
    """Each device of the bench and its state."""
    from bssrdf.rig import commands

    click.echo("\n".join(commands.rig_status(rig)))


@rig.command("test")
@RIG_FILE
@click.option("--set-clock", is_flag=True, help="Measure the controller's clock for a minute and keep its error there.")
def rig_test(rig: Path | None, set_clock: bool) -> None:
    """Check the pulses of the project's controller; the beam is on.

    It opens and closes for known times, and what it read back is shown.
    """
    from bssrdf.rig import commands

    for line in commands.rig_test(rig, set_clock=set_clock):
        click.echo(line)


@rig.command("close")
@RIG_FILE
def rig_close(rig: Path | None) -> None:
    """Close the shutter and switch the beam off.

    Even while another program holds the ports.
    """
    from bssrdf.rig import commands

    click.echo("\n".join(commands.rig_close(rig)))


@click.command(cls=Command)
@click.argument("plan", type=FILE)
@click.option("--out", type=FOLDER, required=True, metavar="SESSION", help="The session to make.")
@RIG_FILE
@click.option("--simulate", is_flag=True, help="Use a simulated bench.")
@click.option("--resume", is_flag=True, help="Resume an interrupted capture.")
@click.option("--dry-run", is_flag=True, help="Only say which frames would be taken.")
def capture(plan: Path, out: Path, rig: Path | None, simulate: bool, resume: bool, dry_run: bool) -> None:
    """Capture what PLAN asks for into a session."""
    from bssrdf.report import live
    from bssrdf.rig import commands

    if dry_run:
        click.echo(commands.dry_run(plan, out, rig=rig, simulate=simulate))
        return
    with live(quiet=is_quiet()) as report:
        done = commands.run_capture(plan, out, rig=rig, simulate=simulate, resume=resume, report=report)
    click.echo(f"{out}: {done.frames} frames, {done.taken_now} of them taken now")
