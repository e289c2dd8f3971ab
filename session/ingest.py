"""Make a session of RAW or TIFF files that exist already: which kind each is, how long it was exposed, and a copy."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from typing import get_args

import numpy as np

from bssrdf.errors import InputError, UsageError
from bssrdf.session.atomic import replace_folder, sha256_of
from bssrdf.session.file_names import exposure_from_name
from bssrdf.session.frame_files import IMAGE_SUFFIXES, RAW_SUFFIXES, RawFrame, read_frame_file
from bssrdf.session.frames_csv import write_frames
from bssrdf.session.records import Camera, Frame, FrameKind, Session
from bssrdf.session.session_toml import write_session

KINDS: tuple[FrameKind, ...] = get_args(FrameKind)


def ingest_folder(
    folder: Path,
    out: Path,
    *,
    kinds: Sequence[str] = (),
    select: str | None = None,
    camera: Camera = Camera(),  # noqa: B008
) -> list[Frame]:
    """Copy the frames below `folder` into a new session `out`.

    `kinds` are `GLOB=kind` rules on path or name, of which the last match wins; with `select`, light frames count only
    where their path contains it. Returns the frames listed. Raises UsageError for a malformed rule, InputError for a
    file whose kind or exposure is unclear or that cannot be read.
    """
    rules = [_rule(text) for text in kinds]
    chosen = _chosen(folder, rules, select)
    out.parent.mkdir(parents=True, exist_ok=True)
    with replace_folder(out) as building:
        frames, first = _copy(folder, chosen, building)
        write_frames(building, frames)
        write_session(building, Session(path=building, camera=_camera(camera, first)))
    return frames


def _rule(text: str) -> tuple[str, FrameKind]:
    glob, equals, kind = text.rpartition("=")
    if not (equals and glob):
        raise UsageError(f"--kind {text!r} is not of the form GLOB=kind, such as 'darks/*=dark'")
    for known in KINDS:
        if kind == known:
            return glob, known
    raise UsageError(f"--kind {text!r}: there is no kind {kind!r}; kinds are {', '.join(KINDS)}")


def _chosen(folder: Path, rules: Sequence[tuple[str, FrameKind]], select: str | None) -> dict[PurePosixPath, FrameKind]:
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; give the one that holds the frames")
    found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in (*RAW_SUFFIXES, *IMAGE_SUFFIXES))
    if not found:
        raise InputError(f"{folder}: holds no RAW, TIFF or EXR file")
    chosen = {}
    for path in found:
        relative = PurePosixPath(path.relative_to(folder).as_posix())
        kind = _kind(relative, rules)
        if select is not None and select not in str(relative) and not (kind and kind.endswith("dark")):
            continue
        if kind is None:
            raise InputError(
                f"{path}: its kind is unclear; name it with --kind 'GLOB=kind', such as --kind '{relative.parent}/*=sample'"
            )
        chosen[relative] = kind
    if all(kind.endswith("dark") for kind in chosen.values()):
        raise InputError(
            f"{folder}: no light frame {f'has {select!r} in its path' if select else 'is there'}; look at --select and --kind"
        )
    return chosen


def _kind(relative: PurePosixPath, rules: Sequence[tuple[str, FrameKind]]) -> FrameKind | None:
    """By the last rule that matches, else by a kind's own name in the path; frames beside ruled darks are the sample."""
    for glob, kind in reversed(rules):
        if fnmatch(str(relative), glob) or fnmatch(relative.name, glob):
            return kind
    words = str(relative).lower().replace("-", "_").replace("/", "_").replace(".", "_")
    named = [kind for kind in KINDS if f"_{kind}_" in f"_{words}_"]
    if named:
        return max(named, key=len)
    only_darks = bool(rules) and all(kind.endswith("dark") for _, kind in rules)
    return "sample" if only_darks else None


def _copy(folder: Path, chosen: dict[PurePosixPath, FrameKind], building: Path) -> tuple[list[Frame], RawFrame]:
    frames, images = [], []
    for relative, kind in chosen.items():
        image = read_frame_file(folder / relative)
        target = building / "frames" / relative
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(folder / relative, target)
        frames.append(
            Frame(
                file=str("frames" / relative),
                kind=kind,
                exposure_s=_exposure(folder / relative, image),
                sha256=sha256_of(target),
            )
        )
        images = images or [image]
    return frames, images[0]


def _exposure(path: Path, image: RawFrame) -> float:
    exposure_s = image.exposure_s or exposure_from_name(path.stem)
    if exposure_s is None:
        raise InputError(f"{path}: has no exposure in its metadata nor in its name; name it like frame_250ms_1.tif")
    return exposure_s


def _camera(given: Camera, first: RawFrame) -> Camera:
    """What the caller gave; a RAW file tells the rest itself, and an integer TIFF spans its whole type."""
    if first.black is not None or not np.issubdtype(first.data.dtype, np.integer):
        return given
    return Camera(
        layout=given.layout or first.layout,
        black=given.black if given.black is not None else 0.0,
        white=given.white if given.white is not None else float(np.iinfo(first.data.dtype).max),
    )
