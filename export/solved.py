"""A material made ready for one target, and what its file says of itself. Lengths in mm."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

import bssrdf
from bssrdf.export.closure import DEPTHS, Closure, Limits, solve
from bssrdf.export.loss import lost_share
from bssrdf.export.material import CAMERA, ExportMaterial
from bssrdf.export.unit import Unit
from bssrdf.transport import CHANNELS

Keep = Literal["appearance", "medium"]
Triple = tuple[Closure, Closure, Closure]

RADII = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
"""[1/σtr] where R_d(r) is compared."""
_SPACES = {
    CAMERA: "the camera's own R, G, B; not converted",
    "lin_rec709": "linear Rec. 709 (sRGB primaries, D65), converted by the camera's colour matrix",
    "acescg": "ACEScg (AP1 primaries), converted by the camera's colour matrix",
}


class Setting(NamedTuple):
    """What was asked for, the same for all materials of a file."""

    target: str
    """With versions, in words."""
    keep: Keep
    unit: Unit
    scene_unit: bool = False
    """Whether a unit of the scene has a length of its own that the file follows."""


class Bounded(NamedTuple):
    """Closures under a renderer's limits."""

    limits: Limits
    closures: Triple


def closures(material: ExportMaterial, limits: Limits) -> Bounded:
    """The closures of the three channels."""
    red, green, blue = (solve(medium, limits) for medium in material.media)
    return Bounded(limits, (red, green, blue))


def head(material: ExportMaterial, setting: Setting) -> list[str]:
    """Lines that every file carries: what was kept, unit, colour space, η, version, remarks."""
    kept = {
        "appearance": "kept: appearance, that is the total R and a shadow's edge, by an index-matched random walk",
        "medium": "kept: medium, that is σa, σs, g and η as measured",
    }[setting.keep]
    scene = ", by the scene's unit scale" if setting.scene_unit else ""
    return [
        f"{material.name}, from {material.source}, by bssrdf {bssrdf.__version__}",
        f"target: {setting.target}",
        kept,
        f"unit: 1 {setting.unit}{scene}; numbers are lengths in {setting.unit} or coefficients in 1/{setting.unit}",
        f"colour space: {_SPACES[material.space]}",
        f"eta: {material.eta:g} (polished, as the measurement takes it), g: {material.g:g}",
        *(f"note: {remark}" for remark in material.remarks),
    ]


def closure_residuals(bounded: Bounded) -> list[str]:
    """What remains between the closures' light, under the limits, and the measured medium's."""
    bounces = bounded.limits.bounces
    under = f"under its limit of {bounces} bounces" if bounces else "no limit of bounces is known or allowed for"
    lines = [f"residuals: {under}; R in {', '.join(CHANNELS)}: {_percents(map(total_residual, bounded.closures))}"]
    for channel, closure in zip(CHANNELS, bounded.closures, strict=True):
        length = closure.length_mm
        lines.append(
            f"residuals {channel}: R_d(r) at {_list(RADII)} x {length:.3g} mm (1/σtr): "
            f"{_percents(rd_residual(closure))}"
        )
        x = np.append(DEPTHS[[2, 5, 7]], 3.0) * length
        lines.append(
            f"residuals {channel}: shadow {_list(x / length)} x {length:.3g} mm from its edge: "
            f"{_percents(closure.light.beyond(x) / closure.measured.beyond(x) - 1)}; lit side: "
            f"{_percents(closure.light.edge(-x) / closure.measured.edge(-x) - 1)}"
        )
    return lines


def depth_residuals(material: ExportMaterial, depth: int) -> list[str]:
    """What a volume renderer loses after `depth` scatterings."""
    lost = [-lost_share(medium, depth) for medium in material.media]
    return [
        f"residuals: paths end after {depth} bounces; R in {', '.join(CHANNELS)}: {_percents(lost)}",
        "residuals: R_d(r) is that of the medium but for this light, which would come out far from where it entered",
    ]


def total_residual(closure: Closure) -> float:
    """Relative error of R."""
    return closure.light.total / closure.measured.total - 1


def rd_residual(closure: Closure) -> np.ndarray:
    """Relative error of R_d at RADII."""
    r = RADII * closure.length_mm
    return np.asarray(closure.light.rd(r) / closure.measured.rd(r) - 1)


def _percents(values: object) -> str:
    return " ".join(f"{100 * value:+.1f}" for value in values) + " %"  # type: ignore[attr-defined]


def _list(values: object) -> str:
    return ", ".join(f"{value:g}" for value in values)  # type: ignore[attr-defined]
