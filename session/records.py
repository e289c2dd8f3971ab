"""What the files of a session hold, as frozen data classes. Lengths in mm, times in s, values of a frame in DN.

Nothing here reads or writes: see `session_toml`, `frames_csv`, `slice_csv`, `fit_json`, `frame_files`, `hdr_image`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from bssrdf.session.checks import layout, levels, sha256, time
from bssrdf.session.keys import ANGLE, COSINE, ERROR, LENGTH, POSITIVE, SHARE, Key, Range
from bssrdf.session.sample_keys import SAMPLE_KEYS as SAMPLE_KEYS
from bssrdf.session.sample_keys import Backing, BackingSd, Cover, Thickness, ThicknessSd, Wall, Width

NAN = float("nan")
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
Space = Literal["camera", "lin_rec709", "acescg"]
Azimuth = Literal["perpendicular", "mean"]
BeamKind = Literal["white", "led", "laser"]
Status = Literal["converged", "upper_bound", "unidentifiable", "rejected", "failed"]
Array = NDArray[np.float64]
ByChannel = dict[str, float]
Matrix = tuple[tuple[float, float, float], ...]


_DISPLAY = "calibrate colour writes it, and only measure --space asks for it"
_NAME = "names the result"
_WHOLE_ERROR = (
    "the whole error but the model's bias: noise of the curve, errors of R, scale, lengths and all that the budget "
    "names; null for `rejected` and `unidentifiable`"
)


@dataclass(frozen=True)
class Material:
    """`[material]`: what lies under the beam."""

    name: Annotated[str, Key("what lies under the beam", example="milk", informational=_NAME)]
    eta: Annotated[float, Key("index of refraction: 1.3 for watery things, 1.5 for marble", POSITIVE, example=1.3)]
    g: Annotated[float | None, Key("mean cosine of scattering", COSINE, example=0.0)] = None
    thickness_mm: Thickness = None
    thickness_sd_mm: ThicknessSd = None
    width_mm: Width = None
    wall: Wall = None
    backing: Backing = None
    backing_sd: BackingSd = None
    cover: Cover = "none"
    finish: Annotated[Literal["polished", "rough"], Key("the surface")] = "polished"


@dataclass(frozen=True)
class Camera:
    """`[camera]`: how a file's numbers become light. None where the file itself or the frames tell it."""

    layout: Annotated[
        str | None,
        Key('2x2 colour filter pattern, "mono" or "rgb"; RAW files say it themselves', example="RGGB", check=layout),
    ] = None
    black: Annotated[float | None, Key("level without light", ERROR, unit="DN", example=512.0)] = None
    white: Annotated[float | None, Key("level of saturation", POSITIVE, unit="DN", example=65535.0)] = None
    gain_e_per_dn: Annotated[float | None, Key("else estimated from the frames", POSITIVE, example=1.0)] = None
    read_noise_e: Annotated[float | None, Key("else estimated from the darks", ERROR, example=3.0)] = None
    exposure_rel_sd: Annotated[
        float | None,
        Key("error of the exposures; else 0.03 for labels, 0.0005 for exposure_measured_s", POSITIVE, example=0.001),
    ] = None
    aperture_mm: Annotated[float, Key("focal length over f-number; for a laser's speckle only", POSITIVE)] = 6.25
    response: Annotated[
        Literal["debevec"] | None,
        Key("for JPEG or video: fit their response curve; good to percents at best", example="debevec"),
    ] = None


