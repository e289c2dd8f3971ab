"""pbrt-v4: the medium in a smooth dielectric, or its own `subsurface` material."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from bssrdf.export.loss import depth_for
from bssrdf.export.material import ExportMaterial
from bssrdf.export.mitsuba import LOST, MOST_DEPTH
from bssrdf.export.solved import Setting, depth_residuals, head
from bssrdf.export.text import comment, quoted
from bssrdf.export.unit import coefficients, lengths, rounded


def pbrt_text(materials: Sequence[ExportMaterial], setting: Setting) -> str:
    """Named materials, and named media where the medium is kept, to be included in the world block."""
    build = _volume if setting.keep == "medium" else _subsurface
    return "\n\n".join("\n".join(build(material, setting)) for material in materials) + "\n"


def _volume(material: ExportMaterial, setting: Setting) -> list[str]:
    depth = depth_for(material.media, LOST, MOST_DEPTH)
    name = quoted(material.name)
    said = [
        *head(material, setting),
        *depth_residuals(material, depth),
        f'Use: Integrator "volpath" "integer maxdepth" {depth} before WorldBegin; on closed shapes',
        f'NamedMaterial {name} and MediumInterface {name} ""',
    ]
    return [
        *(comment("#", line) for line in said),
        f'MakeNamedMedium {name} "string type" "homogeneous"',
        f'  "rgb sigma_a" {_rgb(coefficients(material.sigma_a, setting.unit))}',
        f'  "rgb sigma_s" {_rgb(coefficients(tuple(m.sigma_s for m in material.media), setting.unit))}',
        f'  "float g" {material.g!r} "float scale" 1',
        f'MakeNamedMaterial {name} "string type" "dielectric" "float eta" {material.eta!r} "float roughness" 0',
    ]


def _subsurface(material: ExportMaterial, setting: Setting) -> list[str]:
    name = quoted(material.name)
    said = [
        *head(material, setting),
        "pbrt finds the albedo that gives the reflectance by its own photon beam diffusion; mfp is the measured 1/σt′",
        "residuals: R +0.0 % by pbrt's own table; R_d(r) is its diffusion model's and not known here",
        f"Use: NamedMaterial {name} on closed shapes",
    ]
    mfp = tuple(1 / medium.sigma_tp for medium in material.media)
    return [
        *(comment("#", line) for line in said),
        f'MakeNamedMaterial {name} "string type" "subsurface"',
        f'  "rgb reflectance" {_rgb(rounded(min(medium.total, 1.0)) for medium in material.media)}',
        f'  "rgb mfp" {_rgb(lengths(mfp, setting.unit))}',
        f'  "float scale" 1 "float g" 0 "float eta" {material.eta!r} "float roughness" 0',
    ]


def _rgb(values: Iterable[float]) -> str:
    return f"[ {' '.join(map(repr, values))} ]"
