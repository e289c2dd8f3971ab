"""What other languages' texts may hold of ours."""

from __future__ import annotations

import re


def one_line(text: str) -> str:
    """On one line, without what ends a comment or cannot be shown."""
    return "".join(sign if sign.isprintable() else " " for sign in text)


def comment(mark: str, text: str) -> str:
    """A comment to the end of the line."""
    return f"{mark} {one_line(text)}"


def xml_comment(text: str) -> str:
    """A comment, in which two hyphens must not meet."""
    return f"<!-- {one_line(text).replace('--', '- -').replace('--', '- -').rstrip('-')} -->"


def identifier(text: str) -> str:
    """Letters, digits, `_` and `-` of any script: what Mitsuba takes for a name everywhere."""
    return re.sub(r"[^\w-]+", "_", text).strip("_") or "material"


def quoted(text: str) -> str:
    """A string of pbrt, in double quotes."""
    return '"' + one_line(text).replace("\\", "\\\\").replace('"', '\\"') + '"'
