"""All that a report can rest on, as far as it is there: fit, slices, images, frames, and why something is not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bssrdf.errors import InputError
from bssrdf.measure import Merged, StaleImages, read_merged
from bssrdf.session import HEADER, read_fit, read_frames, read_session, read_slice, sha256_of
from bssrdf.session.records import Fit, Frame, Session, Slice
from bssrdf.session.text_file import parse_toml, read_text

KINDS = ("sample", "reference")


@dataclass(frozen=True)
class Piece:
    """One slice that was fitted."""

    path: Path
    curve: Slice


@dataclass(frozen=True)
class Evidence:
    """What was found under the path that is reported on."""

    path: Path
    session: Session | None
    fit: Fit | None
    pieces: tuple[Piece, ...] = ()
    merged: Merged | None = None
    frames: tuple[Frame, ...] = ()
    record: Mapping[str, Any] = field(default_factory=dict)
    """capture.toml."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Why a part is not there: `fit`, `slice`, `images`, `frames`."""
    warnings: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What to call the thing reported on."""
        told = self.fit.material if self.fit else None
        if told is None and self.session and self.session.material:
            told = self.session.material.name
        return told or self.path.name

    @property
    def channels(self) -> tuple[str, ...]:
        """Those of the fit, else of the first slice."""
        if self.fit is not None:
            return tuple(self.fit.channels)
        return tuple(self.pieces[0].curve.channels) if self.pieces else ()

    def measured_flags(self) -> tuple[str, ...]:
        """Flags that measuring raised, in any slice."""
        return tuple(dict.fromkeys(flag for piece in self.pieces for flag in piece.curve.flags))


def gather(path: Path) -> Evidence:
    """The evidence under a session folder or the path of a fit.json; InputError where a file is broken, or it is
    neither."""
    if path.is_dir():
        if not (path / "session.toml").is_file():
            raise InputError(f"{path}: holds no session.toml; pass a session's folder, or a fit.json")
        return _of_session(path)
    if not path.exists():
        raise InputError(f"{path}: is not there; pass a session's folder, or a fit.json")
    if (path.parent / "session.toml").is_file() and path.name == "fit.json":
        return _of_session(path.parent)
    fit = read_fit(path)
    pieces, missing, warnings = _pieces(fit, path.parent)
    no_session = "a lone fit has none; report on its session to see them"
    return Evidence(path, None, fit, pieces, missing={"images": no_session, "frames": no_session} | missing,
                    warnings=warnings)  # fmt: skip


def _of_session(path: Path) -> Evidence:
    session = read_session(path)
    missing: dict[str, str] = {}
    fit = read_fit(path / "fit.json") if (path / "fit.json").exists() else None
    if fit is None:
        missing["fit"] = f"not fitted yet: run `bssrdf fit {path}`"
    curve = path / "measured" / "slice.csv"
    pieces: tuple[Piece, ...] = ()
    warnings: tuple[str, ...] = ()
    if not curve.exists():
        missing["slice"] = f"not measured yet: run `bssrdf measure {path}`"
    elif fit is None:
        pieces = (Piece(curve, read_slice(curve)),)
    else:
        pieces, absent, warnings = _pieces(fit, path, own=curve)
        missing |= absent
    frames = tuple(read_frames(path, must_exist=False)) if (path / "frames.csv").exists() else ()
    if not any((path / frame.file).is_file() for frame in frames):
        missing["frames"] = "the frames are not in the session's folder"
    merged = None
    try:
        kinds = [kind for kind in KINDS if (path / "measured" / f"{kind}.exr").exists()]
        merged = read_merged(session, frames, kinds) if kinds else None
        if not kinds:
            missing["images"] = f"no HDR image in measured/: run `bssrdf measure {path}`"
    except StaleImages as error:
        missing["images"] = str(error)
    record_file = path / "capture.toml"
    record = parse_toml(record_file, read_text(record_file)) if record_file.exists() else {}
    return Evidence(path, session, fit, pieces, merged, frames, record, missing, warnings)


def _pieces(
    fit: Fit, folder: Path, own: Path | None = None
) -> tuple[tuple[Piece, ...], dict[str, str], tuple[str, ...]]:
    """The slices that were fitted; what is missing of them; those that have changed since."""
    given = {key: fit.options[key] for key in HEADER if key in fit.options}
    given |= {"eta": fit.eta, "g": fit.g}  # g may have been fitted
    joint = fit.options.get("joint")
    listed: Sequence[Mapping[str, Any]] = joint if isinstance(joint, list) else []
    sources = [(str(each["path"]), str(each["sha256"])) for each in listed] or [(fit.input_path, fit.input_sha256)]
    pieces, absent, warnings = [], {}, []
    for name, digest in sources:
        path = own if own is not None and not listed else _found(name, folder)
        if path is None:
            absent["slice"] = f"{name}: is not there any more, so that no curve can be drawn"
            continue
        if sha256_of(path) != digest:
            warnings.append(f"{path} has changed since it was fitted: run the fit again")
        curve = read_slice(path, **given)
        if strange := [channel for channel in fit.channels if channel not in curve.channels]:
            absent["slice"] = f"{path} has no channel {', '.join(strange)}, which the fit names: run the fit again"
            continue
        pieces.append(Piece(path, curve))
    return tuple(pieces), absent, tuple(warnings)


def _found(name: str, folder: Path) -> Path | None:
    """A slice by the name in the fit: from here, or from where the fit lies."""
    return next((path for path in (Path(name), folder / name) if path.is_file()), None)
