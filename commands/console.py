"""How the command line behaves whatever the command: common options, one line for an error, the exit code.

0 done · 1 internal error · 2 wrong usage · 3 bad input · 4 a device failed · 5 flagged, with --strict · 130 interrupted
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar
from unicodedata import category

import click

from bssrdf.errors import BssrdfError, UsageError

INTERRUPTED = 130
BUG = 1
WRONG_USAGE = 2
BAD_INPUT = 3
FLAGGED = 5

Decorated = TypeVar("Decorated", bound=Callable[..., Any])
FOLDER = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)


def _remember(context: click.Context, option: click.Parameter, given: bool) -> None:
    settings = context.find_root().ensure_object(dict)
    settings[option.name] = settings.get(option.name, False) or given


def _common_options() -> list[click.Parameter]:
    return [
        click.Option([name], is_flag=True, expose_value=False, callback=_remember, help=text)
        for name, text in (("--quiet", "No progress."), ("--debug", "Show tracebacks."))
    ]


class Command(click.Command):
    """A command with the options that every command has."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.params += _common_options()

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Options that are no more, hidden so that they can say so, are not what a misspelt one could mean."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            shown = {name for each in self.get_params(ctx) if not getattr(each, "hidden", False) for name in each.opts}
            living = sorted(shown.intersection(error.possibilities or ()))
            raise click.NoSuchOption(error.option_name, possibilities=living, ctx=ctx) from None


class Group(click.Group):
    """A group whose commands are `Command`s; it takes the common options too."""

    command_class = Command
    group_class = type

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.params += _common_options()


def is_quiet() -> bool:
    """Whether --quiet was given, before or after the command."""
    return bool(click.get_current_context().find_root().ensure_object(dict).get("quiet"))


def warn(message: str) -> None:
    """One line on stderr."""
    line = "".join("\N{REPLACEMENT CHARACTER}" if category(c) == "Cc" else c for c in " ".join(message.splitlines()))
    click.echo(f"bssrdf: {line}", err=True)


def run(group: click.Group, arguments: list[str]) -> int:
    """Run the command that the arguments name; its exit code."""
    try:
        code = group.main(arguments, prog_name="bssrdf", standalone_mode=False)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except SystemExit:
        return 0  # click's answer to a reader that has had enough, such as `head`
    except click.ClickException as error:
        error.show()
        return WRONG_USAGE
    except (click.Abort, KeyboardInterrupt):
        warn("interrupted")
        return INTERRUPTED
    except BssrdfError as error:
        return _failed(arguments, error, str(error), error.exit_code)
    except OSError as error:
        what = ": ".join(str(part) for part in (error.filename, error.strerror or error) if part)
        return _failed(arguments, error, f"{what}; check path, permissions and space", BAD_INPUT)
    except ImportError as error:
        if (error.name or "bssrdf").partition(".")[0] == "bssrdf":
            return _failed(arguments, error, f"an internal error: {error!r} (--debug shows where)", BUG)
        line = f"{error.name} cannot be imported ({error}); install it again, and see `bssrdf doctor`"
        return _failed(arguments, error, line, BAD_INPUT)
    except Exception as error:
        return _failed(arguments, error, f"an internal error: {error!r} (--debug shows where)", BUG)
    return code if isinstance(code, int) else 0


def _failed(arguments: list[str], error: Exception, line: str, code: int) -> int:
    if "--debug" in arguments:
        traceback.print_exception(error)
    warn(line)
    return code


def force_option(command: Decorated) -> Decorated:
    """The option --force, for commands that write."""
    return click.option("--force", is_flag=True, help="Replace what stands at the output.")(command)


def fresh(path: Path, force: bool) -> Path:
    """The path to write to; it must not exist, unless it is to be replaced."""
    if path.exists() and not force:
        raise UsageError(f"{path} exists already; choose another --out, or replace it with --force")
    return path