@dataclass(frozen=True)
class Geometry:
    """`[geometry]`: from pixels to mm in the surface. Either `mm_per_px` or `homography` is given."""

    mm_per_px: Annotated[
        float | None,
        Key("scale in the surface, along the slice", POSITIVE, unit="mm", example=0.05, unless="homography"),
    ] = None
    homography: Annotated[
        Matrix | None,
        Key("instead: 3x3, pixel (x, y, 1) to mm", example=((0.05, 0.0, 0.0), (0.0, 0.07, 0.0), (0.0, 0.0, 1.0))),
    ] = None
    mm_per_px_rel_sd: Annotated[
        float | None,
        Key("relative error of the scale; 0.005 is assumed, and flagged, without it", SHARE, example=0.005),
    ] = None
    distance_mm: Annotated[float, Key("lens to surface; for a laser's speckle only", POSITIVE)] = 300.0
    view_angle_deg: Annotated[float, Key("camera against the surface normal", ANGLE, ask=True)] = 45.0
    view_angle_sd_deg: Annotated[
        float | None, Key("error of the view angle; 1 is assumed, and flagged, without it", ERROR, example=1.0)
    ] = None
    view_axis: Annotated[Literal["x", "y"], Key("image axis that the view foreshortens", ask=True)] = "y"


@dataclass(frozen=True)
class Beam:
    """`[beam]`: what lit the sample."""

    kind: Annotated[BeamKind, Key("a laser makes speckle and leaks into other channels", ask=True)] = "white"
    polarised: Annotated[bool, Key("an oblique beam that is polarised has a larger error of scale")] = False
    incidence_deg: Annotated[float, Key("beam against the surface normal", ANGLE, ask=True)] = 0.0
    spot_radius_mm: Annotated[float | None, Key("1/e² radius; else found on the tile", POSITIVE, example=0.15)] = None
    channels: Annotated[
        tuple[str, ...] | None,
        Key(
            'those that carry signal, else all; a name for a mono camera: ["633nm"]',
            example=("R", "G", "B"),
            unique=True,
        ),
    ] = None


@dataclass(frozen=True)
class Reference:
    """`[reference]`: the white tile, by its radiance factor for each channel."""

    name: Annotated[str, Key("what was white", example="Spectralon", informational=_NAME)]
    reflectance: Annotated[
        tuple[float, ...],
        Key(
            "radiance factor at this incidence and view, for each channel",
            Range(above=0, at_most=1.2),
            example=(0.99, 0.99, 0.99),
        ),
    ]
    reflectance_sd: Annotated[
        tuple[float, ...] | None,
        Key(
            "error of each; 1 % of it is assumed, and flagged, without it",
            ERROR,
            example=(0.005, 0.005, 0.005),
            ask=True,
        ),
    ] = None
    coplanar: Annotated[bool, Key("it lay in the sample's plane, under the same beam", example=True)] = False


@dataclass(frozen=True)
class Distortion:
    """`[distortion]`: OpenCV's pinhole camera matrix and its lens distortion coefficients."""

    camera_matrix: Annotated[
        Matrix,
        Key(
            "OpenCV's pinhole camera", unit="px", example=((1000.0, 0.0, 320.0), (0.0, 1000.0, 240.0), (0.0, 0.0, 1.0))
        ),
    ]
    coefficients: Annotated[tuple[float, ...], Key("k1, k2, p1, p2 and on, as OpenCV orders them", example=(0.0, 0.0))]


