"""USD: an OpenPBR material with metersPerUnit, the one format here that carries its unit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bssrdf.errors import InputError
from bssrdf.export.material import CAMERA, ExportMaterial
from bssrdf.export.openpbr import openpbr_inputs
from bssrdf.export.solved import Setting
from bssrdf.export.text import one_line
from bssrdf.export.unit import MM

SHADER = "ND_open_pbr_surface_surfaceshader"
_SPACES = {"lin_rec709": "lin_rec709_scene", "acescg": "lin_ap1_scene"}


def usd_text(materials: Sequence[ExportMaterial], setting: Setting) -> str:
    """A stage of materials as USDA; InputError where OpenUSD is missing."""
    try:
        from pxr import Usd, UsdGeom
    except ImportError as error:
        raise InputError('OpenUSD is not installed: pip install "bssrdf[export]"') from error
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, MM[setting.unit] / 1000)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(stage.DefinePrim("/Materials", "Scope"))
    for material in materials:
        _add(stage, material, setting)
    return str(stage.ExportToString())


def _add(stage: Any, material: ExportMaterial, setting: Setting) -> None:
    from pxr import Gf, Sdf, Tf, UsdShade

    said, inputs = openpbr_inputs(material, setting)
    name = Tf.MakeValidIdentifier(material.name)
    while stage.GetPrimAtPath(f"/Materials/{name}"):
        name += "_"
    made = UsdShade.Material.Define(stage, f"/Materials/{name}")
    made.GetPrim().SetDisplayName(one_line(material.name))
    made.GetPrim().SetDocumentation("\n".join(map(one_line, said)))
    shader = UsdShade.Shader.Define(stage, f"/Materials/{name}/Surface")
    shader.CreateIdAttr(SHADER)
    for key, value in inputs.items():
        if isinstance(value, list):
            attribute = shader.CreateInput(key, Sdf.ValueTypeNames.Color3f)
            attribute.Set(Gf.Vec3f(*value))
            if material.space != CAMERA:
                attribute.GetAttr().SetColorSpace(_SPACES[material.space])
        else:
            shader.CreateInput(key, Sdf.ValueTypeNames.Float).Set(value)
    shader.CreateOutput("out", Sdf.ValueTypeNames.Token)
    made.CreateSurfaceOutput("mtlx").ConnectToSource(shader.ConnectableAPI(), "out")
