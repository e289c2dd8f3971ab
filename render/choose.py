"""Which model a scene is rendered by, how the light under its surfaces is found, and what speaks against either."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bssrdf.render.kernel import Floats, kernels, radii
from bssrdf.render.material import RenderMaterial
from bssrdf.render.plugins import Model
from bssrdf.render.points.record import Method
from bssrdf.render.scenes.record import Scene
from bssrdf.render.surface_nets import body_size
from bssrdf.transport import nearest

WIDE = 10.0
"""How many spreads a body must measure for R_d of a half space to stand for it under light that varies over it…"""
DEEP = 200.0
"""…and how many mean free paths 1/σt′ under even light: a ball of so many comes out 1 % too dark. Against walks
in balls of 10 and 30 spreads, marble and skin1, points miss 1.4 to 2.4 mean free paths over the radius."""
_HELD = 0.9
HOUSE_MM = 2000.0
"""No translucent thing that people look at whole is larger; a mesh in µm is."""

RULE = f"""--model auto takes brdf where light spreads less than a pixel's width in every body, else bssrdf.
--method auto finds the light under surfaces by
  points  where every body is at least {WIDE:g} times as large as light spreads and {DEEP:g} mean free paths, or under a
          beam narrower than light spreads: R_d of a half space, over all points where light entered
  walks   else: the same, and walks inside the body that tell what its form changes
Light spreads by the diffuse mean free path 1/σtr, or by the radius that holds {100 * _HELD:g} % of R_d where that is
less, as it is almost without absorption. A body is as large as three times its volume over its surface: the radius of
a ball. mc, full Monte Carlo, is a reference: it takes hours to lose its noise."""


def choose_model(scene: Scene) -> tuple[Model, str]:
    """The model after RULE, and why."""
    footprint = scene.camera.footprint_mm
    spreads = {name: max(spread_mm(body.material)) for name, body in scene.bodies.items()}
    name, widest = max(spreads.items(), key=lambda pair: pair[1])
    said = f"light spreads {widest:.2g} mm in {name}, a pixel is {footprint:.2g} mm wide"
    return ("brdf" if widest < footprint else "bssrdf"), said


def choose_method(scene: Any) -> tuple[Method, str]:
    """The method after RULE for a scene that Mitsuba has loaded, and why."""
    from bssrdf.render.medium import Media
    from bssrdf.render.points.fineness import spots_on
    from bssrdf.render.points.spread import is_closed, surface_of
    from bssrdf.render.surface import mean_coefficients

    tightest, said = math.inf, "no closed body"
    for shape in Media(scene).shapes:
        name = shape.id() or "body"
        if any(radius < _widest_spread(shape.bsdf().surface) for _, radius in spots_on(scene, shape.bsdf())):
            return "points", f"{name}: under a narrow beam, which walks hardly find"
        surface, spread = surface_of(shape), _widest_spread(shape.bsdf().surface)
        size = body_size(surface.vertices, surface.faces) if is_closed(surface) else math.inf
        path = float(1 / mean_coefficients(shape.bsdf().surface).sum(axis=0).min())
        if (room := min(size / spread / WIDE, size / path / DEEP)) < tightest:
            tightest = room
            said = f"{name}: {size:.3g} large, light spreads {spread:.3g}, its mean free path is {path:.3g}"
    return ("points" if tightest >= 1 else "walks"), said


def _widest_spread(surface: Any) -> float:
    from bssrdf.render.surface import mean_coefficients

    sigma_a, sigma_sp = mean_coefficients(surface)
    return max(_spreads(sigma_a, sigma_sp, surface.eta, surface.g))


def spread_mm(material: RenderMaterial) -> tuple[float, ...]:
    """How far light spreads under the surface, by channel."""
    return _spreads(np.array(material.sigma_a), np.array(material.sigma_sp), material.eta, material.g)


def _spreads(sigma_a: Floats, sigma_sp: Floats, eta: float, g: float) -> tuple[float, ...]:
    """1/σtr, or where that is less the radius within which _HELD of R_d comes out, by channel."""
    sigma_tp = sigma_a + sigma_sp
    albedo = sigma_sp / sigma_tp
    at_hand = nearest(eta, g)
    table = kernels(at_hand.eta, at_hand.g, np.unique(albedo))
    rows = np.searchsorted(table.albedo, albedo)
    held = [np.interp(_HELD * table.total[row] / (2 * math.pi), table.inside[row, :, 0], radii()) for row in rows]
    with np.errstate(divide="ignore"):
        falls = 1 / np.sqrt(3 * sigma_a * sigma_tp)
    return tuple(np.minimum(falls, held / sigma_tp).tolist())


def remarks(scene: Scene) -> list[str]:
    """Warnings: coefficients that cannot be in 1/mm for bodies of this size, and bodies as large as houses."""
    small = [
        f"{name}: in {body.material.name} light spreads {max(spread_mm(body.material)):.3g} mm, over a mean free path "
        f"of {longest:.3g} mm, and the body is {body.size_mm:.3g} mm large: are the coefficients in 1/mm and the mesh "
        "in mm? (--height-mm scales a mesh)"
        for name, body in scene.bodies.items()
        if (longest := max(body.material.mean_free_path)) > body.size_mm
    ]
    large = [
        f"{name} is {body.size_mm / 1000:.3g} m large: is the mesh in mm? (--height-mm scales a mesh)"
        for name, body in scene.bodies.items()
        if body.size_mm > HOUSE_MM
    ]
    return small + large


def mc_refusal(scene: Scene) -> str | None:
    """Why volpath cannot render the scene, if so."""
    if any(body.maps is not None for body in scene.bodies.values()):
        return "mc takes no coefficients that vary over a surface"
    if scene.narrow_light and any(body.roughness == 0 and body.material.eta != 1 for body in scene.bodies.values()):
        return "mc does not find a narrow light through a polished surface"
    return None


def mc_remarks(scene: Scene) -> list[str]:
    """Warnings: Mitsuba's rough boundary forgets light that a microfacet sends on to the next one.

    In an even sky a white ball (η 1.4) of roughness 0.1, 0.2, 0.3 returns 0.93, 0.83, 0.74 by mc, 1.00 by walks.
    """
    return [
        f"{name}: mc loses light at a rough boundary, of a white body 7 % at roughness 0.1 and 26 % at 0.3; "
        "--roughness 0 makes it a reference"
        for name, body in scene.bodies.items()
        if body.roughness > 0 and body.material.eta != 1
    ]
