"""OpenPBR: what its subsurface says of a material, and a MaterialX document of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bssrdf.errors import InputError
from bssrdf.export.closure import Limits
from bssrdf.export.inversions import van_de_hulst
from bssrdf.export.material import CAMERA, ExportMaterial
from bssrdf.export.solved import Setting, closure_residuals, closures, head
from bssrdf.export.text import one_line
from bssrdf.export.unit import lengths, rounded

NO_LIMIT = Limits()
_UNKNOWN = (
    "these numbers hold where colour becomes albedo by van de Hulst's inversion, as the specification suggests, and no "
    "light is reflected inside; a renderer that makes subsurface_color the reflectance itself wants the measured R"
)


def openpbr_inputs(material: ExportMaterial, setting: Setting) -> tuple[list[str], dict[str, Any]]:
    """What is said, and the inputs of `open_pbr_surface` by name: floats, and colours as lists."""
    bounded = closures(material, NO_LIMIT)
    walks = [closure.first for closure in bounded.closures]
    mfp = lengths(tuple(walk.mfp_mm for walk in walks), setting.unit)
    radius = max(mfp)
    totals = " ".join(f"{medium.total:.4f}" for medium in material.media)
    said = [*head(material, setting), *closure_residuals(bounded), f"note: {_UNKNOWN}: {totals}"]
    colour = [rounded(van_de_hulst(walk.albedo)) for walk in walks]
    return said, {
        "base_color": colour,
        "base_metalness": 0.0,
        "specular_ior": material.eta,
        "specular_roughness": 0.0,
        "subsurface_weight": 1.0,
        "subsurface_color": colour,
        "subsurface_radius": radius,
        "subsurface_radius_scale": [rounded(value / radius) for value in mfp],
        "subsurface_scatter_anisotropy": 0.0,
    }


def openpbr_text(materials: Sequence[ExportMaterial], setting: Setting) -> str:
    """A MaterialX document, validated by MaterialX; InputError where its package is missing."""
    try:
        import MaterialX as mx
    except ImportError as error:
        raise InputError('MaterialX is not installed: pip install "bssrdf[export]"') from error
    document = mx.createDocument()
    document.setAttribute("unit", setting.unit)
    spaces = {material.space for material in materials}
    if spaces != {CAMERA}:
        document.setColorSpace(spaces.pop())
    for material in materials:
        _add(mx, document, material, setting)
    valid, message = document.validate()
    if not valid:
        raise InputError(f"MaterialX refuses the document: {one_line(message)}")
    return str(mx.writeToXmlString(document))


def _add(mx: Any, document: Any, material: ExportMaterial, setting: Setting) -> None:
    said, inputs = openpbr_inputs(material, setting)
    name = document.createValidChildName(mx.createValidName(material.name) or "material")
    node = document.addNode("open_pbr_surface", f"{name}_surface", "surfaceshader")
    node.setDocString("\n".join(map(one_line, said)))
    for key, value in inputs.items():
        if isinstance(value, list):
            node.setInputValue(key, mx.Color3(*value), "color3")
        else:
            node.setInputValue(key, value, "float")
    made = document.addMaterialNode(name, node)
    made.setAttribute("uiname", one_line(material.name))
