"""The steps on files: find what a path stands for, read it, call one stage, write what came out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import bssrdf
from bssrdf.errors import BssrdfError, InputError
from bssrdf.fit import FitOptions, fit_g, fit_joint, fit_slices
from bssrdf.session import HEADER, about, atomic_write, doubt, read_fit, read_session, read_slice, sha256_of, write_fit
from bssrdf.session.flags import Flag
from bssrdf.session.records import SAMPLE_KEYS, ChannelFit, Fit, Session, Slice
from bssrdf.transport import SILENT, Making

if TYPE_CHECKING:
    from bssrdf.report import Check

T = TypeVar("T")


def slice_file(path: Path) -> Path:
    """The slice that a session folder, or a slice's own path, stands for."""
    return path / "measured" / "slice.csv" if path.is_dir() else path


def fit_files(
    inputs: Sequence[Path],
    options: FitOptions,
    keys: Mapping[str, Any],
    *,
    out: Path | None = None,
    with_g: bool = False,
    making: Making = SILENT,
    warn: Callable[[str], None] | None = None,
) -> list[Fit | BssrdfError]:
    """Fit sessions and slices in one batch; a session's fit is also written to its fit.json, or to `out`.

    `keys` are header keys of slice.csv that win over the file's; `with_g` fits g first, slice by slice. An input that
    fails gives its error in its place, and the others are fitted all the same. `making` is told of a
    Monte Carlo table that has to be made; `warn` is told of units that look wrong.
    """
    read = [_caught(_read_with_g if with_g else _read, path, keys) for path in inputs]
    good = [(path, piece) for path, piece in zip(inputs, read, strict=True) if isinstance(piece, Slice)]
    _doubt(good, options, warn)
    named = [(str(slice_file(path)), piece) for path, piece in good]
    fitted = dict(zip((path for path, _ in good), fit_all(named, options, making), strict=True))
    return [
        piece
        if isinstance(piece, BssrdfError)
        else _caught(_finish, path, piece, fitted[path], options, keys, out, with_g)
        for path, piece in zip(inputs, read, strict=True)
    ]


def fit_joint_files(
    inputs: Sequence[Path],
    options: FitOptions,
    keys: Mapping[str, Any],
    *,
    out: Path | None = None,
    making: Making = SILENT,
    warn: Callable[[str], None] | None = None,
) -> Fit:
    """One fit for sessions or slices of one material together, written to `out`; its options name every input."""
    pieces = [_read(path, keys) for path in inputs]
    _doubt(list(zip(inputs, pieces, strict=True)), options, warn)
    channels = fit_joint(pieces, options, making=making)
    sources = [{"path": str(slice_file(path)), "sha256": sha256_of(slice_file(path))} for path in inputs]
    fit = _fit(inputs[0], pieces[0], channels, asked(options, keys) | {"joint": sources})
    if out is not None:
        write_fit(out, fit)
    return fit


def read_fits(paths: Sequence[Path]) -> list[Fit]:
    """The fits that session folders or fit.json files stand for."""
    return [read_fit(path / "fit.json" if path.is_dir() else path) for path in paths]


def validate_fit(path: Path, picture: Path, *, progress: Callable[[str, int, int], None] | None = None) -> list[Check]:
    """Simulate the fit that `path` stands for and draw it beside its data; see `report.validation`."""
    from bssrdf.report import draw_validation, validate

    (fit,) = read_fits([path])
    source = slice_file(path) if path.is_dir() else Path(fit.input_path)
    given = {key: fit.options[key] for key in HEADER if key in fit.options}
    piece = read_slice(source, **given)
    missing = [name for name in fit.channels if name not in piece.channels]
    if missing:
        raise InputError(f"{source}: has no channel {missing[0]}, which {path} fits; run the fit again")
    checks = validate(fit, piece, progress=progress)
    if not checks:
        raise InputError(f"{path}: no channel converged, so there is nothing to simulate; look at its flags")
    with atomic_write(picture) as part:
        draw_validation(part, fit, checks)
    return checks


