"""Make a session of RAW or TIFF files that exist already: which kind each is, how long it was exposed, and a copy."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any, NamedTuple, get_args

from bssrdf.errors import InputError, UsageError
from bssrdf.session.atomic import make_folder, replace_folder, sha256_of
from bssrdf.session.file_names import exposure_from_name
from bssrdf.session.frame_files import ENCODED_SUFFIXES, IMAGE_SUFFIXES, RAW_SUFFIXES, RawFrame, read_frame_file
from bssrdf.session.frames_csv import write_frames
from bssrdf.session.records import Frame, FrameKind
from bssrdf.session.session_toml import camera_of_keys, write_started

KINDS: tuple[FrameKind, ...] = get_args(FrameKind)


class Rule(NamedTuple):
    """`--kind GLOB=kind`."""

    glob: str
    kind: FrameKind

    def matches(self, relative: PurePosixPath) -> bool:
        """Whether the glob fits the path in the folder, or the name alone."""
        return fnmatch(str(relative), self.glob) or fnmatch(relative.name, self.glob)


def ingest_folder(
    folder: Path,
    out: Path,
    *,
    kinds: Sequence[str] = (),
    select: str | None = None,
    camera: Mapping[str, Any] = MappingProxyType({}),
    response: bool = False,
) -> list[Frame]:
    """Copy the frames below `folder` into a new session `out`; a session that was there is replaced.

    `kinds` are `GLOB=kind` rules on path or name, of which the last match wins; with `select`, light frames count only
    where their path contains it; `camera` is keys of [camera]. With `response` JPEG and PNG files count as well, and
    the session asks for their response curve. Returns the frames listed. UsageError for a rule that is
    malformed or matches nothing, InputError for a file whose kind or exposure is unclear or that cannot be read.
    """
    rules = [_rule(text) for text in kinds]
    known_camera = camera_of_keys(out / "session.toml", {**camera, **({"response": "debevec"} if response else {})})
    suffixes = (*RAW_SUFFIXES, *IMAGE_SUFFIXES, *(ENCODED_SUFFIXES if response else ()))
    chosen = _chosen(_image_files(folder, out, suffixes), folder, rules, select)
    make_folder(out.parent)
    with replace_folder(out) as building:
        frames = [_copy(folder, relative, kind, building, encoded=response) for relative, kind in chosen.items()]
        write_frames(building, frames)
        write_started(building, known_camera)
    return frames


def _rule(text: str) -> Rule:
    glob, equals, kind = text.rpartition("=")
    if not (equals and glob):
        raise UsageError(f"--kind {text!r} is not of the form GLOB=kind, such as 'darks/*=dark'")
    for known in KINDS:
        if kind == known:
            return Rule(glob, known)
    raise UsageError(f"--kind {text!r}: there is no kind {kind!r}; kinds are {', '.join(KINDS)}")


def _chosen(
    found: Sequence[PurePosixPath], folder: Path, rules: Sequence[Rule], select: str | None
) -> dict[PurePosixPath, FrameKind]:
    for rule in rules:
        if not any(rule.matches(relative) for relative in found):
            raise UsageError(f"--kind '{rule.glob}={rule.kind}' matches none of the {len(found)} images in {folder}")
    chosen = {}
    for relative in found:
        kind = _kind(relative, rules)
        if select is not None and select not in str(relative) and not (kind and kind.endswith("dark")):
            continue
        if kind is None:
            example = f"'{relative.parent}/*=sample'"
            raise InputError(
                f"{folder / relative}: its kind is unclear; name it by --kind GLOB=kind, such as {example}"
            )
        chosen[relative] = kind
    if all(kind.endswith("dark") for kind in chosen.values()):
        missing = f"has {select!r} in its path" if select else "is there"
        raise InputError(f"{folder}: no light frame {missing}; look at --select and --kind")
    return chosen


def _image_files(folder: Path, out: Path, suffixes: Sequence[str]) -> list[PurePosixPath]:
    """The images below `folder`, those of a session that stands in it left out."""
    if not folder.is_dir():
        raise InputError(f"{folder}: is no folder; give the one that holds the frames")
    if folder.resolve().is_relative_to(out.resolve()):
        raise UsageError(f"--out {out} would replace {folder}, which is to be read; choose another")
    images = (path for path in folder.rglob("*") if path.suffix.lower() in suffixes)
    found = sorted(path for path in images if not path.resolve().is_relative_to(out.resolve()))
    if not found:
        encoded = any(path.suffix.lower() in ENCODED_SUFFIXES for path in folder.rglob("*"))
        remedy = "ask for JPEG or PNG by --response" if encoded else "give the folder that holds the frames"
        raise InputError(f"{folder}: holds no RAW, TIFF or EXR file; {remedy}")
    return [PurePosixPath(path.relative_to(folder).as_posix()) for path in found]


def _kind(relative: PurePosixPath, rules: Sequence[Rule]) -> FrameKind | None:
    """By the last rule that matches, else by a kind's own name in the path; what lies beside ruled darks is sample."""
    for rule in reversed(rules):
        if rule.matches(relative):
            return rule.kind
    words = str(relative).lower().replace("-", "_").replace("/", "_").replace(".", "_")
    named = [kind for kind in KINDS if f"_{kind}_" in f"_{words}_"]
    if named:
        return max(named, key=len)
    only_darks = bool(rules) and all(rule.kind.endswith("dark") for rule in rules)
    return "sample" if only_darks else None


def _copy(folder: Path, relative: PurePosixPath, kind: FrameKind, building: Path, *, encoded: bool) -> Frame:
    source, target = folder / relative, building / "frames" / relative
    image = read_frame_file(source, encoded=encoded)
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy2(source, target)
    return Frame(
        file=str("frames" / relative), kind=kind, exposure_s=_exposure(source, image), sha256=sha256_of(target)
    )


def _exposure(path: Path, image: RawFrame) -> float:
    exposure_s = image.exposure_s or exposure_from_name(path.stem)
    if exposure_s is None:
        raise InputError(f"{path}: has no exposure in its metadata nor in its name; name it like frame_250ms_1.tif")
    return exposure_s
