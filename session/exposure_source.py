"""`ingest --exposure-from`: exposures that a table lists, or that a regular expression finds in a file's path."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath

from bssrdf.errors import InputError, UsageError
from bssrdf.session.checks import read_text, shown
from bssrdf.session.csv_table import parse_csv
from bssrdf.session.file_names import seconds_of

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
            where = f"finds {match[1]!r}, which is no exposure" if match else "finds nothing"
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
