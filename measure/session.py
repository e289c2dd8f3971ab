"""`bssrdf measure`: a session's frames to HDR images, the slice and the total reflectance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

import bssrdf
from bssrdf.calib import Exposures, Surface
from bssrdf.errors import InputError
from bssrdf.measure.bracket import Bracket, bracket_of, camera_of, layout_of, session_response
from bssrdf.measure.colour_space import in_space
from bssrdf.measure.frame_checks import warm_dark
from bssrdf.measure.hdr import Hdr, Planes, Progress, flattened, merge
from bssrdf.measure.image import Image
from bssrdf.measure.learn import Learnt, learn_camera
from bssrdf.measure.levels import plain_corrections
from bssrdf.measure.merged import Merged, Told, inputs_of, read_elsewhere, read_merged, write_summaries
from bssrdf.measure.pixels import channel_names, mosaic_period
from bssrdf.measure.plot import write_scene_png, write_slice_png
from bssrdf.measure.slice import SliceOptions, measure_slice
from bssrdf.measure.total_errors import Timing
from bssrdf.session import (
    UNNAMED,
    check_constant,
    check_no_copy,
    counted,
    is_ours,
    read_frames,
    replace_folder,
    sha256_of,
    with_cards,
    write_slice,
)
from bssrdf.session.flags import Flag
from bssrdf.session.records import Camera, Frame, FrameKind, Session, Slice, Space

_KINDS: tuple[FrameKind, ...] = ("sample", "reference")


@dataclass(frozen=True)
class Measured:
    """What was measured: the merged images by kind, and the slice unless only images were asked for."""

    images: dict[str, Planes]
    provenance: dict[str, Any]
    slice: Slice | None = None


@threadpool_limits.wrap(limits=1, user_api="blas")  # small matrices: two threads take twenty times the processor time
def measure_session(
    session: Session,
    *,
    hdr_only: bool = False,
    from_hdr: bool = False,
    radial: bool = False,
    glare: bool = False,
    band_mm: float | None = None,
    hdr_rel_sd: float | None = None,
    space: Space | None = None,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Measured:
    """Measure the session and write its folder `measured/`, or `out` in its place, replaced as a whole.

    With `hdr_only` only the images are made, and only [camera] is needed; with `from_hdr` those that an earlier run
    wrote are used, and no frame is read; with `radial` the curve comes from the whole image, not from the slice, whose
    full width along the view is `band_mm`; with `glare` an even floor is taken for veiling glare and subtracted;
    `hdr_rel_sd` is the relative error of a pixel in images that were merged elsewhere, which their scatter tells if it
    is None; `space` converts the curve by the session's colour matrix. InputError where frames or tables are missing
    or cannot be used.
    """
    listed = read_frames(session.path, must_exist=not from_hdr)
    if not hdr_only:
        _check_complete(session, listed)
    merged = read_merged(session, listed, _KINDS) if from_hdr else _merged(session, listed, hdr_rel_sd, progress)
    told = merged.told
    curve, images = None, dict[str, Image]()
    if not hdr_only:
        images = images_of(session, merged)
        options = SliceOptions(radial, glare, band_mm)
        sample, reference = (images[kind] for kind in _KINDS)
        curve = measure_slice(session, sample, reference, told.timing, told.exposures, options, told.flags)
        unnamed = [Flag.UNNAMED] if session.material and session.material.name == UNNAMED else []
        curve = replace(
            curve,
            flags=tuple(dict.fromkeys((*told.flags, *unnamed, *curve.flags))),
            shared_errors=_of_reference(listed, merged.provenance["sha256"]),
            provenance={**merged.provenance, **curve.provenance},
        )
        curve = in_space(curve, session, space) if space else curve
    measured = Measured(merged.images, merged.provenance, curve)
    if from_hdr:
        new = {kind: image.summary for kind, image in images.items() if image.summary is not image.known}
        write_summaries(session.path / "measured", new)
        _write_curve(out or session.path / "measured", session, images, measured)
    else:
        with replace_folder(out or session.path / "measured") as folder:
            merged.write(folder)
            write_summaries(folder, {kind: image.summary for kind, image in images.items()})
            _write_curve(folder, session, images, measured)
    return measured


def _merged(session: Session, listed: Sequence[Frame], hdr_rel_sd: float | None, progress: Progress | None) -> Merged:
    """The session's frames merged, kind by kind."""
    inputs = inputs_of(session, listed)
    listed = with_cards(session.path, listed, encoded=session.camera.response is not None)
    check_constant(listed, session.path)
    hashes = {frame.file: sha256_of(session.path / frame.file) for frame in counted(listed, "check", progress)}
    check_no_copy(listed, hashes, session.path)
    frames, flags = _without_duplicates(listed, hashes)
    response = session_response(session, frames)
    flags += [Flag.NOT_LINEAR] if response else []
    every = (bracket_of(kind, session.path, frames, response) for kind in _KINDS)
    brackets: dict[str, Bracket] = {bracket.kind: bracket for bracket in every if bracket.frames}
    images, camera = read_elsewhere(session, frames, hdr_rel_sd)
    if brackets:
        _check_unit(session.path, frames)
    learnt, found = None, {}
    if dark := warm_dark(brackets.values()):
        flags.append(Flag.DARK_TEMPERATURE)
        found[Flag.DARK_TEMPERATURE] = str(dark)
    layouts = {kind: layout_of(bracket, session.camera) for kind, bracket in brackets.items()}
    if brackets:
        camera = camera_of(next(iter(brackets.values())), session.camera)
        learnt = learn_camera(list(brackets.values()), camera, mosaic_period(camera.layout or "mono"), progress)
        images |= _merge_all(brackets, frames, camera, learnt, progress)
        flags += learnt.flags
    if missing := {kind: n for kind, hdr in images.items() if (n := hdr.n_missing())}:
        flags.append(Flag.MISSING_PIXELS)
        found[Flag.MISSING_PIXELS] = ", ".join(f"{n} of the {kind}" for kind, n in missing.items())
    if not images:
        raise InputError(f"{session.path / 'frames.csv'}: lists no frame of kind sample or reference; add some")

    timing = {kind: _timing(bracket, learnt) for kind, bracket in brackets.items() if learnt}
    told = Told(
        {kind: layouts.get(kind, camera.layout or "mono") for kind in images},
        timing,
        learnt.exposures if learnt else Exposures(),
        tuple(flags),
        inputs,
    )
    return Merged(dict(images), told, _provenance(session, timing, learnt, hashes) | {"found": found})


