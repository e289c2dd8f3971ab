"""What is wrong with a scene that Mitsuba has loaded, in one line each. Lengths in scene units."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from bssrdf.errors import InputError
from bssrdf.render.medium import Media
from bssrdf.render.points.spread import openings
from bssrdf.render.surface import mean_coefficients

_LOOKS = 256
"""Points and rays by which a body is examined."""
_WITHIN = 1e-4
"""How far inside its body a point is taken, over the body's extent, so that bodies may touch."""


class _Solid:
    """A shape, in a scene of its own."""

    def __init__(self, shape: Any) -> None:
        self.shape = shape
        self.low, self.high = np.array(shape.bbox().min), np.array(shape.bbox().max)
        self.extent = float(np.max(self.high - self.low))
        self._scene = mi.load_dict({"type": "scene", shape.id(): shape})

    def holds(self, points: Any) -> NDArray[np.bool_]:
        """Whether points are inside: from there the next surface is seen from behind."""
        direction = mi.warp.square_to_uniform_sphere(_grid())
        hit = self._scene.ray_intersect(mi.Ray3f(points, direction))
        return np.array(hit.is_valid() & (dr.dot(hit.n, direction) > 0), bool)

    def looks_inwards(self) -> bool:
        """Whether most of what is seen of it from outside are the backs of its faces."""
        middle = mi.Point3f(((self.low + self.high) / 2).tolist())
        outside = middle + mi.warp.square_to_uniform_sphere(_grid()) * 2 * self.extent
        inside = mi.Point3f(np.float32(self.low[:, None] + (self.high - self.low)[:, None] * _scattered()))
        direction = dr.normalize(inside - outside)
        hit = self._scene.ray_intersect(mi.Ray3f(outside, direction))
        seen = np.array(hit.is_valid(), bool)
        backs = np.array(dr.dot(hit.n, direction) > 0, bool) & seen
        return bool(backs.sum() > 0.5 * seen.sum() > 0)

    def points(self) -> Any:
        """Points just under the surface."""
        sample = self.shape.sample_position(0, _grid())
        return sample.p - _WITHIN * self.extent * sample.n


def faults(scene: Any) -> list[str]:
    """A line for each opening, overlap and light inside a body.

    Raises InputError for a body whose faces look inwards.
    """
    shapes = Media(scene).shapes
    solids = [_Solid(shape) for shape in shapes if not openings([shape])]
    for solid in solids:
        if solid.looks_inwards():
            raise InputError(f'shape "{solid.shape.id()}": its faces look inwards; turn them over, or set flip_normals')
    found = openings(shapes)
    found += [_overlap(one, other) for one, other in itertools.combinations(solids, 2)]
    found += [_inside(emitter, solid) for emitter, solid in itertools.product(scene.emitters(), solids)]
    return [line for line in found if line]


def unit_faults(scene: Any) -> list[str]:
    """A line for each body that is smaller than its mean free path."""
    return [line for shape in Media(scene).shapes if (line := _unit(shape))]


def _unit(shape: Any) -> str:
    longest = float(1 / mean_coefficients(shape.bsdf().surface).sum(axis=0).min())
    extent = float(np.max(np.array(shape.bbox().extents())))
    if longest < extent:
        return ""
    return (
        f'shape "{shape.id()}" is {extent:.3g} across, and light runs {longest:.3g} in it between scatterings: '
        "are its coefficients in 1/scene unit? (scale multiplies them)"
    )


def _overlap(one: _Solid, other: _Solid) -> str:
    if np.any(one.low > other.high) or np.any(other.low > one.high):
        return ""
    if not (one.holds(other.points()).any() or other.holds(one.points()).any()):
        return ""
    names = f'"{one.shape.id()}" and "{other.shape.id()}"'
    return f"shapes {names} overlap: light under one does not know the other; move them apart"


def _inside(emitter: Any, solid: _Solid) -> str:
    if emitter.is_environment():
        return ""
    si = dr.zeros(mi.SurfaceInteraction3f, _LOOKS)
    si.p = mi.Point3f((solid.high + solid.extent).tolist())
    place = emitter.sample_direction(si, _grid())[0].p
    if not solid.holds(place).any():
        return ""
    return f'light "{_name(emitter)}" is inside shape "{solid.shape.id()}": it is not seen from there; move it out'


def _name(emitter: Any) -> str:
    shape = emitter.get_shape()
    return str(shape.id() if shape is not None else emitter.id())


def _grid() -> Any:
    return mi.Point2f(np.ascontiguousarray(_scattered()[:2]))


def _scattered() -> NDArray[np.float32]:
    """Evenly scattered points of the unit cube, (3, n): Roberts' sequence."""
    ratio = 1.2207440846057596  # of the plastic sequence in three dimensions: x⁴ = x + 1
    steps = np.array([ratio**-1, ratio**-2, ratio**-3])
    return np.asarray((0.5 + steps[:, None] * np.arange(_LOOKS)) % 1.0, np.float32)
