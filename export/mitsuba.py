"""Mitsuba 3: the medium in a smooth dielectric, as XML or as a dict; or the surface of our own integrator."""

from __future__ import annotations

import math
import pprint
from collections.abc import Sequence
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

from scipy.optimize import brentq

from bssrdf.export.loss import depth_for
from bssrdf.export.material import ExportMaterial
from bssrdf.export.solved import Setting, depth_residuals, head
from bssrdf.export.spread import WalkMedium
from bssrdf.export.text import comment, identifier, xml_comment
from bssrdf.export.unit import coefficients, rounded
from bssrdf.transport import CHANNELS, decay_constant

LOST = 0.003
"""Share of R that a file may lose by ending paths."""
MOST_DEPTH = 32768
"""Twice as deep costs 1.4 times as long: white media never end."""
_USE_VOLUME = (
    "Use: give a closed shape the surface as its bsdf and the medium as its interior, in an rgb variant;",
    "and volpathmis for the integrator, as it stands here: its defaults lose most of the light.",
)
_USE_OURS = (
    "Use: import mitsuba, set llvm_ad_rgb or cuda_ad_rgb, then `from bssrdf.render.integrator import register` and",
    "register(): they make the surface and the integrator known.",
)


class PluginPart(NamedTuple):
    """What one material needs: plugins by name, and what is said of them."""

    said: list[str]
    plugins: dict[str, dict[str, Any]]
    integrator: dict[str, Any]


def mitsuba_xml(materials: Sequence[ExportMaterial], setting: Setting) -> str:
    """A scene with plugins alone, to be included by another."""
    parts = [_part(material, setting) for material in materials]
    lines = ['<?xml version="1.0" encoding="utf-8"?>', *(xml_comment(line) for line in _said(parts, setting))]
    lines += ['<scene version="3.0.0">']
    for part in parts:
        for name, plugin in part.plugins.items():
            lines += _xml(plugin, {"id": name}, "  ")
    lines += _xml(_deepest(parts), {}, "  ")
    return "\n".join([*lines, "</scene>", ""])


def mitsuba_dict(materials: Sequence[ExportMaterial], setting: Setting) -> str:
    """A Python module that defines PLUGINS and INTEGRATOR for `mitsuba.load_dict`."""
    parts = [_part(material, setting) for material in materials]
    plugins = {name: plugin for part in parts for name, plugin in part.plugins.items()}
    said = "\n".join(comment("#", line) for line in _said(parts, setting))
    return (
        f"{said}\n\nPLUGINS = {pprint.pformat(plugins, sort_dicts=False, width=100)}\n"
        f"INTEGRATOR = {pprint.pformat(_deepest(parts), sort_dicts=False)}\n"
    )


def _said(parts: Sequence[PluginPart], setting: Setting) -> list[str]:
    use = _USE_VOLUME if setting.keep == "medium" else _USE_OURS
    return [line for part in parts for line in part.said] + list(use)


def _deepest(parts: Sequence[PluginPart]) -> dict[str, Any]:
    return max((part.integrator for part in parts), key=lambda integrator: integrator.get("max_depth", 0))


def _part(material: ExportMaterial, setting: Setting) -> PluginPart:
    return _volume(material, setting) if setting.keep == "medium" else _ours(material, setting)


def _volume(material: ExportMaterial, setting: Setting) -> PluginPart:
    name, depth = identifier(material.name), depth_for(material.media, LOST, MOST_DEPTH)
    sigma_t = coefficients(tuple(m.sigma_s + m.sigma_a for m in material.media), setting.unit)
    scale = max(sigma_t)
    medium = {
        "type": "homogeneous",
        "sigma_t": rgb(rounded(value / scale) for value in sigma_t),  # above 1 Mitsuba takes no colour
        "scale": scale,
        "albedo": rgb(rounded(m.sigma_s / (m.sigma_s + m.sigma_a)) for m in material.media),
        "phase": {"type": "hg", "g": material.g},
    }
    surface = {"type": "dielectric", "int_ior": material.eta, "ext_ior": 1.0}
    integrator = {"type": "volpathmis", "max_depth": depth, "rr_depth": depth + 1}
    said = head(material, setting) + depth_residuals(material, depth)
    return PluginPart(said, {f"{name}-surface": surface, f"{name}-medium": medium}, integrator)


