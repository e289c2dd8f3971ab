"""Options of a command that are made of declared keys, under a heading of their own in its help."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click

from bssrdf.commands.console import Command

if TYPE_CHECKING:
    from bssrdf.session.keys import Declared


class KeyCommand(Command):
    """A command with an option for each of `keys`, made when it is first asked for them; `heading` stands above them.

    Keys of one value have one, and keys of a number for each channel; limits are checked where a key is read.
    """

    def __init__(self, *args: Any, keys: Callable[[], Mapping[str, Declared]], heading: str, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._keys, self._heading = keys, heading
        self._options: list[click.Parameter] = []

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The command's own, and those of the keys."""
        self._options = self._options or [option for each in self._keys().values() if (option := _option(each))]
        return [*super().get_params(ctx), *self._options]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Those of the keys by themselves."""
        listed = [option for option in self.get_params(ctx) if isinstance(option, click.Option)]
        for heading, of_keys in (("Options", False), (self._heading, True)):
            records = [option.get_help_record(ctx) for option in listed if (option in self._options) is of_keys]
            with formatter.section(heading):
                formatter.write_dl(list(filter(None, records)))


def _option(key: Declared) -> click.Option | None:
    name, text = f"--{key.name.replace('_', '-')}", f"{key.key.help[0].upper()}{key.key.help[1:]}."
    if key.by_channel:
        return click.Option([name], multiple=True, callback=_by_channel, metavar="[CHANNEL=]NUMBER", help=text)
    if get_origin(key.kind) is Literal:
        return click.Option([name], type=click.Choice(get_args(key.kind)), help=text)
    return None if get_origin(key.kind) else click.Option([name], type=key.kind, help=text)


def _by_channel(_: click.Context, option: click.Parameter, given: tuple[str, ...]) -> float | dict[str, float] | None:
    """`CHANNEL=number` options as a table by channel, or one bare number for all channels."""
    try:
        if len(given) == 1 and "=" not in given[0]:
            return float(given[0])
        return {channel: float(value) for channel, value in (text.rsplit("=", 1) for text in given)} or None
    except ValueError:
        message = f"{' '.join(given)}: write one number, or CHANNEL=number for each channel, such as G=0.79"
        raise click.BadParameter(message, param=option) from None
