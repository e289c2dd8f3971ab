"""Which kind a file is of: by the rules that were given, by its folders, by its name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import PurePosixPath
from typing import NamedTuple, get_args

from bssrdf.errors import UsageError
from bssrdf.session.records import FrameKind

KINDS: tuple[FrameKind, ...] = get_args(FrameKind)


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
