"""What the files of a session hold, as frozen data classes. Lengths in mm, times in s, values of a frame in DN.

Nothing here reads or writes: see `session_toml`, `frames_csv`, `slice_csv`, `fit_json`, `frame_files`, `hdr_image`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

TOTAL_R_MAX = 1.1
"""A white sample can outshine a Lambertian reference at some angles, but not by more."""

FrameKind = Literal[
    "sample",
    "sample_dark",
    "reference",
    "reference_dark",
    "dark",
    "flat",
    "flat_dark",
    "target",
    "chart",
    "sample_hdr",
    "reference_hdr",
]
KINDS: tuple[FrameKind, ...] = get_args(FrameKind)
Flux = Literal["incident", "entering"]
Exit = Literal["hemisphere", "lambertian", "fresnel"]
Azimuth = Literal["perpendicular", "mean"]
BeamKind = Literal["white", "led", "laser"]
Status = Literal["converged", "upper_bound", "unidentifiable", "rejected", "failed"]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Material:
    """`[material]`: what lies under the beam."""

    name: str
    eta: float
    g: float | None = None
    thickness_mm: float | None = None
    width_mm: float | None = None
    backing: str | None = None
    cover: Literal["none", "glass"] = "none"
    finish: Literal["polished", "rough"] = "polished"


@dataclass(frozen=True)
class Camera:
    """`[camera]`: how a file's numbers become light. None where the file itself or the frames tell it."""

    layout: str | None = None
    """A 2×2 colour filter pattern such as RGGB, "mono" or "rgb"."""
    black: float | None = None
    """DN at no light."""
    white: float | None = None
    """DN at saturation."""
    gain_e_per_dn: float | None = None
    read_noise_e: float | None = None
    exposure_rel_sd: float | None = None
    """Relative error of the frames' exposures; None: assumed by where each comes from."""
    aperture_mm: float = 6.25
    """Diameter of the lens's entrance pupil, its focal length over the f-number; for the speckle of a laser."""
    response: Literal["debevec"] | None = None
    """How frames that are not linear (JPEG, video) are made so; None where they are, or are to be refused."""


@dataclass(frozen=True)
class Geometry:
    """`[geometry]`: from pixels to mm in the surface. Either `mm_per_px` or `homography` is given."""

    mm_per_px: float | None = None
    homography: tuple[tuple[float, float, float], ...] | None = None
    """3×3, pixel (x, y, 1) to mm in the surface."""
    mm_per_px_rel_sd: float | None = None
    """None: not stated."""
    distance_mm: float = 300.0
    """From the lens to the surface; for the speckle of a laser."""
    view_angle_deg: float = 45.0
    """Camera against the surface normal."""
    view_angle_sd_deg: float | None = None
    """None: not stated."""
    view_axis: Literal["x", "y"] = "y"
    """Image axis that the view foreshortens; the slice is perpendicular to it."""


@dataclass(frozen=True)
class Beam:
    """`[beam]`."""

    kind: BeamKind = "white"
    polarised: bool = False
    incidence_deg: float = 0.0
    spot_radius_mm: float | None = None
    """1/e² radius of the irradiance."""
    channels: tuple[str, ...] | None = None
    """Channels that carry signal; None is all of them."""


@dataclass(frozen=True)
class Reference:
    """`[reference]`: the white tile, by its radiance factor for each channel."""

    name: str
    reflectance: tuple[float, ...]
    reflectance_sd: tuple[float, ...] | None = None
    coplanar: bool = False
    """Whether it lay in the sample's plane, so that the beam lands on both at the same place of the picture."""


@dataclass(frozen=True)
class Distortion:
    """`[distortion]`: OpenCV's pinhole camera matrix and its lens distortion coefficients."""

    camera_matrix: tuple[tuple[float, float, float], ...]
    coefficients: tuple[float, ...]


@dataclass(frozen=True)
class Colour:
    """`[colour]`: from linear camera RGB, white at 1, to linear sRGB (D65). For display only."""

    matrix: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Session:
    """session.toml, with `calibration` merged in. Tables that a command does not need may be None."""

    path: Path
    camera: Camera
    material: Material | None = None
    geometry: Geometry | None = None
    beam: Beam = field(default_factory=Beam)
    reference: Reference | None = None
    distortion: Distortion | None = None
    colour: Colour | None = None
    calibration: str | None = None
    """File name of the calibration that was merged in, relative to the session."""


