"""Make a session of image files that exist already: which kind each is, how long it was exposed, and a copy."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from math import log
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any

from bssrdf.errors import InputError, UsageError
from bssrdf.session.atomic import make_folder, replace_folder, sha256_of
from bssrdf.session.constancy import ROUNDED, check_constant
from bssrdf.session.file_names import (
    Exposure,
    Rule,
    exposure_from_name,
    exposure_from_path,
    exposure_source,
    kind_of,
    rule_of,
)
from bssrdf.session.frame_files import ENCODED_SUFFIXES, is_frame_name, read_frames_of
from bssrdf.session.frames_csv import write_frames
from bssrdf.session.png_file import is_deep
from bssrdf.session.progress import Progress, counted
from bssrdf.session.raw_frame import RawFrame
from bssrdf.session.records import Frame, FrameKind
from bssrdf.session.session_toml import camera_of_keys, told_tables, write_started

_MERGED: dict[str, FrameKind] = {"sample": "sample_hdr", "reference": "reference_hdr"}
_NO_FRAMES = ("__MACOSX", "@eaDir")
"""Folders in which an archive or a disk station keeps sidecars."""


def ingest_folder(
    folder: Path,
    out: Path,
    *,
    kinds: Sequence[str] = (),
    select: str | None = None,
    camera: Mapping[str, Any] = MappingProxyType({}),
    exposure_from: str | None = None,
    response: bool = False,
    told: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    progress: Progress | None = None,
) -> list[Frame]:
    """Copy the frames below `folder` into a new session `out`; a session that was there is replaced.

    `kinds` are `GLOB=kind` rules on path or name, of which the last match wins; with `select`, light frames count only
    where their path contains it; `camera` is keys of [camera]; `exposure_from` is a regular expression that finds the
    exposure in a path, or a CSV file that lists it; `told` are keys of further
    tables of session.toml. A stack becomes a file for each of its pictures. With `response`
    JPEG and PNG files count as well, and the session asks for their response curve. Returns the frames listed.
    UsageError for a rule that is malformed or matches nothing, InputError for a file whose kind or exposure is unclear,
    that cannot be read, or whose camera was set otherwise than for the others.
    """
    rules = [rule_of(text) for text in kinds]
    known_camera = camera_of_keys(out / "session.toml", {**camera, **({"response": "debevec"} if response else {})})
    chosen = _chosen(_image_files(folder, out, response), folder, rules, select)
    known_tables = told_tables(out / "session.toml", told)
    source = exposure_source(exposure_from, folder) if exposure_from else None
    make_folder(out.parent)
    with replace_folder(out) as building:
        frames = []
        for relative, kind in counted(chosen.items(), "copy", progress):
            frames += _take(folder, relative, kind, building, source, encoded=response)
        check_constant(frames, folder)
        write_frames(building, frames)
        write_started(building, known_camera, known_tables)
    return frames


def _chosen(
    found: Sequence[PurePosixPath], folder: Path, rules: Sequence[Rule], select: str | None
) -> dict[PurePosixPath, FrameKind]:
    for rule in rules:
        if not any(rule.matches(relative) for relative in found):
            raise UsageError(f"--kind '{rule.glob}={rule.kind}' matches none of the {len(found)} images in {folder}")
    chosen = {}
    for relative in found:
        kind = kind_of(relative, rules)
        if select is not None and select not in str(relative) and not (kind and kind.endswith("dark")):
            continue
        if kind is None:
            example = f"'{relative.parent}/*=sample'"
            raise InputError(
                f"{folder / relative}: its kind is unclear; name it by --kind GLOB=kind, such as {example}"
            )
        chosen[relative] = _MERGED.get(kind, kind) if relative.suffix.lower() == ".hdr" else kind
    if all(kind.endswith("dark") for kind in chosen.values()):
        missing = f"has {select!r} in its path" if select else "is there"
        raise InputError(f"{folder}: no light frame {missing}; look at --select and --kind")
    return chosen


def _image_files(folder: Path, out: Path, response: bool) -> list[PurePosixPath]:
    """The images below `folder`, those of a session that stands in it left out."""
    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder; give the one that holds the frames")
    if folder.resolve().is_relative_to(out.resolve()):
        raise UsageError(f"--out {out} would replace {folder}, which is to be read; choose another")
    files = sorted(_visible_files(folder))
    found = [path for path in files if _is_frame(path, response)]
    found = [path for path in found if not path.resolve().is_relative_to(out.resolve())]
    if not found:
        encoded = any(path.suffix.lower() in ENCODED_SUFFIXES for path in files)
        remedy = "ask for JPEG or PNG by --response" if encoded else "give the folder that holds the frames"
        raise InputError(f"{folder}: holds no RAW, TIFF, PNG, PNM, FITS, NPY or EXR file; {remedy}")
    return [PurePosixPath(path.relative_to(folder).as_posix()) for path in found]


def _is_frame(path: Path, response: bool) -> bool:
    """By its name; a PNG of 8 bits is a preview, unless such frames are asked for."""
    is_preview = path.suffix.lower() == ".png" and not response and not is_deep(path)
    return is_frame_name(path, encoded=response) and not is_preview


def _visible_files(folder: Path) -> Iterator[Path]:
    """Files that are neither hidden nor in a hidden folder, each of a name that frames.csv can hold; links followed."""
    whole, seen = folder.resolve(), set[Path]()
    for place, folders, names in os.walk(folder, followlinks=True, onerror=_refuse):
        real = Path(place).resolve()
        if real in seen or (Path(place).is_symlink() and real.is_relative_to(whole) and real != whole):
            folders.clear()
            continue
        seen.add(real)
        folders[:] = filter(_is_visible, folders)
        for name in names:
            path = Path(place, name)
            if not _is_visible(name) or not is_frame_name(path, encoded=True):
                continue
            if not str(path.relative_to(folder)).isprintable():
                raise InputError(f"{folder}: holds the file {name!a}, whose name is not plain text; rename it")
            if not path.exists():
                raise InputError(f"{path}: is a link to what is not there; mend the link or take it out")
            yield path


def _is_visible(name: str) -> bool:
    return not name.startswith(".") and name not in _NO_FRAMES


def _refuse(error: OSError) -> None:
    raise InputError(f"{error.filename}: cannot be read ({error.strerror}); check its permissions") from error


def _take(
    folder: Path,
    relative: PurePosixPath,
    kind: FrameKind,
    building: Path,
    told: Exposure | None,
    *,
    encoded: bool,
) -> list[Frame]:
    """Copy a file into the session, a stack as one file for each picture; a line for each."""
    source, target = folder / relative, building / "frames" / relative
    images = read_frames_of(source, encoded=encoded)
    first, second = next(images), next(images, None)
    target.parent.mkdir(parents=True, exist_ok=True)
    if second is None:
        _check_free(target)
        shutil.copy2(source, target)
        return [_line(target, building, kind, first, _exposure(source, relative, kind, first, told))]
    frames = []
    for page, image in enumerate(chain((first, second), images)):
        seconds = told(relative, page) if told else image.exposure_s
        if seconds is None:
            raise InputError(
                f"{source}: is a stack of pictures that does not tell the exposure of each; list them by "
                "--exposure-from times.csv with the columns file,page,exposure_s"
            )
        file = target.with_name(f"{target.stem}_page{page + 1}.tif")
        _write_page(file, image)
        frames.append(_line(file, building, kind, image, seconds))
    return frames


def _write_page(file: Path, image: RawFrame) -> None:
    import tifffile

    _check_free(file)
    tifffile.imwrite(file, image.data, photometric="rgb" if image.data.ndim == 3 else "minisblack", metadata=None)


def _check_free(file: Path) -> None:
    if file.exists():
        raise InputError(f"{file.name}: a page of a stack would take the name of another file; rename the stack")


def _line(file: Path, building: Path, kind: FrameKind, image: RawFrame, exposure_s: float) -> Frame:
    return Frame(
        file=file.relative_to(building).as_posix(),
        kind=kind,
        exposure_s=exposure_s,
        utc=image.utc,
        sha256=sha256_of(file),
        exposure_rel_sd=image.exposure_rel_sd if exposure_s == image.exposure_s else None,
        card=image.card,
    )


def _exposure(path: Path, relative: PurePosixPath, kind: FrameKind, image: RawFrame, told: Exposure | None) -> float:
    if kind in _MERGED.values():
        return 1.0
    by_name = exposure_from_name(relative.stem)
    if not told and image.exposure_s and by_name and abs(log(by_name / image.exposure_s)) > ROUNDED:
        raise InputError(
            f"{path}: was exposed for {image.exposure_s:g} s by its metadata and {by_name:g} s by its name; say which "
            "holds by --exposure-from, a regular expression or a table"
        )
    exposure_s = told(relative, 0) if told else image.exposure_s or exposure_from_path(relative)
    if exposure_s is None:
        merged = "; if it is merged already, give its kind as sample_hdr or reference_hdr"
        raise InputError(
            f"{path}: has no exposure in its metadata, nor one clear exposure in its name; name it like "
            f"frame_250ms_1.tif, or say where it stands by --exposure-from"
            f"{merged if kind in _MERGED and path.suffix.lower() == '.exr' else ''}"
        )
    return exposure_s
