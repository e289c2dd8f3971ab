"""A Python file that builds the material in Blender's open scene, for Cycles."""

from __future__ import annotations

import pprint
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from bssrdf.export.bounce_walk import N_ORDERS
from bssrdf.export.closure import Limits, MatchedWalk
from bssrdf.export.inversions import BLENDER, ClosureRule
from bssrdf.export.material import ExportMaterial
from bssrdf.export.solved import Bounded, Setting, closure_residuals, closures, depth_residuals, head
from bssrdf.export.text import comment
from bssrdf.export.unit import MM, Unit, coefficients, lengths, rounded

LIMITS = Limits(bounces=N_ORDERS, least_albedo=0.2, second=True)
"""Of Cycles in every version: its source, and renders by `bssrdf bench export`."""
VOLUME_BOUNCES = 1024
"""The most that Blender lets one set."""
_USE = (
    "Use: run it in Blender's Text Editor, or by `blender scene.blend --python THIS_FILE`.",
    "Objects that are selected get the material, where the file has one only. What it sets in the scene, it prints.",
)


def rules(version: tuple[int, int] | None) -> tuple[ClosureRule, ...]:
    """Those of the version, or all."""
    new, old = BLENDER
    return BLENDER if version is None else (new,) if version >= (5, 2) else (old,)


def blender_text(materials: Sequence[ExportMaterial], setting: Setting, version: tuple[int, int] | None = None) -> str:
    """The file."""
    described = [_described(material, setting, version) for material in materials]
    return file_text([said for said, _ in described], [numbers for _, numbers in described], setting)


def file_text(said: Sequence[Sequence[str]], numbers: Sequence[dict[str, Any]], setting: Setting) -> str:
    """The file of these numbers, under what is said of each."""
    script = (files(__package__) / "blender_script.py").read_text(encoding="utf-8")
    body = script.split('"""', 2)[2].lstrip()
    comments = "\n#\n".join("\n".join(comment("#", line) for line in lines) for lines in [*said, _USE])
    return (
        f"{comments}\n\nMATERIALS = {pprint.pformat(list(numbers), sort_dicts=False, width=100)}\n"
        f"UNIT_M = {MM[setting.unit] / 1000!r}\nFOLLOW_SCENE = {setting.scene_unit}\n\n\n{body}\n\n"
        "main(MATERIALS, UNIT_M, FOLLOW_SCENE)\n"
    )


def _described(
    material: ExportMaterial, setting: Setting, version: tuple[int, int] | None
) -> tuple[list[str], dict[str, Any]]:
    said = head(material, setting)
    numbers: dict[str, Any] = {"name": material.name, "kept": setting.keep, "eta": material.eta}
    if setting.keep == "medium":
        sigma_s = tuple(medium.sigma_s for medium in material.media)
        return said + depth_residuals(material, VOLUME_BOUNCES), numbers | {
            "g": material.g,
            "sigma_a": coefficients(material.sigma_a, setting.unit),
            "sigma_s": coefficients(sigma_s, setting.unit),
        }
    bounded = closures(material, LIMITS)
    by_rule = {rule.version: rule_numbers(bounded, rule, setting.unit) for rule in rules(version)}
    return said + closure_residuals(bounded), numbers | {"rules": by_rule}


def verbatim_text(materials: Sequence[ExportMaterial], setting: Setting) -> str:
    """The file with the coefficients as they are, as if no light were reflected inside: too bright, for comparison."""
    numbers = []
    for material in materials:
        by_rule = {
            rule.version: _numbers(verbatim_walks(material), (None, None, None), rule, setting.unit) for rule in BLENDER
        }
        numbers.append({"name": material.name, "kept": setting.keep, "eta": material.eta, "rules": by_rule})
    return file_text([["coefficients as they are"]] * len(numbers), numbers, setting)


def verbatim_walks(material: ExportMaterial) -> list[MatchedWalk]:
    """Random walks of the coefficients as they are."""
    return [MatchedWalk(medium.sigma_sp / medium.sigma_tp, 1 / medium.sigma_tp) for medium in material.media]


def rule_numbers(bounded: Bounded, rule: ClosureRule, unit: Unit) -> dict[str, Any]:
    """Colours and radii of the walks under one rule."""
    first = [closure.first for closure in bounded.closures]
    return _numbers(first, [closure.second for closure in bounded.closures], rule, unit)


def _numbers(
    first: Sequence[MatchedWalk], second: Sequence[MatchedWalk | None], rule: ClosureRule, unit: Unit
) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "colour": [rounded(rule.colour(walk.albedo)) for walk in first],
        "radius": lengths(tuple(rule.radius_per_mfp * walk.mfp_mm for walk in first), unit),
        "second": None,
    }
    weights = {walk.weight for walk in second if walk}
    if weights:
        (weight,) = weights
        numbers["second"] = {
            "weight": weight,
            "colour": [rounded(rule.colour(walk.albedo)) if walk else 0.0 for walk in second],
            "radius": lengths(
                tuple(rule.radius_per_mfp * (walk or one).mfp_mm for walk, one in zip(second, first, strict=True)), unit
            ),
        }
    return numbers