def _ours(material: ExportMaterial, setting: Setting) -> PluginPart:
    matched = [dipole_like(medium) for medium in material.media]
    surface = {
        "type": "bssrdf_medium",
        "sigma_a": rgb(coefficients(tuple(m.sigma_a for m in matched), setting.unit)),
        "sigma_sp": rgb(coefficients(tuple(m.sigma_sp for m in matched), setting.unit)),
        "eta": material.eta,
        "g": material.g,
    }
    said = head(material, setting)
    said += [
        "these are the coefficients whose dipole and single scattering have the measured R and decay, not the medium's",
        f"residuals: R in {', '.join(CHANNELS)}: +0.0 +0.0 +0.0 %; R_d(r): the dipole's, far off near the light",
    ]
    return PluginPart(said, {f"{identifier(material.name)}-surface": surface}, {"type": "bssrdf"})


def dipole_like(medium: WalkMedium) -> WalkMedium:
    """The medium whose dipole and single scattering add up to the measured R and fall as the measured light far out."""
    from bssrdf.transport import first_order_total, scoped_x64
    from bssrdf.transport.dipole import Medium as DipoleMedium
    from bssrdf.transport.dipole import total_r

    albedo = medium.sigma_s / (medium.sigma_s + medium.sigma_a)
    kappa = decay_constant(albedo, medium.g) * (medium.sigma_s + medium.sigma_a)

    @scoped_x64
    def sum_of_terms(absorbed: float) -> float:
        """R of a medium of σt′ = 1 and σa = `absorbed`."""
        diffuse = float(total_r(DipoleMedium(absorbed, 1 - absorbed, medium.eta)))
        return diffuse + float(first_order_total((1 - absorbed) / (1 - medium.g), absorbed, medium.g, medium.eta))

    def off(log_absorbed: float) -> float:
        return sum_of_terms(math.exp(log_absorbed)) - medium.total

    if off(math.log(1e-9)) <= 0:
        return medium
    absorbed = math.exp(brentq(off, math.log(1e-9), math.log(1 - 1e-6), xtol=1e-10))
    sigma_tp = kappa / math.sqrt(3 * absorbed)
    return WalkMedium(absorbed * sigma_tp, (1 - absorbed) * sigma_tp, medium.eta, medium.g)


def rgb(values: Any) -> dict[str, Any]:
    """A colour."""
    return {"type": "rgb", "value": [float(value) for value in values]}


def _xml(plugin: dict[str, Any], attributes: dict[str, str], indent: str) -> list[str]:
    """A plugin and what it holds, one element a line."""
    kind = {"homogeneous": "medium", "hg": "phase", "volpathmis": "integrator", "bssrdf": "integrator"}
    tag = kind.get(plugin["type"], "bsdf")
    named = "".join(f" {key}={quoteattr(value)}" for key, value in attributes.items())
    lines = [f"{indent}<{tag} type={quoteattr(plugin['type'])}{named}>"]
    for name, value in plugin.items():
        if name == "type":
            continue
        if isinstance(value, dict) and value["type"] == "rgb":
            numbers = ", ".join(map(repr, value["value"]))
            lines.append(f'{indent}  <rgb name={quoteattr(name)} value="{numbers}"/>')
        elif isinstance(value, dict):
            lines += _xml(value, {}, indent + "  ")
        else:
            element = "integer" if isinstance(value, int) else "float"
            lines.append(f'{indent}  <{element} name={quoteattr(name)} value="{value!r}"/>')
    return [*lines, f"{indent}</{tag}>"]