def _check_unit(path: Path, frames: Sequence[Frame]) -> None:
    """InputError for an image in a unit of its own where it would be compared with frames."""
    for frame in frames:
        if frame.kind.endswith("_hdr") and not is_ours(path / frame.file):
            raise InputError(
                f"{path / frame.file}: is in a unit of the tool that merged it, and cannot be compared with frames of "
                "the other kind; give merged images of both, or frames of both"
            )


def _check_complete(session: Session, frames: Sequence[Frame]) -> None:
    for kind in _KINDS:
        if not any(frame.kind in (kind, f"{kind}_hdr") for frame in frames):
            raise InputError(
                f"{session.path / 'frames.csv'}: lists no frame of kind {kind}; add some, or measure with --hdr-only"
            )


def _without_duplicates(frames: Sequence[Frame], hashes: Mapping[str, str]) -> tuple[list[Frame], list[str]]:
    """The frames without copies of another: merged twice, noise would look halved."""
    kept = {(frame.kind, frame.exposure_s, hashes[frame.file]): frame for frame in reversed(frames)}
    unique = [frame for frame in frames if frame.kind.endswith("dark") or frame in kept.values()]
    return unique, [Flag.DUPLICATE_FRAME] if len(unique) < len(frames) else []


def _of_reference(frames: Sequence[Frame], hashes: Mapping[str, str]) -> str:
    """A text that sessions measured against one reference have in common: a digest of its frames, in any order."""
    own = sorted(hashes[frame.file] for frame in frames if frame.kind in ("reference", "reference_hdr"))
    return f"reference {sha256(''.join(own).encode()).hexdigest()[:16]}"


