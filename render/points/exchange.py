"""Light that goes from body to body: what enters one left another, which must be known first.

In a first round light that meets a body comes back as from a wide flat one. Where bodies touch, or stand so near that
they see much of each other, that is far too little, and further rounds read what the round before found to leave.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from bssrdf.render.paths import Tracer
from bssrdf.render.points.enter import Arrived
from bssrdf.render.points.record import BodySurface, Floats

_OTHERS, _ITSELF = 0.01, 0.3
"""Of what a body sees, the share that is other bodies, or itself, from which on there are further rounds with walks."""
_SOME = 0.05
"""Of what it sees that is itself, from which on there is one more round, after a quick one: the bust sees a tenth of
itself, which adds 1.9 % to marble's red and as much to skin1's; rounds until all is found cost 2.6 times as much."""
_RAYS = 1 << 13
_SETTLED = 2e-3
"""Change of the light that enters, by the last round: a third of it was still to come in white cubes that touch."""
_ROUNDS = 10
_HAIR = 2.5 * 1500 * 2.0**-24
"""Over the largest coordinate and one: twice that is farther than Mitsuba's rays start from a surface."""


class LitBody(Protocol):
    """What has entered a body."""

    @property
    def surface(self) -> BodySurface: ...
    @property
    def arrived(self) -> Arrived: ...


def drawn_in(surface: BodySurface) -> BodySurface:
    """A closed surface, smaller by a hair all round, so that between bodies that touch there is air."""
    first, place = surface.places()
    inward: Floats = np.stack([np.bincount(place, part, len(first)) for part in surface.normals.T], axis=1)
    inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-12)
    cosine = np.ones(len(first))
    np.minimum.at(cosine, place, np.einsum("ij,ij->i", inward[place], surface.normals))
    hair = _HAIR * (1 + float(np.abs(surface.vertices).max()))
    inward *= hair / np.maximum(cosine, 0.3)[:, None]
    return replace(surface, vertices=surface.vertices - inward[place])


def rounds_for(tracer: Tracer, meshes: list[Any]) -> Literal["none", "one", "many"]:
    """How many rounds the light asks for that bodies see of each other, or of themselves."""
    most_others, most_own = 0.0, 0.0
    for mesh in meshes:
        numbers = mi.load_dict({"type": "independent"})
        numbers.seed(0, _RAYS)
        si = dr.zeros(mi.SurfaceInteraction3f, _RAYS)
        place = mesh.sample_position(0, numbers.next_2d())
        si.p, si.n = place.p, place.n
        away = mi.Frame3f(place.n).to_world(mi.warp.square_to_cosine_hemisphere(numbers.next_2d()))
        met = tracer.scene.ray_intersect(si.spawn_ray(away))
        _, known = tracer.media.row(met, met.is_valid())
        known, own = np.array(known, bool), np.array(met.shape == mi.ShapePtr(mesh), bool)
        most_others, most_own = max(most_others, (known & ~own).mean()), max(most_own, (known & own).mean())
    if most_others > _OTHERS or most_own > _ITSELF:
        return "many"
    return "one" if most_own > _SOME else "none"


def settle(bodies: list[Any], again: Callable[[int], list[Any]]) -> None:
    """Rounds until the light that enters each body changes no more; bodies have a `surface` and what `arrived`."""
    entering = [_flux(body) for body in bodies]
    for number in range(1, _ROUNDS + 1):
        before, entering = entering, [_flux(body) for body in again(number)]
        change = max(float(np.max(np.abs(b / np.maximum(a, 1e-30) - 1))) for a, b in zip(before, entering, strict=True))
        if change < _SETTLED:
            return
    warnings.warn(
        f"light between bodies still grows by {change:.1%} in the {_ROUNDS}th round: they are too dark by about that",
        stacklevel=2,
    )


def _flux(body: LitBody) -> Floats:
    """Through the boundary, by channel."""
    return np.asarray(np.einsum("mhc,m->c", body.arrived.fresnel, body.surface.triangle_areas() / 3))
