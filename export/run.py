"""One call for all targets: materials to files."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from bssrdf.errors import UsageError
from bssrdf.export.blender import blender_text
from bssrdf.export.material import ExportMaterial
from bssrdf.export.mitsuba import mitsuba_dict, mitsuba_xml
from bssrdf.export.openpbr import openpbr_text
from bssrdf.export.pbrt import pbrt_text
from bssrdf.export.solved import Keep, Setting
from bssrdf.export.text import identifier
from bssrdf.export.unit import Unit
from bssrdf.export.usd import usd_text
from bssrdf.session import atomic_write

Target = Literal["blender", "mitsuba", "pbrt", "openpbr", "usd"]
Version = tuple[int, int]


class Renderer(NamedTuple):
    """What is known of a target."""

    title: str
    keep: Keep
    """What is kept where the user does not say: volumes keep the medium, closures the appearance."""
    keeps: tuple[Keep, ...]
    unit: Unit
    suffix: str
    versions: tuple[Version, Version]
    """First and last that the file is for."""


RENDERERS: dict[Target, Renderer] = {
    "blender": Renderer("Blender (Cycles)", "appearance", ("appearance", "medium"), "m", ".py", ((4, 5), (5, 3))),
    "mitsuba": Renderer("Mitsuba", "medium", ("appearance", "medium"), "mm", ".xml", ((3, 5), (3, 9))),
    "pbrt": Renderer("pbrt", "medium", ("appearance", "medium"), "mm", ".pbrt", ((4, 0), (4, 0))),
    "openpbr": Renderer("OpenPBR, in MaterialX 1.39,", "appearance", ("appearance",), "mm", ".mtlx", ((1, 1), (1, 1))),
    "usd": Renderer("OpenPBR, in OpenUSD,", "appearance", ("appearance",), "m", ".usda", ((1, 1), (1, 1))),
}
Writer = Callable[[Sequence[ExportMaterial], Setting, Version | None], str]
WRITERS: dict[str, Writer] = {
    ".py": lambda materials, setting, version: blender_text(materials, setting, version),
    ".xml": lambda materials, setting, _: mitsuba_xml(materials, setting),
    ".pbrt": lambda materials, setting, _: pbrt_text(materials, setting),
    ".mtlx": lambda materials, setting, _: openpbr_text(materials, setting),
    ".usda": lambda materials, setting, _: usd_text(materials, setting),
}


def read_version(target: Target, text: str | None) -> Version | None:
    """The renderer's version; UsageError where it is not one that files are written for."""
    if text is None:
        return None
    first, last = RENDERERS[target].versions
    known = re.fullmatch(r"(\d+)\.(\d+)(\.\d+)?", text)
    version = (int(known[1]), int(known[2])) if known else None
    if version is None or not first <= version <= last:
        span = f"{first[0]}.{first[1]} to {last[0]}.{last[1]}" if first != last else f"{first[0]}.{first[1]}"
        raise UsageError(f"--renderer-version {text}: files for {target} are written for {span}")
    return version


def export_files(
    materials: Sequence[ExportMaterial],
    target: Target,
    out: Path,
    *,
    keep: Keep | None = None,
    unit: Unit | None = None,
    version: Version | None = None,
) -> list[Path]:
    """Write all into one file, or a file each into the folder `out`, if it has no suffix. The files written.

    `keep` and `unit` default to the target's; without a `unit` Blender files follow the scene's. UsageError for what
    the target has not.
    """
    renderer = RENDERERS[target]
    kept = keep or renderer.keep
    if kept not in renderer.keeps:
        raise UsageError(f"--keep {kept}: {target} has a closure only, no volume; leave out --keep")
    setting = Setting(
        f"{renderer.title} {_span(renderer, version)}",
        kept,
        unit or renderer.unit,
        scene_unit=target == "blender" and unit is None,
    )
    write = _writer(target, out)
    if out.suffix:
        return [_write(out, write(materials, setting, version))]
    out.mkdir(parents=True, exist_ok=True)
    names = file_names(materials)
    return [
        _write(out / f"{name}{renderer.suffix}", write([material], setting, version))
        for name, material in zip(names, materials, strict=True)
    ]


def file_names(materials: Sequence[ExportMaterial]) -> list[str]:
    """A file name for each: letters and digits of its own, and a number where two are alike."""
    names: list[str] = []
    for material in materials:
        name = stem = identifier(material.name)
        while name.lower() in map(str.lower, names):
            name = f"{stem}-{len(names) + 1}"
        names.append(name)
    return names


def _writer(target: Target, out: Path) -> Writer:
    suffix = out.suffix or RENDERERS[target].suffix
    if target == "mitsuba" and suffix == ".py":
        return lambda materials, setting, _: mitsuba_dict(materials, setting)
    if suffix != RENDERERS[target].suffix:
        also = " (or .py for a dict)" if target == "mitsuba" else ""
        raise UsageError(f"--out {out}: {target} files end in {RENDERERS[target].suffix}{also}, folders in nothing")
    return WRITERS[suffix]


def _span(renderer: Renderer, version: Version | None) -> str:
    first, last = renderer.versions if version is None else (version, version)
    return f"{first[0]}.{first[1]}" + ("" if first == last else f" to {last[0]}.{last[1]}")


def _write(path: Path, text: str) -> Path:
    with atomic_write(path) as part:
        part.write_text(text, encoding="utf-8")
    return path