def _merge_all(
    brackets: Mapping[str, Bracket],
    frames: Sequence[Frame],
    camera: Camera,
    learnt: Learnt,
    progress: Progress | None,
) -> dict[str, Hdr]:
    """The brackets merged, and divided by the flat field where there is one."""
    first = next(iter(brackets.values()))
    flat = bracket_of("flat", first.folder, frames, first.response)
    every = {**brackets, "flat": flat} if flat.frames else brackets
    merged = {
        kind: merge(
            bracket.shots(_timing(bracket, learnt).seconds, learnt.corrections),
            learnt.sensor,
            hot=learnt.hot,
            period=mosaic_period(camera.layout or "mono"),
            model_rel_sd=learnt.contradiction,
            progress=progress,
            what=kind,
        )
        for kind, bracket in every.items()
    }
    if flat.frames:
        field = merged.pop("flat")
        merged = {kind: flattened(hdr, field, mosaic_period(camera.layout or "mono")) for kind, hdr in merged.items()}
    return dict(merged)


def _timing(bracket: Bracket, learnt: Learnt) -> Timing:
    """Measured or nominal times, corrected by what the overlap of the brackets says of each label."""
    labels = tuple(frame.exposure_s for frame in bracket.frames)
    seconds = tuple(
        t * learnt.exposures.factor(bracket.kind, label) for t, label in zip(bracket.exposures_s(), labels, strict=True)
    )
    return Timing(labels, seconds, learnt.flux_rel_sd.get(bracket.kind, 0.0), learnt.sensor.hidden_dn())


def images_of(session: Session, merged: Merged) -> dict[str, Image]:
    """The merged images by kind, with the way they are read."""
    return {kind: _image(kind, merged, session) for kind in merged.images}


def _image(kind: str, merged: Merged, session: Session) -> Image:
    if session.geometry is None:
        raise InputError(f"{session.path / 'session.toml'}: has no [geometry]; add it, or measure with --hdr-only")
    layout = merged.told.layouts[kind]
    channels = channel_names(layout, session.beam)
    for name in session.beam.channels or ():
        if name not in channels:
            raise InputError(
                f"{session.path / 'session.toml'}: [beam] channels names {name}, but the camera has "
                f"{', '.join(channels)}; correct it"
            )
    used = tuple(name for name in channels if name in (session.beam.channels or channels))
    surface = Surface(session.geometry, session.distortion)
    return Image(kind, merged.images[kind], layout, used, surface, merged.summaries.get(kind))


def _provenance(
    session: Session, timing: Mapping[str, Timing], learnt: Learnt | None, hashes: Mapping[str, str]
) -> dict[str, Any]:
    own: dict[str, Any] = {
        "version": bssrdf.__version__,
        "calibration": session.calibration or "",
        "response": session.camera.response or "linear",
        "exposures_s": {kind: list(each.seconds) for kind, each in timing.items()},
        "sha256": dict(hashes),
    }
    if learnt is None:
        return own
    return own | {
        "sensor": asdict(learnt.sensor),
        "gain_rel_sd": learnt.gain_rel_sd,
        "exposures_rel_sd": _relative(learnt.exposures),
        "nonlinearity": learnt.nonlinearity,
        "corrections": plain_corrections(learnt.corrections),
    }


def _relative(exposures: Exposures) -> dict[str, float]:
    """By kind and label, since TOML and JSON have text for keys."""
    sds = exposures.rel_sd.tolist()
    return {f"{kind} {label:g}": sd for (kind, label), sd in zip(exposures.frames, sds, strict=True)}


def _write_curve(folder: Path, session: Session, images: Mapping[str, Image], measured: Measured) -> None:
    if measured.slice is not None:
        write_slice(folder / "slice.csv", measured.slice)
        write_slice_png(folder / "slice.png", measured.slice)
        write_scene_png(folder / "scene.png", session, images, measured.slice)
