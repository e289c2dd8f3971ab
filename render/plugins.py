"""A scene as Mitsuba plugins, for one of the ways to render it. Needs a variant that is set, and for the BSSRDF
integrators that are registered.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bssrdf.render.kernel import Kernel
from bssrdf.render.material import RenderMaterial
from bssrdf.render.mesh_file import mitsuba_mesh
from bssrdf.render.points.record import LightPlan, Method
from bssrdf.render.scenes.place import looking
from bssrdf.render.scenes.record import Body, Bump, Plugin, Scene, Thing, Viewpoint
from bssrdf.render.surface_nets import TriangleMesh

Model = Literal["brdf", "bssrdf", "mc"]
MODELS: tuple[Model, ...] = ("brdf", "bssrdf", "mc")
TERMS = ("diffusion", "single", "specular")
MC_DEPTH = 1000
"""Scatterings of a path in volpath: marble loses 0.4 % of its light beyond."""
SURFACE_DEPTH = 6
"""Surface events of a path for the other two, as Mitsuba's `path` counts them."""


@dataclass(frozen=True)
class RenderOptions:
    """How to render."""

    model: Model = "bssrdf"
    kernel: Kernel = "table"
    method: Method | Literal["auto"] = "auto"
    terms: tuple[str, ...] = TERMS
    paper: bool = False
    light_samples: int = LightPlan.light_samples
    walks: int = LightPlan.walks
    seed: int = 0
    """Of the light that is found before a picture is drawn."""
    mc_depth: int = MC_DEPTH


def scene_dict(scene: Scene, options: RenderOptions) -> dict[str, Any]:
    """What `mitsuba.load_dict` takes; bodies, lights and camera are named as in the scene."""
    bodies = {name: _body(body, options) for name, body in scene.bodies.items()}
    things = {name: _thing(thing) for name, thing in [*scene.furniture.items(), *scene.lights.items()]}
    return {"type": "scene", "sensor": _sensor(scene.camera), **bodies, **things}


def integrator(options: RenderOptions) -> dict[str, Any]:
    """Monte Carlo goes without Russian roulette: at high albedo it costs 570 times the variance."""
    if options.model == "mc":
        depth = options.mc_depth
        return {"type": "volpathmis", "max_depth": depth, "rr_depth": depth + 1, "hide_emitters": True}
    common: dict[str, Any] = {"kernel": options.kernel, "max_depth": SURFACE_DEPTH, "hide_emitters": True}
    if options.kernel == "dipole":
        common |= {"terms": ",".join(options.terms), "paper": options.paper}
    if options.model == "brdf":
        return {"type": "bssrdf_brdf", **common}
    names = ("method", "light_samples", "walks", "seed")
    return {"type": "bssrdf", **common, **{name: getattr(options, name) for name in names}}


def medium(material: RenderMaterial) -> dict[str, Any]:
    """A participating medium of the coefficients; normalised, since Mitsuba takes no rgb above 1."""
    sigma_t = np.add(material.sigma_a, material.sigma_s)
    top = float(sigma_t.max())
    phase = {"type": "hg", "g": material.g} if material.g else {"type": "isotropic"}
    return {
        "type": "homogeneous",
        "albedo": _rgb(np.divide(material.sigma_s, sigma_t)),
        "sigma_t": _rgb(sigma_t / top),
        "scale": top,
        "phase": phase,
        "sample_emitters": material.eta == 1,  # else no light outside is in sight from inside
    }


def _body(body: Body, options: RenderOptions) -> Any:
    if options.model != "mc":
        return _shape(body.shape, {"bsdf": _bssrdf(body)})
    ior = {"int_ior": body.material.eta, "ext_ior": 1.0}
    surface: dict[str, Any] = {"type": "dielectric", **ior}
    if body.material.eta == 1:
        surface = {"type": "null"}
    elif body.roughness:
        surface = {"type": "roughdielectric", "distribution": "ggx", "alpha": body.roughness, **ior}
    if body.bump is not None:
        surface = {"type": "bumpmap", "texture": _bump(body.bump), "bsdf": surface}
    return _shape(body.shape, {"bsdf": surface, "interior": medium(body.material)})


def _bssrdf(body: Body) -> dict[str, Any]:
    material, maps = body.material, body.maps
    surface = {
        "type": "bssrdf_medium",
        "sigma_a": _rgb(material.sigma_a) if maps is None else _bitmap(maps.sigma_a),
        "sigma_sp": _rgb(material.sigma_sp) if maps is None else _bitmap(maps.sigma_sp),
        "eta": material.eta,
        "g": material.g,
        "alpha": body.roughness,
    }
    return surface if body.bump is None else surface | {"bump": _bump(body.bump)}


def _thing(thing: Plugin | Thing) -> Any:
    return _mesh(thing.mesh, {"bsdf": _plain(thing.surface)}) if isinstance(thing, Thing) else _plain(thing)


def _shape(shape: Mapping[str, Any] | TriangleMesh, parts: dict[str, Any]) -> Any:
    if isinstance(shape, TriangleMesh):
        return _mesh(shape, parts)
    return _plain(shape) | parts


def _mesh(mesh: TriangleMesh, parts: dict[str, Any]) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    for name, part in parts.items():
        properties[name] = mi.load_dict(part)
    return mitsuba_mesh("mesh", mesh, properties)


def _sensor(camera: Viewpoint) -> dict[str, Any]:
    width, height = camera.pixels
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    where: dict[str, Any]
    if camera.width_mm is None:
        where = {"type": "perspective", "fov": camera.fov_deg}
        placed = looking(camera.origin, camera.target, camera.up)
    else:
        half = camera.width_mm / 2
        where = {"type": "orthographic"}
        placed = looking(camera.origin, camera.target, camera.up, (half, half, 1.0))
    return _plain(where | {"to_world": placed}) | {"film": film, "sampler": {"type": "multijitter"}}


def _bump(bump: Bump) -> dict[str, Any]:
    import mitsuba as mi

    u, v = bump.repeat
    return _bitmap(bump.height_mm[..., None]) | {"to_uv": mi.ScalarTransform4f(np.diag([u, v, 1.0, 1.0]))}


def _bitmap(values: np.ndarray) -> dict[str, Any]:
    import mitsuba as mi

    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(values)), "raw": True}


def _rgb(values: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(value) for value in values]}


def _plain(plugin: Mapping[str, Any]) -> dict[str, Any]:
    """The same with Mitsuba's own transforms."""
    import mitsuba as mi

    made: dict[str, Any] = {}
    for key, value in plugin.items():
        if isinstance(value, Mapping):
            made[key] = _plain(value)
        elif isinstance(value, np.ndarray):
            made[key] = mi.ScalarTransform4f(value)
        else:
            made[key] = value
    return made
