"""What Mitsuba's errors say, in one line."""

import re

_ORIGIN = re.compile(r"^(\[\w+\.\w+:\d+\] |InputError: )")
"""Its own source line, or the name of an error of ours that passed through it."""


def cause(error: Exception) -> str:
    """The last line of the message, which names the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return _ORIGIN.sub("", lines[-1]) if lines else repr(error)
