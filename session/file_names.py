"""What a file's name says about its frame: how long it was exposed, by one grammar.

A time is a number and a unit: s, sec, ms, msec, us, usec, µs. The number may have a decimal point or comma, an exponent
or, in seconds, be a fraction such as 1-250s (1/250 where a slash can stand). What touches a letter or another part
of a number is no time; words such as `exp` or `t=` may stand right before it.
"""

from __future__ import annotations

import math
import re
from pathlib import PurePosixPath

_UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6, "µs": 1e-6, "μs": 1e-6}
_TIME = re.compile(
    r"""(?<![^_\-\s()\[\]=+;@])(?<!\de[-+])(?<!\d\.e[-+])    # begins a word, and is no exponent, …
        (?:exp|exposure|et|t|time|texp|shutter|ss|tv)?=?    # … or follows one that announces a time
        (?:(?P<one>\d+)(?P<bar>[-_/∕⁄／]))?
        (?P<number>(?:\d*[.,])?\d+(?:e[+-]?\d+)?)
        \s?(?P<unit>s|sec|ms|msec|us|usec|µs|μs)
        (?=[_\-\s.()\[\]+;@]|$)                       # ends a word""",
    re.VERBOSE | re.IGNORECASE,
)
_LONGEST_S = 30.0
"""Above this many seconds a camera has no label: 1_250s is 1/250 s, while 1_4s may be frame 1 of 4 s."""


def exposure_from_name(name: str) -> float | None:
    """Exposure time [s] in a name such as `…_250ms_…`; None where there is none, or more than one that it may be."""
    times = {time for match in _TIME.finditer(name) for time in _readings(name, match)}
    return times.pop() if len(times) == 1 and 0 < min(times) < math.inf else None


def exposure_from_path(relative: PurePosixPath) -> float | None:
    """By the file's name, else by the nearest folder whose name has one."""
    for part in (relative.stem, *reversed(relative.parent.parts)):
        if _TIME.search(part):
            return exposure_from_name(part)
    return None


def seconds_of(text: str, unit: str = "s") -> float | None:
    """The exposure [s] that a text by itself stands for: by the same grammar, or a bare number of `unit`."""
    bare = re.fullmatch(r"\s*(?:(\d+)\s*/\s*)?((?:\d*[.,])?\d+(?:e[+-]?\d+)?)\s*", text, re.IGNORECASE)
    if bare is None:
        compact = re.sub(r"\s*/\s*", "/", text.strip())
        return exposure_from_name(compact)
    number = _number(bare[2])
    seconds = math.nan if number is None or number == 0 else (float(bare[1]) / number if bare[1] else number)
    seconds *= _UNITS[unit]
    return float(f"{seconds:.12g}") if 0 < seconds < math.inf else None


def _readings(name: str, match: re.Match[str]) -> set[float]:
    """The times [s] that the match may mean: one, or more where it is ambiguous; NaN for none."""
    number, one, unit = _number(match["number"]), match["one"], _UNITS[match["unit"].lower()]
    if number is None:
        return {math.nan}
    plain = float(f"{number * unit:.12g}")
    if not one:
        return {plain}
    fraction = float(f"{float(one) / number:.12g}") if number else math.nan
    if match["bar"] not in "-_":
        return {fraction * unit}
    is_label = one == "1" and unit == 1 and number > 1 and match["number"].isdecimal()
    if not is_label:
        return {plain}
    alone = match["bar"] == "-" and "_" in name
    return {fraction} if number > _LONGEST_S or alone else {fraction, plain}


def _number(text: str) -> float | None:
    """The number; None where a comma may stand for thousands."""
    whole, comma, rest = text.partition(",")
    if comma and int(whole or 0) and re.match(r"\d{3}(?!\d)", rest):
        return None
    return float(text.replace(",", "."))
