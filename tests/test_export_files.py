"""Exported files say what was asked, in every unit, whatever the material's name, in the words of their renderers."""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from bssrdf.export.blender import LIMITS, blender_text
from bssrdf.export.closure import Limits, solve
from bssrdf.export.inversions import van_de_hulst
from bssrdf.export.material import ExportMaterial, find_materials
from bssrdf.export.mitsuba import dipole_like, mitsuba_dict, mitsuba_xml
from bssrdf.export.openpbr import openpbr_text
from bssrdf.export.pbrt import pbrt_text
from bssrdf.export.solved import Setting
from bssrdf.export.unit import MM, UNITS, Unit
from bssrdf.export.usd import usd_text

HARD_NAMES = (
    'say "cheese"',
    "it's \\ back",
    "two\nlines",
    "</script><!-- -- -->",
    "'''\"\"\"",
    "Мрамор 大理石 ½",
    "a.b/c: d",
    "\x00\x1b[31m",
    "--",
)
MARBLE = find_materials("Marble")[0]
SKIN = replace(find_materials("Skin1")[0], g=0.8)


def medium_setting(unit: Unit) -> Setting:
    return Setting("it", "medium", unit)


def appearance(unit: Unit) -> Setting:
    return Setting("it", "appearance", unit)


def assigned(text: str) -> dict[str, Any]:
    return {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }


def pbrt_statements(text: str) -> list[tuple[str, str, dict[str, Any]]]:
    """(directive, name, parameters by name) of a pbrt text of named things."""
    bare = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    tokens = [
        re.sub(r"\\(.)", r"\1", token[1:-1]) if token.startswith('"') else token
        for token in re.findall(r'"(?:\\.|[^"\\])*"|\[|\]|[^\s\[\]"]+', bare)
    ]
    found: list[tuple[str, str, dict[str, Any]]] = []
    i = 0
    while i < len(tokens):
        if tokens[i] in ("MakeNamedMedium", "MakeNamedMaterial"):
            found.append((tokens[i], tokens[i + 1], {}))
            i += 2
            continue
        kind, name = tokens[i].split()
        if tokens[i + 1] == "[":
            end = tokens.index("]", i)
            value: Any = [float(number) for number in tokens[i + 2 : end]]
            i = end + 1
        else:
            value = tokens[i + 1] if kind == "string" else float(tokens[i + 1])
            i += 2
        found[-1][2][name] = value
    return found


def xml_plugins(text: str) -> dict[str, ElementTree.Element]:
    root = ElementTree.fromstring(text.encode())
    return {element.get("id") or element.tag: element for element in root}


def colour_of(element: ElementTree.Element, name: str) -> np.ndarray:
    (found,) = (child for child in element if child.get("name") == name)
    return np.array([float(number) for number in str(found.get("value")).split(",")])


def sigma_s(material: ExportMaterial) -> np.ndarray:
    return np.array([medium.sigma_s for medium in material.media])


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("material", [MARBLE, SKIN], ids=["marble", "forward"])
def test_blender_volume_holds_the_coefficients(material: ExportMaterial, unit: Unit) -> None:
    held = assigned(blender_text([material], medium_setting(unit)))
    (numbers,) = held["MATERIALS"]
    np.testing.assert_allclose(numbers["sigma_a"], np.array(material.sigma_a) * MM[unit], rtol=1e-8)
    np.testing.assert_allclose(numbers["sigma_s"], sigma_s(material) * MM[unit], rtol=1e-8)
    assert (numbers["g"], numbers["eta"]) == (material.g, material.eta)
    assert pytest.approx(MM[unit] / 1000) == held["UNIT_M"]


@pytest.mark.parametrize("unit", UNITS)
def test_blender_surface_holds_the_walks_by_both_rules(unit: Unit) -> None:
    (numbers,) = assigned(blender_text([MARBLE], appearance(unit)))["MATERIALS"]
    walks = [solve(medium, LIMITS).first for medium in MARBLE.media]
    new, old = numbers["rules"]["5.2"], numbers["rules"]["5.1"]
    np.testing.assert_allclose(new["radius"], [walk.mfp_mm / MM[unit] for walk in walks], rtol=1e-8)
    np.testing.assert_allclose(old["radius"], 4 * np.pi * np.array(new["radius"]), rtol=1e-8)
    np.testing.assert_allclose(new["colour"], [van_de_hulst(walk.albedo) for walk in walks], rtol=1e-8)