@dataclass(frozen=True)
class Colour:
    """`[colour]`: from linear camera RGB, white at 1, to linear sRGB (D65)."""

    matrix: Annotated[
        Matrix,
        Key(
            "3x3, linear camera RGB with white at 1 to linear sRGB (D65)",
            example=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            informational=_DISPLAY,
        ),
    ]
    rms: Annotated[
        float | None,
        Key("root mean square miss of the chart's patches, linear sRGB", SHARE, informational=_DISPLAY),
    ] = None


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

    camera: Annotated[str | None, Key("its model")] = None
    lens: Annotated[str | None, Key("its model")] = None
    iso: Annotated[float | None, Key("ISO speed", POSITIVE)] = None
    gain: Annotated[float | None, Key("of a machine-vision camera, in its own unit")] = None
    f_number: Annotated[float | None, Key("of the lens", POSITIVE)] = None
    focal_mm: Annotated[float | None, Key("focal length", POSITIVE)] = None
    temperature_c: Annotated[float | None, Key("of the sensor, or of the camera")] = None
    layout: Annotated[str | None, Key("as in `[camera]`")] = None
    bits: Annotated[int | None, Key("of the numbers, where the file tells; a container may be wider", POSITIVE)] = None
    black: Annotated[
        tuple[float, ...] | None, Key("one number, 3 by channel or 4 by place", unit="DN", check=levels)
    ] = None
    white: Annotated[tuple[float, ...] | None, Key("likewise", unit="DN", check=levels)] = None
    width_px: Annotated[int | None, Key("of the picture", POSITIVE)] = None
    height_px: Annotated[int | None, Key("of the picture", POSITIVE)] = None
    orientation: Annotated[int | None, Key("by EXIF, for display; the data are never turned", POSITIVE)] = None
    file_exposure_s: Annotated[float | None, Key("the camera's own, whatever `exposure_s` says", POSITIVE)] = None


