"""What the names of files and folders say about frames: their kind, and by one grammar how long they were exposed.

A time is a number and a unit: s, sec, ms, msec, us, usec, µs. The number may have a decimal point or comma, an exponent
or, in seconds, be a fraction such as 1-250s (1/250 where a slash can stand). What touches a letter or another part
of a number is not a time; words such as `exp` or `t=` may stand right before it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from bssrdf.errors import InputError, UsageError
from bssrdf.session.checks import shown
from bssrdf.session.records import KINDS, FrameKind
from bssrdf.session.text_file import parse_csv, read_text

_UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6, "µs": 1e-6, "μs": 1e-6}
_TIME = re.compile(
    r"""(?<![^_\-\s()\[\]=+;@])(?<!\de[-+])(?<!\d\.e[-+])    # begins a word, and is not an exponent, …
        (?:exp|exposure|et|t|time|texp|shutter|ss|tv)?=?    # … or follows one that announces a time
        (?:(?P<one>\d+)(?P<bar>[-_/∕⁄／]))?
        (?P<number>(?:\d*[.,])?\d+(?:e[+-]?\d+)?)
        \s?(?P<unit>s|sec|ms|msec|us|usec|µs|μs)
        (?=[_\-\s.()\[\]+;@]|$)                       # ends a word""",
    re.VERBOSE | re.IGNORECASE,
)
_A_DAY_S = 86_400.0
"""20240102s is a date."""
_LONGEST_S = 30.0
"""Above this many seconds a camera has no label: 1_250s is 1/250 s, while 1_4s may be frame 1 of 4 s."""


def exposure_from_name(name: str) -> float | None:
    """Exposure time [s] in a name such as `…_250ms_…`; None where there is none, or more than one that it may be."""
    times = {time for match in _TIME.finditer(name) for time in _readings(name, match)}
    return times.pop() if len(times) == 1 and 0 < min(times) <= _A_DAY_S else None


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
    if one == "0" and match["number"].isdecimal():  # 0_5s is 0.5 s or frame 0 of 5 s
        decimal = float("0." + match["number"]) * unit
        return {plain, float(f"{decimal:.12g}")}
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


class Rule(NamedTuple):
    """`--kind GLOB=kind`."""

    glob: str
    kind: FrameKind

    def matches(self, relative: PurePosixPath) -> bool:
        """Whether the glob fits the path in the folder, or the name alone."""
        return fnmatch(str(relative), self.glob) or fnmatch(relative.name, self.glob)


def rule_of(text: str) -> Rule:
    """The rule that `--kind` gives; UsageError where it is malformed."""
    glob, equals, kind = text.rpartition("=")
    if not (equals and glob):
        raise UsageError(f"--kind {text!r} is not of the form GLOB=kind, such as 'darks/*=dark'")
    for known in KINDS:
        if kind == known:
            return Rule(glob, known)
    raise UsageError(f"--kind {text!r}: there is no kind {kind!r}; kinds are {', '.join(KINDS)}")


def kind_of(relative: PurePosixPath, rules: Sequence[Rule]) -> FrameKind | None:
    """By the last rule that matches, else the nearest folder's word, else the file's; beside ruled darks: sample.

    A folder that is named after a kind as a whole decides before one that has the word among others.
    """
    for rule in reversed(rules):
        if rule.matches(relative):
            return rule.kind
    folders = list(reversed(relative.parent.parts))
    whole = [
        named for folder in folders if (named := _named(folder)) and "_".join(_words(folder)) in (named, f"{named}s")
    ]
    for named in (*whole, *map(_named, folders), _named(relative.name)):
        if named:
            return named
    unclear = any(_kinds_in(part) for part in relative.parts)
    only_darks = bool(rules) and all(rule.kind.endswith("dark") for rule in rules)
    return "sample" if only_darks and not unclear else None


def _named(part: str) -> FrameKind | None:
    """The kind that one folder or file name says; None where it says none, or several."""
    found = _kinds_in(part)
    return found[0] if len(found) == 1 else None


def _kinds_in(part: str) -> list[FrameKind]:
    """The kinds whose words follow each other in the name, the longest first at each place."""
    words, found, at = _words(part), [], 0
    while at < len(words):
        here = [kind for kind in KINDS if _begins(words[at:], kind.split("_"))]
        longest = max(here, key=len, default=None)
        if longest and longest not in found:
            found.append(longest)
        at += len(longest.split("_")) if longest else 1
    return found


def _begins(words: Sequence[str], kind: Sequence[str]) -> bool:
    """Whether the words begin with those of the kind, of which the last may be a plural."""
    head = list(words[: len(kind)])
    return head == list(kind) or (head[:-1] == list(kind[:-1]) and head[-1:] == [f"{kind[-1]}s"])


def _words(part: str) -> list[str]:
    return [word for word in re.split(r"[_\-\s.]+", part.lower()) if word]


_GROUP_UNITS = ("s", "ms", "us")

Exposure = Callable[[PurePosixPath, int], float]


def exposure_source(text: str, folder: Path) -> Exposure:
    """The exposure [s] of a file, given by its path below `folder` and the number of its picture, from 0.

    `text` names a CSV file with the columns file and exposure_s, and page (from 1) for stacks; else it is a regular
    expression with one group, which holds a time with its unit, or a bare number of seconds, or of the unit that the
    group is named after: `(?P<ms>\\d+)`. UsageError or InputError for one that cannot be used; what is returned raises
    InputError for a file without an exposure.
    """
    if text.lower().endswith(".csv"):
        return _of_table(Path(text))
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise UsageError(
            f"--exposure-from {text!r}: is not a regular expression ({error}); or name a .csv file"
        ) from error
    unit = next(iter(pattern.groupindex), "s")
    if pattern.groups != 1 or unit not in _GROUP_UNITS:
        raise UsageError(
            f"--exposure-from {text!r}: must have one group around the exposure, such as 'exp(\\d+ms)', or one named "
            "after the unit of a bare number, such as '_t(?P<us>\\d+)'"
        )

    def found(relative: PurePosixPath, page: int) -> float:
        match = pattern.search(str(relative))
        seconds = seconds_of(match[1] or "", unit) if match else None
        if seconds is None:
            where = f"finds {match[1]!r}, which is not an exposure" if match else "finds nothing"
            raise InputError(f"{folder / relative}: --exposure-from {text!r} {where}; change the expression")
        return seconds

    return found


def _of_table(file: Path) -> Exposure:
    table = parse_csv(file, read_text(file), ("file", "exposure_s", "page"), ("file", "exposure_s"))
    exposures: dict[tuple[str, str], float] = {}
    for line, row in zip(table.lines, table.rows, strict=True):
        values = dict(zip(table.header, (field.strip() for field in row), strict=True))
        seconds = seconds_of(values["exposure_s"])
        if seconds is None:
            raise InputError(f"{file}: line {line}: exposure_s {shown(values['exposure_s'])} must be a time above 0")
        key = PurePosixPath(values["file"]).as_posix(), values.get("page", "")
        if exposures.setdefault(key, seconds) != seconds:
            raise InputError(f"{file}: line {line}: lists {shown(values['file'])} again; take one line out")

    def listed(relative: PurePosixPath, page: int) -> float:
        for name in (str(relative), relative.name):
            for number in (str(page + 1), ""):
                if (name, number) in exposures:
                    return exposures[name, number]
        raise InputError(f"{file}: has no line for {relative}{f' page {page + 1}' if page else ''}; add one")

    return listed
