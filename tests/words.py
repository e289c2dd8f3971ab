"""`make check`: no class name stands for two things, and no worn phrase is left in code, help and docs."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
WORN = re.compile(
    r"""
      \b(samples|lines?|noise|rows?|photons|fits|curves|pixels|files?|time|times|one|two|value|values|object)
        \ an?\ (pixel|frame|radius|trial|second|channel|line|fit|curve|photon|session|slice)\b  # per
    | (?<!there\ )\b(is|are)\ no\ (?!light|error|longer|model|more|wider|such|data|datum)\w+           # is not a
    | put\ (it|them|that)\ right | let\ it\ end | c[ao]me\ to\ rest | nobody\ laid
    | (bug|scene|bench)s?\ of\ ours | found\ fault | of\ unknown\ factor | datum\ more
    | Look\ whether | Go\ on\ with\ a | if\ not\ given | against\ each\ other
    | \b(GLANCE|VAGUE|MUCH_LOST|FAR_OFF|as_it_is|_relaid|_less|_look)\b
    """,
    re.VERBOSE,
)
"""Phrases that a reader stumbles over; docs/glossary.md has the words to use."""
ELSEWHERE = ("tests/", "docs/decisions/", "CHANGELOG.md")


def tracked(*kinds: str) -> list[Path]:
    done = subprocess.run(["git", "ls-files", *kinds], cwd=ROOT, capture_output=True, text=True, check=True)
    return [Path(line) for line in done.stdout.splitlines() if not line.startswith(ELSEWHERE)]


def shared_class_names() -> list[str]:
    homes = defaultdict(list)
    for module in tracked("*.py"):
        for node in ast.walk(ast.parse((ROOT / module).read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                homes[node.name].append(str(module))
    return [f"class {name} stands in {', '.join(files)}" for name, files in homes.items() if len(files) > 1]


def worn_phrases() -> list[str]:
    return [
        f"{file}:{number}: {found[0].strip()!r} ({line.strip()[:60]})"
        for file in tracked("*.py", "*.md", "*.toml")
        for number, line in enumerate((ROOT / file).read_text(encoding="utf-8").splitlines(), 1)
        if (found := WORN.search(line))
    ]


if __name__ == "__main__":
    sys.exit("\n".join([*shared_class_names(), *worn_phrases()]) or None)