@dataclass(frozen=True)
class Card:
    """What the file of a frame says of itself, None where it does not: each an optional column of frames.csv."""

    camera: str | None = None
    lens: str | None = None
    iso: float | None = None
    gain: float | None = None
    """Of a machine-vision camera, in its own unit."""
    f_number: float | None = None
    focal_mm: float | None = None
    temperature_c: float | None = None
    """Of the sensor, or of the camera."""
    layout: str | None = None
    """As in `[camera]`."""
    bits: int | None = None
    """Of the numbers, where the file tells; a container may be wider."""
    black: tuple[float, ...] | None = None
    """[DN], one number, or four by place in the 2×2 pattern."""
    white: tuple[float, ...] | None = None
    """[DN], likewise."""
    width_px: int | None = None
    height_px: int | None = None
    orientation: int | None = None
    """By EXIF: how the picture is to be turned for display. The data are never turned."""


@dataclass(frozen=True)
class Frame:
    """One line of frames.csv."""

    file: str
    kind: FrameKind
    exposure_s: float
    exposure_measured_s: float | None = None
    utc: str | None = None
    """ISO 8601; without a zone it is the camera's own clock."""
    sha256: str | None = None
    exposure_rel_sd: float | None = None
    """Relative error of the exposure used; None: assumed by where it comes from."""
    card: Card = Card()


@dataclass(frozen=True)
class ChannelSlice:
    """R_d along the slice in one channel; arrays of shape (n,), radii ascending."""

    r_mm: Array
    rd_per_mm2: Array
    sd_per_mm2: Array
    """NaN where unknown."""
    r_lo_mm: Array | None = None
    """With `r_hi_mm`: each value is the mean over the annulus [r_lo, r_hi], weighted by r dr."""
    r_hi_mm: Array | None = None
    side: NDArray[np.int8] | None = None
    """−1 and +1 where the two halves of the slice are kept apart."""


@dataclass(frozen=True)
class Slice:
    """slice.csv: R_d(r) [1/mm²] by channel, and the convention it is in."""

    channels: dict[str, ChannelSlice]
    eta: float
    flux: Flux
    exit: Exit
    view_angle_deg: float = 45.0
    azimuth: Azimuth = "perpendicular"
    """Of the camera about the normal: at a right angle to the radius, or the mean over a whole image."""
    band_mm: float | None = None
    """Full width along the view of the band around a perpendicular slice that was averaged: near the beam it holds
    other azimuths too. None: hardly any."""
    incidence_deg: float = 0.0
    total_r: dict[str, float] = field(default_factory=dict)
    """Total reflectance by channel in the convention of the curve; a channel may be missing."""
    total_r_sd: dict[str, float] = field(default_factory=dict)
    material: str | None = None
    g: float | None = None
    eta_sd: float | None = None
    g_sd: float | None = None
    view_angle_sd_deg: float | None = None
    spot_radius_mm: float | None = None
    spot_radius_sd_mm: float | None = None
    lost_fraction: dict[str, float] | None = None
    scale_rel_sd: float | None = None
    """Relative error common to the curve and the total."""
    mm_rel_sd: float | None = None
    """Relative error of the length scale."""
    shared_errors: str | None = None
    """Slices with the same text share the errors of scale and length, as those against one tile do."""
    flags: tuple[str, ...] = ()
    """What measuring found fault with; from the documented list."""
    provenance: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ChannelFit:
    """Coefficients of one channel [1/mm], errors apart: statistical sd and interval, relative model error, flags."""

    model: str
    sigma_a_per_mm: float
    sigma_a_sd_per_mm: float
    sigma_a_interval95_per_mm: tuple[float, float]
    sigma_sp_per_mm: float
    sigma_sp_sd_per_mm: float
    sigma_sp_interval95_per_mm: tuple[float, float]
    correlation: float
    total_r_measured: float
    total_r_model: float
    """Entering, hemisphere."""
    window_mm: tuple[float, float]
    n: int
    chi2_reduced: float
    status: Status
    flags: tuple[str, ...] = ()
    model_error: dict[str, float] = field(default_factory=dict)
    """Relative, by coefficient: `sigma_a`, `sigma_sp`."""
    sensitivity: dict[str, float] = field(default_factory=dict)
    """Derivatives such as `d_ln_sigma_a_d_g`."""
    budget: dict[str, dict[str, float]] = field(default_factory=dict)
    """By coefficient, the share of the variance of ln σ by independent source; each adds up to 1."""
    not_stated: tuple[str, ...] = ()
    """Errors that count as 0 because no slice states them."""


@dataclass(frozen=True)
class Fit:
    """fit.json."""

    version: str
    input_path: str
    input_sha256: str
    options: dict[str, Any]
    material: str | None
    eta: float
    g: float | None
    channels: dict[str, ChannelFit]
