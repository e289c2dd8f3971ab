"""`bssrdf measure`: a session's frames to HDR images, the slice and the total reflectance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import bssrdf
from bssrdf.calib.surface import Surface
from bssrdf.errors import InputError
from bssrdf.measure.bracket import Bracket, bracket_of, camera_of
from bssrdf.measure.learn import Learnt, learn_camera
from bssrdf.measure.merge import Hdr, Progress, merge
from bssrdf.measure.pixels import channel_names, mosaic_period
from bssrdf.measure.plot import write_slice_png
from bssrdf.measure.reflectance import (
    Image,
    channel_slice,
    locate,
    radial_profile,
    slice_profiles,
    total_light,
)
from bssrdf.measure.tail import Boundary
from bssrdf.session.atomic import replace_folder, sha256_of
from bssrdf.session.frames_csv import read_frames
from bssrdf.session.hdr_exr import write_hdr_exr
from bssrdf.session.records import Camera, Frame, FrameKind, Reference, Session, Slice
from bssrdf.session.slice_csv import write_slice
from bssrdf.transport.fresnel import boundary_a

_TILE_ETA = 1.35
"""Sintered PTFE."""
_KINDS: tuple[FrameKind, ...] = ("sample", "reference")


@dataclass(frozen=True)
class Measured:
    """What was measured: the merged images by kind, and the slice unless only images were asked for."""

    images: dict[str, Hdr]
    provenance: dict[str, Any]
    slice: Slice | None = None


def measure_session(
    session: Session,
    *,
    hdr_only: bool = False,
    radial: bool = False,
    glare: bool = False,
    progress: Progress | None = None,
) -> Measured:
    """Measure the session and write its folder `measured/`, replaced as a whole.

    With `hdr_only` only the images are made, and only [camera] is needed; with `radial` the curve comes from the
    whole image, not from the slice; with `glare` an even floor is taken for veiling glare and subtracted. InputError
    where frames or tables are missing or cannot be used.
    """
    frames = read_frames(session.path)
    if not hdr_only:
        _check_tables(session, frames)
    brackets: dict[str, Bracket] = {
        kind: bracket for kind in _KINDS if (bracket := bracket_of(kind, session.path, frames)).frames
    }
    if not brackets:
        raise InputError(f"{session.path / 'frames.csv'}: lists no frame of kind sample or reference; add some")
    camera = camera_of(next(iter(brackets.values())), session.camera)
    learnt = learn_camera(list(brackets.values()), camera, mosaic_period(camera.layout or "mono"))
    images = {kind: _merged(bracket, camera, learnt, progress) for kind, bracket in brackets.items()}
    provenance = _provenance(session, brackets, learnt)
    curve = None if hdr_only else _slice(session, images, camera, learnt, radial, glare, provenance)
    measured = Measured(images, provenance, curve)
    _write(session, measured)
    return measured


def _check_tables(session: Session, frames: Sequence[Frame]) -> None:
    for name in ("material", "geometry", "reference"):
        if getattr(session, name) is None:
            raise InputError(f"{session.path / 'session.toml'}: has no [{name}]; add it, or measure with --hdr-only")
    for kind in _KINDS:
        if not any(frame.kind in (kind, f"{kind}_hdr") for frame in frames):
            raise InputError(
                f"{session.path / 'frames.csv'}: lists no frame of kind {kind}; add some, or measure with --hdr-only"
            )


def _merged(bracket: Bracket, camera: Camera, learnt: Learnt, progress: Progress | None) -> Hdr:
    return merge(
        bracket.shots(_exposures_used(bracket, learnt)),
        learnt.sensor,
        hot=learnt.hot,
        period=mosaic_period(camera.layout or "mono"),
        progress=progress,
        what=bracket.kind,
    )


def _exposures_used(bracket: Bracket, learnt: Learnt) -> list[float]:
    """Measured or nominal times, corrected by what the overlap of the bracket says of each label."""
    return [
        seconds * learnt.exposures.of(frame.exposure_s) / frame.exposure_s
        for frame, seconds in zip(bracket.frames, bracket.exposures_s(), strict=True)
    ]


def _slice(
    session: Session,
    images: Mapping[str, Hdr],
    camera: Camera,
    learnt: Learnt,
    radial: bool,
    glare: bool,
    provenance: dict[str, Any],
) -> Slice:
    assert session.material
    assert session.geometry
    assert session.reference
    assert camera.layout
    surface = Surface(session.geometry, session.distortion)
    every = channel_names(camera.layout, session.beam)
    used = session.beam.channels or every
    sample, reference = (Image(kind, images[kind], camera.layout, used, surface) for kind in _KINDS)
    spot, reference_spot = locate(sample), locate(reference)
    boundary, tile_boundary = (_boundary(eta, session) for eta in (session.material.eta, _TILE_ETA))
    channels, total_r, total_r_sd, lost = {}, {}, {}, {}
    for channel in used:
        reflectance = reflectance_of(session.reference, channel, used, every)
        incident = total_light(reference, channel, reference_spot, tile_boundary, glare=glare)
        back = total_light(sample, channel, spot, boundary, glare=glare)
        per_light = reflectance / incident.light
        profiles = {0: radial_profile(sample, channel, spot)} if radial else slice_profiles(sample, channel, spot, None)
        channels[channel] = channel_slice(profiles, back.floor, per_light)
        lost[channel] = back.lost_fraction
        total_r[channel] = back.light * per_light
        total_r_sd[channel] = total_r[channel] * float(np.hypot(back.sd / back.light, incident.sd / incident.light))
    return Slice(
        channels=channels,
        eta=session.material.eta,
        flux="incident",
        exit="fresnel",
        view_angle_deg=session.geometry.view_angle_deg,
        incidence_deg=session.beam.incidence_deg,
        total_r=total_r,
        total_r_sd=total_r_sd,
        material=session.material.name,
        g=session.material.g,
        spot_radius_mm=session.beam.spot_radius_mm,
        lost_fraction=lost,
        scale_rel_sd=_scale_rel_sd(session.reference),
        mm_rel_sd=session.geometry.mm_per_px_rel_sd,
        flags=learnt.flags,
        provenance=provenance,
    )


def _boundary(eta: float, session: Session) -> Boundary:
    """How light leaves towards the camera; below an η of 1 as at 1."""
    assert session.geometry
    eta = max(eta, 1.0)
    return Boundary(
        float(boundary_a(eta)), float(np.sqrt(1 - (np.sin(np.radians(session.geometry.view_angle_deg)) / eta) ** 2))
    )


def reflectance_of(reference: Reference, channel: str, used: Sequence[str], every: Sequence[str]) -> float:
    """The tile's radiance factor in a channel: one value for all, one for each channel, or one for each used."""
    values = reference.reflectance
    if len(values) == 1:
        return values[0]
    for names in (every, used):
        if len(values) == len(names):
            return values[list(names).index(channel)]
    raise InputError(
        f"session.toml: [reference] reflectance has {len(values)} values for the {len(every)} channels "
        f"{', '.join(every)}; give one for each"
    )