@pytest.mark.parametrize(
    ("version", "rules"), [((5, 2), {"5.2"}), ((5, 3), {"5.2"}), ((5, 1), {"5.1"}), (None, {"5.2", "5.1"})]
)
def test_blender_file_holds_the_rule_of_the_version(version: tuple[int, int] | None, rules: set[str]) -> None:
    (numbers,) = assigned(blender_text([MARBLE], appearance("m"), version))["MATERIALS"]
    assert set(numbers["rules"]) == rules


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("material", [MARBLE, SKIN], ids=["marble", "forward"])
def test_mitsuba_medium_multiplies_out_to_the_coefficients(material: ExportMaterial, unit: Unit) -> None:
    plugins = xml_plugins(mitsuba_xml([material], medium_setting(unit)))
    medium, surface = plugins[f"{material.name}-medium"], plugins[f"{material.name}-surface"]
    sigma_t = colour_of(medium, "sigma_t")
    assert sigma_t.max() <= 1, "Mitsuba refuses a colour above 1"
    sigma_t = sigma_t * colour_of(medium, "scale")
    np.testing.assert_allclose(sigma_t, (np.array(material.sigma_a) + sigma_s(material)) * MM[unit], rtol=1e-7)
    np.testing.assert_allclose(colour_of(medium, "albedo") * sigma_t, sigma_s(material) * MM[unit], rtol=1e-7)
    assert colour_of(medium.find("phase"), "g")[0] == material.g  # type: ignore[arg-type]
    assert colour_of(surface, "int_ior")[0] == material.eta
    depth, roulette = (colour_of(plugins["integrator"], name)[0] for name in ("max_depth", "rr_depth"))
    assert roulette > depth >= 1000
    held = assigned(mitsuba_dict([material], medium_setting(unit)))
    assert held["PLUGINS"][f"{material.name}-medium"]["sigma_t"]["value"] == list(colour_of(medium, "sigma_t"))
    assert held["INTEGRATOR"]["max_depth"] == depth


@pytest.mark.parametrize("unit", UNITS)
def test_mitsuba_surface_of_ours_holds_the_dipoles_coefficients(unit: Unit) -> None:
    surface = xml_plugins(mitsuba_xml([MARBLE], appearance(unit)))["Marble-surface"]
    expected = [dipole_like(medium) for medium in MARBLE.media]
    np.testing.assert_allclose(colour_of(surface, "sigma_a"), [m.sigma_a * MM[unit] for m in expected], rtol=1e-7)
    np.testing.assert_allclose(colour_of(surface, "sigma_sp"), [m.sigma_sp * MM[unit] for m in expected], rtol=1e-7)


@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize("name", HARD_NAMES)
def test_mitsuba_loads_what_was_written(name: str, tmp_path: Path) -> None:
    import mitsuba as mi

    material = replace(MARBLE, name=name)
    mi.load_string(mitsuba_xml([material], medium_setting("mm")))
    for key, plugin in assigned(mitsuba_dict([material], medium_setting("mm")))["PLUGINS"].items():
        assert mi.load_dict({"type": "scene", key: plugin} if plugin["type"] == "dielectric" else plugin)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("material", [MARBLE, SKIN], ids=["marble", "forward"])
def test_pbrt_medium_holds_the_coefficients(material: ExportMaterial, unit: Unit) -> None:
    medium, surface = pbrt_statements(pbrt_text([material], medium_setting(unit)))
    np.testing.assert_allclose(medium[2]["sigma_a"], np.array(material.sigma_a) * MM[unit], rtol=1e-8)
    np.testing.assert_allclose(medium[2]["sigma_s"], sigma_s(material) * MM[unit], rtol=1e-8)
    assert (medium[2]["g"], medium[2]["scale"], surface[2]["eta"]) == (material.g, 1, material.eta)
    assert (medium[2]["type"], surface[2]["type"]) == ("homogeneous", "dielectric")


@pytest.mark.parametrize("unit", UNITS)
def test_pbrt_surface_holds_reflectance_mean_free_path_and_eta(unit: Unit) -> None:
    ((_, _, held),) = pbrt_statements(pbrt_text([MARBLE], appearance(unit)))
    np.testing.assert_allclose(held["reflectance"], [medium.total for medium in MARBLE.media], rtol=1e-8)
    np.testing.assert_allclose(held["mfp"], [1 / medium.sigma_tp / MM[unit] for medium in MARBLE.media], rtol=1e-8)
    assert held["eta"] == 1.5, "pbrt takes 1.33 where it is not said"


