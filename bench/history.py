"""Ratios of speed, run after run, in one file of JSON lines, so that a slow-down shows."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from statistics import median

from bssrdf import __version__
from bssrdf.errors import InputError

SLOWER = 0.75
"""Of the median of earlier runs: ratios of the same code within one run scatter by a tenth on an idle machine."""
EARLIER = 5
"""Runs that are compared with."""


def appended(path: Path, ratios: Mapping[str, float]) -> list[str]:
    """Add a line with commit, time and ratios to `path`; a remark on each ratio that has fallen below earlier runs."""
    before = read_ratios(path)[-EARLIER:]
    line = {
        "commit": commit(),
        "utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "ratios": {name: round(ratio, 3) for name, ratio in ratios.items()},
    }
    try:
        with path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another --history") from error
    return [remark for name, ratio in ratios.items() if (remark := _remark(name, ratio, before))]


def read_ratios(path: Path) -> list[dict[str, float]]:
    """The ratios of each earlier run, oldest first; none where there is no file yet."""
    if not path.exists():
        return []
    found = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            found.append({str(name): float(ratio) for name, ratio in json.loads(line)["ratios"].items()})
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{path}: line {number} is not a run of this bench; remove it") from error
    return found


def commit() -> str:
    """The commit of these sources, `-dirty` where they were changed since; outside of a checkout the version."""
    here = Path(__file__).parent
    command = ["git", "-C", str(here), "describe", "--always", "--dirty", "--exclude", "*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return __version__


def _remark(name: str, ratio: float, before: list[dict[str, float]]) -> str | None:
    known = [run[name] for run in before if name in run]
    if not known or ratio >= SLOWER * median(known):
        return None
    return f"{name}: {ratio:.2f} x its peer, {median(known):.2f} x before"
