"""Which model a scene is rendered by, and what speaks against one."""

from __future__ import annotations

import math
from typing import NamedTuple

from bssrdf.render.material import RenderMaterial
from bssrdf.render.plugins import Model
from bssrdf.render.scenes.record import Body, Scene
from bssrdf.transport import dipole, scoped_x64
from bssrdf.transport.dipole import Medium

LEAST_ALBEDO = 0.6
"""α′ below which diffusion does not hold."""
WIDE = 2.0
"""How many spreads a body must measure for a dipole on a plane to hold on it: marble balls come out 13 % too dark at
one, 5 % at three (`bssrdf bench render`)."""
_HELD = 0.9

RULE = f"""--model auto takes, for the body of the scene that is worst off, the cheapest that holds:
  mc      where α′ of the brightest channel is below {LEAST_ALBEDO:g}: diffusion does not hold
  brdf    else, where light spreads less than a pixel's width
  mc      else, where the body is less than {WIDE:g} times as large as light spreads: too thin or too tightly curved
  bssrdf  else
Light spreads by the diffuse mean free path 1/σtr, or by the radius that holds {100 * _HELD:g} % of R_d where that is
less, as it is almost without absorption. A body is as large as three times its volume over its surface: the radius of
a ball. Where mc cannot render a scene (a narrow light on a polished body, textured coefficients), bssrdf stands in."""


class Choice(NamedTuple):
    """The model for a scene, and why."""

    model: Model
    reason: str


def choose_model(scene: Scene) -> Choice:
    """The model after RULE."""
    choices = [_choose_for(name, body, scene.camera.footprint_mm) for name, body in scene.bodies.items()]
    worst = max(choices, key=lambda choice: ("brdf", "bssrdf", "mc").index(choice.model))
    refusal = mc_refusal(scene)
    return Choice("bssrdf", f"{worst.reason}; but {refusal}") if worst.model == "mc" and refusal else worst


def _choose_for(name: str, body: Body, footprint_mm: float) -> Choice:
    material = body.material
    albedo = material.albedo[brightest(material)]
    if albedo < LEAST_ALBEDO:
        return Choice("mc", f"{name}: α′ {albedo:.2f} is below {LEAST_ALBEDO:g}")
    widest = max(spread_mm(material))
    if widest < footprint_mm:
        return Choice("brdf", f"{name}: light spreads {widest:.2g} mm, less than a pixel's {footprint_mm:.2g} mm")
    if body.size_mm < WIDE * widest:
        return Choice("mc", f"{name}: {body.size_mm:.3g} mm large, below {WIDE:g} × the {widest:.2g} mm light spreads")
    return Choice("bssrdf", f"{name}: {body.size_mm:.3g} mm large, light spreads {widest:.2g} mm")


@scoped_x64
def brightest(material: RenderMaterial) -> int:
    """The channel that reflects most."""
    totals = [float(dipole.total_r(medium)) for medium in _media(material)]
    return totals.index(max(totals))


@scoped_x64
def spread_mm(material: RenderMaterial) -> tuple[float, ...]:
    """How far light spreads under the surface, by channel."""
    return tuple(
        min(reach, _holding_radius(medium))
        for reach, medium in zip(material.diffuse_mean_free_path, _media(material), strict=True)
    )


def _media(material: RenderMaterial) -> list[Medium]:
    return [Medium(a, sp, material.eta) for a, sp in zip(material.sigma_a, material.sigma_sp, strict=True)]


def _holding_radius(medium: Medium) -> float:
    """The radius within which _HELD of R_d comes out, by bisection in its logarithm."""
    beyond = (1 - _HELD) * float(dipole.total_r(medium))
    low, high = 1e-3 / float(medium.sigma_tp), 1e4 / float(medium.sigma_tp)
    for _ in range(30):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if float(dipole.tail(medium, middle)) > beyond else (low, middle)
    return high


def remarks(scene: Scene) -> list[str]:
    """Warnings: coefficients that cannot be in 1/mm for bodies of this size."""
    return [
        f"{name}: in {body.material.name} light spreads {max(spread_mm(body.material)):.3g} mm, over a mean free path "
        f"of {longest:.3g} mm, and the body is {body.size_mm:.3g} mm large: are the coefficients in 1/mm and the mesh "
        "in mm? (--height-mm scales a mesh)"
        for name, body in scene.bodies.items()
        if (longest := max(body.material.mean_free_path)) > body.size_mm
    ]


def mc_refusal(scene: Scene) -> str | None:
    """Why volpath cannot render the scene, if so."""
    if any(body.maps is not None for body in scene.bodies.values()):
        return "mc takes no coefficients that vary over a surface"
    if scene.narrow_light and any(body.roughness == 0 and body.material.eta != 1 for body in scene.bodies.values()):
        return "mc does not find a narrow light through a polished surface"
    return None
