"""Write the tables of keys and flags in the documents anew, from where they are declared: `make docs-tables`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from pathlib import Path

from bssrdf.rig.plan_toml import CapturePlan, ExposurePlan
from bssrdf.session import HEADER, TABLES
from bssrdf.session.flags import Flag
from bssrdf.session.keys import Declared, keys_of
from bssrdf.session.records import Card, ChannelFit, Frame
from bssrdf.session.text_file import toml_value

ROOT = Path(__file__).parents[1]
PLACE = re.compile(r"(<!-- ((?:keys|flags) of .+?), by `make docs-tables` -->\n).*?(<!-- end -->)", re.DOTALL)
"""Where a table stands, with its name."""
_HEAD = "| key | meaning | values | default |\n|---|---|---|---|\n"


def written_anew(text: str) -> str:
    """The document with each of its tables as the fields are declared now."""
    return PLACE.sub(lambda place: f"{place[1]}{_table(place[2])}{place[3]}", text)


def _table(name: str) -> str:
    what, _, name = name.partition(" of ")
    return _keys(name) if what == "keys" else _flags(name)


def _flags(stage: str) -> str:
    rows = (f"| `{flag}` | {flag.meaning} |\n" for flag in Flag if stage in flag.raised_by)
    return "".join(["| flag | meaning |\n|---|---|\n", *rows])


def _keys(name: str) -> str:
    if name == "fit.json":
        rows = (f"| `{key.name}` | {key.meaning} |\n" for key in keys_of(ChannelFit).values())
        return "".join(["| key | meaning |\n|---|---|\n", *rows])
    tables: dict[str, Mapping[str, Mapping[str, Declared]]] = {
        "session.toml": {f"[{table}] ": keys_of(record) for table, record in TABLES.items()},
        "plan.toml": {"": keys_of(CapturePlan), "[exposures] ": keys_of(ExposurePlan)},
        "frames.csv": {"": {**keys_of(Frame), **keys_of(Card)}},
        "slice.csv": {"": HEADER},
    }
    return _HEAD + "".join(row for table, keys in tables[name].items() for row in _rows(table, keys))


def _rows(table: str, keys: Mapping[str, Declared]) -> Iterator[str]:
    for key in keys.values():
        note = f" (informational: {key.key.informational})" if key.key.informational else ""
        values = " ".join(filter(None, (key.limits, key.unit)))
        yield f"| {table}`{key.name}` | {key.key.help}{note} | {values} | {_otherwise(key)} |\n"


def _otherwise(key: Declared) -> str:
    if key.default is MISSING:
        return "needed"
    if key.key.unless:
        return f"needed, or `{key.key.unless}`"
    return "" if key.default in (None, {}, ()) else f"`{toml_value(key.default)}`"


if __name__ == "__main__":
    for page in (ROOT / "docs").glob("*.md"):
        page.write_text(written_anew(page.read_text(encoding="utf-8")), encoding="utf-8")