def _scale_rel_sd(reference: Reference) -> float:
    """Largest relative error of the tile's reflectance over the channels."""
    if reference.reflectance_sd is None:
        return 0.0
    return max(sd / value for sd, value in zip(reference.reflectance_sd, reference.reflectance, strict=True))


def _provenance(session: Session, brackets: Mapping[str, Bracket], learnt: Learnt) -> dict[str, Any]:
    files = {
        frame.file: sha256_of(session.path / frame.file)
        for bracket in brackets.values()
        for frame in (*bracket.frames, *(dark for darks in bracket.darks for dark in darks))
    }
    return {
        "version": bssrdf.__version__,
        "exposures_s": {kind: _exposures_used(bracket, learnt) for kind, bracket in brackets.items()},
        "exposures_rel_sd": list(learnt.exposures.rel_sd.values()),
        "sensor": asdict(learnt.sensor),
        "nonlinearity": learnt.nonlinearity,
        "calibration": session.calibration or "",
        "sha256": files,
    }


def _write(session: Session, measured: Measured) -> None:
    with replace_folder(session.path / "measured") as folder:
        for kind, hdr in measured.images.items():
            write_hdr_exr(folder / f"{kind}.exr", vars(hdr), measured.provenance)
        if measured.slice is not None:
            write_slice(folder / "slice.csv", measured.slice)
            write_slice_png(folder / "slice.png", measured.slice)