@pytest.mark.parametrize("unit", UNITS)
def test_materialx_document_is_valid_and_holds_the_walks(unit: Unit) -> None:
    mx = pytest.importorskip("MaterialX")
    document = mx.createDocument()
    mx.readFromXmlString(document, openpbr_text([MARBLE], appearance(unit)))
    assert document.validate()[0]
    assert document.getAttribute("unit") == unit
    node = document.getNode("Marble_surface")
    scale = np.array(list(node.getInputValue("subsurface_radius_scale")))
    walks = [solve(medium, Limits()).first for medium in MARBLE.media]
    assert scale.max() == 1
    mfp = scale * node.getInputValue("subsurface_radius") * MM[unit]
    np.testing.assert_allclose(mfp, [walk.mfp_mm for walk in walks], rtol=2e-6)
    colours = list(node.getInputValue("subsurface_color"))
    np.testing.assert_allclose(colours, [van_de_hulst(walk.albedo) for walk in walks], rtol=2e-6)
    assert node.getInputValue("specular_ior") == pytest.approx(1.5)


@pytest.mark.parametrize("unit", UNITS)
def test_usd_stage_carries_its_unit_and_the_walks(unit: Unit, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdShade

    (tmp_path / "it.usda").write_text(usd_text([MARBLE], appearance(unit)), encoding="utf-8")
    stage = Usd.Stage.Open(str(tmp_path / "it.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == pytest.approx(MM[unit] / 1000)
    material = UsdShade.Material(stage.GetPrimAtPath("/Materials/Marble"))
    shader, _, _ = material.ComputeSurfaceSource("mtlx")
    assert shader.GetIdAttr().Get() == "ND_open_pbr_surface_surfaceshader"
    radius = shader.GetInput("subsurface_radius").Get() * np.array(shader.GetInput("subsurface_radius_scale").Get())
    walks = [solve(medium, Limits()).first for medium in MARBLE.media]
    np.testing.assert_allclose(radius * MM[unit], [walk.mfp_mm for walk in walks], rtol=1e-6)


def test_colour_space_is_written_where_a_format_has_a_place_for_it() -> None:
    pytest.importorskip("MaterialX")
    pytest.importorskip("pxr")
    aces = replace(MARBLE, space="acescg")
    assert 'colorspace="acescg"' in openpbr_text([aces], appearance("mm"))
    assert 'colorSpace = "lin_ap1_scene"' in usd_text([aces], appearance("mm"))
    for text in (blender_text([aces], appearance("mm")), pbrt_text([aces], medium_setting("mm"))):
        assert "# colour space: ACEScg" in text


@pytest.mark.parametrize("name", HARD_NAMES)
def test_no_name_breaks_out_of_its_place(name: str) -> None:
    material = replace(MARBLE, name=name, source=name, remarks=(name,))
    (numbers,) = assigned(blender_text([material], medium_setting("mm")))["MATERIALS"]
    assert numbers["name"] == name
    assert len(xml_plugins(mitsuba_xml([material], medium_setting("mm")))) == 3
    assert len(assigned(mitsuba_dict([material], medium_setting("mm")))["PLUGINS"]) == 2
    medium, surface = pbrt_statements(pbrt_text([material], medium_setting("mm")))
    assert medium[1] == surface[1] == re.sub(r"[\x00-\x1f]", " ", name)


@pytest.mark.parametrize("name", HARD_NAMES)
def test_no_name_breaks_a_document(name: str) -> None:
    mx = pytest.importorskip("MaterialX")
    pytest.importorskip("pxr")
    from pxr import Usd

    material = replace(MARBLE, name=name, source=name, remarks=(name,))
    document = mx.createDocument()
    mx.readFromXmlString(document, openpbr_text([material], appearance("mm")))
    assert document.validate()[0]
    stage = Usd.Stage.CreateInMemory()
    assert stage.GetRootLayer().ImportFromString(usd_text([material], appearance("mm")))
    (made,) = (prim for prim in stage.Traverse() if prim.GetTypeName() == "Material")
    assert made.GetDisplayName() == re.sub(r"[\x00-\x1f]", " ", name)


def test_a_library_holds_all_its_materials() -> None:
    several: Sequence[ExportMaterial] = [find_materials(name)[0] for name in ("Marble", "Skin1", "Ketchup")]
    assert len(assigned(blender_text(several, medium_setting("mm")))["MATERIALS"]) == 3
    assert len(xml_plugins(mitsuba_xml(several, medium_setting("mm")))) == 7
    assert len(pbrt_statements(pbrt_text(several, medium_setting("mm")))) == 6