def stale(path: Path, fit: Fit) -> str | None:
    """A warning where the input of the fit that `path` stands for has changed since."""
    source = slice_file(path) if path.is_dir() else Path(fit.input_path)
    if source.exists() and sha256_of(source) != fit.input_sha256:
        return f"{source}: has changed since it was fitted; run the fit again"
    return None


def _read(path: Path, keys: Mapping[str, Any]) -> Slice:
    source = slice_file(path)
    if path.is_dir() and not source.exists():
        raise InputError(f"{path}: has no measured/slice.csv; run `bssrdf measure {path}` first")
    return _with_sample(path, read_slice(source, **keys))


def _with_sample(path: Path, piece: Slice) -> Slice:
    """The slice, with what its session says of the sample where the slice itself, measured earlier, is silent."""
    session, silent = _session(path), Slice({}, 1.0, "entering", "hemisphere")
    if session is None or session.material is None:
        return piece
    keys = {key: getattr(session.material, key) for key in SAMPLE_KEYS}
    return piece if any(getattr(piece, k) != getattr(silent, k) for k in SAMPLE_KEYS) else replace(piece, **keys)


def _read_with_g(path: Path, keys: Mapping[str, Any]) -> Slice:
    """The slice with the g that fits it best."""
    piece = _read(path, keys)
    return replace(piece, g=fit_g(piece, FitOptions()).g)


def _doubt(pieces: Sequence[tuple[Path, Slice]], options: FitOptions, warn: Callable[[str], None] | None) -> None:
    """Warn of slices whose units look wrong; where the scale is free their factor is not expected to be right."""
    if warn is not None and options.scale == "given":
        for path, piece in pieces:
            if (found := doubt(piece)) is not None:
                warn(f"{slice_file(path)}: {found}")


def _session(path: Path) -> Session | None:
    """The session around a slice, where its folder was given; a slice needs none."""
    return read_session(path) if (path / "session.toml").is_file() else None


def fit_all(
    pieces: Sequence[tuple[str, Slice]], options: FitOptions, making: Making = SILENT
) -> Sequence[dict[str, ChannelFit] | BssrdfError]:
    """Fits of named slices in one batch; where that is refused, one by one, to find whose fault it is."""
    try:
        return fit_slices([piece for _, piece in pieces], options, making=making)
    except BssrdfError:
        return [_caught(_fit_one, name, piece, options) for name, piece in pieces]


def _fit_one(name: str, piece: Slice, options: FitOptions) -> dict[str, ChannelFit]:
    try:
        return fit_slices([piece], options)[0]
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def _finish(
    path: Path,
    piece: Slice,
    channels: dict[str, ChannelFit] | BssrdfError,
    options: FitOptions,
    keys: Mapping[str, Any],
    out: Path | None,
    g_fitted: bool,
) -> Fit:
    """The fit with where it came from, written to where it belongs."""
    if isinstance(channels, BssrdfError):
        raise channels
    if g_fitted:
        channels = {name: replace(channel, flags=(*channel.flags, Flag.G_FITTED)) for name, channel in channels.items()}
    fit = _fit(path, piece, channels, asked(options, keys))
    target = out or (path / "fit.json" if path.is_dir() else None)
    if target is not None:
        write_fit(target, fit)
    return fit


def asked(options: FitOptions, keys: Mapping[str, Any]) -> dict[str, Any]:
    """What a fit says of its options."""
    return {name: value for name, value in asdict(options).items() if value is not None} | dict(keys)


def fit_of(source: str, sha256: str, piece: Slice, channels: dict[str, ChannelFit], options: dict[str, Any]) -> Fit:
    """The fits of a slice's channels with where they come from."""
    return Fit(
        version=bssrdf.__version__,
        input_path=source,
        input_sha256=sha256,
        options=options,
        material=piece.material,
        eta=piece.eta,
        g=piece.g,
        channels=channels,
        about=about(piece),
    )


def _fit(path: Path, piece: Slice, channels: dict[str, ChannelFit], options: dict[str, Any]) -> Fit:
    return fit_of(str(slice_file(path)), sha256_of(slice_file(path)), piece, channels, options)


def _caught(call: Callable[..., T], *arguments: Any) -> T | BssrdfError:
    try:
        return call(*arguments)
    except BssrdfError as error:
        return error