@dataclass(frozen=True)
class Frame:
    """One line of frames.csv."""

    file: Annotated[str, Key("path in the session")]
    kind: Annotated[FrameKind, Key("what it shows")]
    exposure_s: Annotated[float, Key("as asked for", POSITIVE)]
    exposure_measured_s: Annotated[float | None, Key("as something measured it, which wins", POSITIVE)] = None
    utc: Annotated[str | None, Key("ISO 8601; without a zone it is the camera's own clock", check=time)] = None
    sha256: Annotated[str | None, Key("checksum of the file", check=sha256)] = None
    exposure_rel_sd: Annotated[
        float | None,
        Key("error of the exposure; else `[camera]`'s, 0.0005 if measured, 0.03 if not", POSITIVE),
    ] = None
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
    eta: Annotated[float, Key("relative index of refraction", Range(above=0, at_most=10), example=1.3)]
    flux: Annotated[Flux, Key("R_d is per unit of this flux; what enters lacks the specular share", example="incident")]
    exit: Annotated[
        Exit,
        Key(
            "all light that leaves (hemisphere), or a camera's view against a white reference by this law",
            example="fresnel",
        ),
    ]
    view_angle_deg: Annotated[float, Key("camera against the surface normal", ANGLE)] = 45.0
    view_angle_sd_deg: Annotated[float | None, Key("error of the view angle", ERROR)] = None
    azimuth: Annotated[Azimuth, Key("of the camera to the radius: at a right angle, or a mean")] = "perpendicular"
    band_mm: Annotated[float | None, Key("full width along the view of the pixels that make a slice", LENGTH)] = None
    incidence_deg: Annotated[float, Key("beam against the surface normal", ANGLE)] = 0.0
    total_r: Annotated[
        ByChannel, Key("total reflectance in the curve's own convention", Range(above=0, at_most=TOTAL_R_MAX))
    ] = field(default_factory=dict)
    total_r_sd: Annotated[ByChannel, Key("its error", ERROR)] = field(default_factory=dict)
    lost_fraction: Annotated[ByChannel | None, Key("light beyond the frame, already in total_r", SHARE)] = None
    g: Annotated[float | None, Key("mean cosine of the phase function", COSINE)] = None
    eta_sd: Annotated[float | None, Key("error of eta", ERROR)] = None
    g_sd: Annotated[float | None, Key("error of g", ERROR)] = None
    spot_radius_mm: Annotated[float | None, Key("1/e² radius of the spot", LENGTH)] = None
    spot_radius_sd_mm: Annotated[float | None, Key("error of the spot radius", ERROR)] = None
    scale_rel_sd: Annotated[float | None, Key("relative error of curve and total; else 0, flagged", ERROR)] = None
    mm_rel_sd: Annotated[float | None, Key("relative error of all lengths; else 0, flagged", ERROR)] = None
    shared_errors: Annotated[
        str | None, Key("slices with the same text share errors of scale and length, as those against one tile do")
    ] = None
    thickness_mm: Thickness = None
    thickness_sd_mm: ThicknessSd = None
    width_mm: Width = None
    wall: Wall = None
    backing: Backing = None
    backing_sd: BackingSd = None
    cover: Cover = "none"
    material: Annotated[str | None, Key("name of the material", informational=_NAME)] = None
    space: Annotated[
        Space | None,
        Key("colour space of R, G, B; none is the camera's own, unsaid", informational="tells a renderer what to do"),
    ] = None
    wavelength_nm: Annotated[ByChannel | None, Key("of the light", POSITIVE, informational="names the band")] = None
    flags: Annotated[tuple[str, ...], Key("found while measuring", informational="go to the fit's")] = ()
    provenance: Annotated[
        dict[str, Any], Key("where the curve comes from", informational="so that it can be measured again")
    ] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ChannelFit:
    """Coefficients of one channel, errors apart: statistical sd and interval, relative model error, flags."""

    model: Annotated[str, Key("the forward model that was fitted: dipole or mc")]
    sigma_a_per_mm: Annotated[float, Key("absorption coefficient σa")]
    sigma_a_sd_per_mm: Annotated[float, Key(_WHOLE_ERROR)]
    sigma_a_interval95_per_mm: Annotated[tuple[float, float], Key("95 % interval of the same errors")]
    sigma_sp_per_mm: Annotated[float, Key("reduced scattering coefficient σs′")]
    sigma_sp_sd_per_mm: Annotated[float, Key("as for σa")]
    sigma_sp_interval95_per_mm: Annotated[tuple[float, float], Key("as for σa")]
    correlation: Annotated[float, Key("of the errors of σa and σs′")]
    model_error: Annotated[
        dict[str, float],
        Key("relative to the value, by coefficient: the dipole's bias, not in the sd; a table's noise, which is"),
    ] = field(default_factory=dict)
    budget: Annotated[
        dict[str, dict[str, float]],
        Key(
            "by coefficient the shares of the variance of ln σ by source (`noise`, `total`, `scale`, `length`, `spot`, "
            "`view`, `exit_law`, `side`, `table`, `eta`, `g`, `thickness`, `back`, `ratio`, `misfit`), sum 1; null "
            "for bounds and where nothing is stated"
        ),
    ] = field(default_factory=dict)
    not_stated: Annotated[tuple[str, ...], Key("within `budget`: errors that no slice states, which count as 0")] = ()
    total_r_measured: Annotated[float, Key("as the slice has it", informational="stands beside the model's")]
    total_r_model: Annotated[float, Key("of the coefficients: per flux entering, over the hemisphere")]
    total_r_half_space: Annotated[
        float, Key("likewise of a half space of them; that of the sample stands in `total_r_model`")
    ] = NAN
    tau_p: Annotated[float, Key("σt′ times the depth of a finite sample; null for a half space")] = NAN
    sample_effect: Annotated[
        tuple[float, float],
        Key("of back and walls: ln of R over a half space's, and the curve's smallest ratio to it; else null"),
    ] = (NAN, NAN)
    window_mm: Annotated[tuple[float, float], Key("radii that counted")]
    n: Annotated[int, Key("how many")]
    chi2_reduced: Annotated[float, Key("χ² per degree of freedom; null where the curve came without errors")]
    status: Annotated[Status, Key("see [flags](flags.md)")]
    flags: Annotated[tuple[str, ...], Key("see [flags](flags.md)")] = ()
    sensitivity: Annotated[
        dict[str, float],
        Key("what a wrong g or η would do: `d_ln_sigma_a_d_g` and the like, times the error of g or η"),
    ] = field(default_factory=dict)


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
    about: dict[str, Any] = field(default_factory=dict)
    """What the slice only informs of, by key."""
